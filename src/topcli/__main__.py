"""The entry point of ``topcli`` and ``python -m topcli``."""

from __future__ import annotations

import gc
import io
import os
import sys


def _prepare_streams() -> None:
    """Make printing safe: a closed stream swallows, and a letter that the encoding lacks becomes a question mark."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (for the whole process)
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _drop_output() -> None:
    """Send what is still buffered for stdout nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main() -> None:
    """Run the command line and exit with its code; a user's mistake is reported without a traceback."""
    gc.set_threshold(100_000, 50, 50)  # start-up makes many objects and no garbage
    _prepare_streams()
    code: int | str | None = 0
    try:
        from topcli.cli.app import call

        try:
            code = call()
        except SystemExit as leaving:
            code = leaving.code
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = 130
    except BrokenPipeError:
        _drop_output()
        code = 1
    except OSError as error:
        _drop_output()
        print(f"error: standard output cannot be written ({error.strerror})", file=sys.stderr)
        code = 1
    except Exception:
        import traceback

        from topcli.cli.talk import say, say_text

        say_text(traceback.format_exc())
        say("internal error: this is a bug in topcli; please report it with the lines above")
        code = 70
    sys.exit(code)


def entry() -> None:
    """What the installed command calls: ``main``, then leave at once, without taking the interpreter apart."""
    try:
        main()
    except SystemExit as leaving:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None))


if __name__ == "__main__":
    entry()
