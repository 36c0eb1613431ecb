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


def _unexpected(error: Exception) -> int:
    """Report an error that nothing else has caught, and return the exit code: a user's scheme or top, or a bug."""
    import traceback

    from topcli.schemes.user_code import users_error

    if found := users_error(error):
        print(f"error: {found}", file=sys.stderr)
        return found.exit_code
    traceback.print_exception(error)
    print("\ninternal error: this is a bug in topcli, please report it with the lines above", file=sys.stderr)
    return 70


def main() -> None:
    """Run the command line and leave with its exit code; a user's mistake is told without a traceback."""
    gc.set_threshold(100_000, 50, 50)  # start-up makes many objects and no garbage
    _prepare_streams()
    code: int | str | None = 0
    try:
        from topcli.cli.app import app
        from topcli.errors import TopcliError

        try:
            app(prog_name="topcli")
        except SystemExit as leaving:
            code = leaving.code
        except TopcliError as error:
            print(f"error: {error}", file=sys.stderr)
            code = error.exit_code
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
    except MemoryError:
        print("error: not enough memory", file=sys.stderr)
        code = 1
    except Exception as error:
        code = _unexpected(error)
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
