"""Entry point of ``topcli`` and ``python -m topcli``."""

from __future__ import annotations

import gc
import io
import os
import sys
from typing import TYPE_CHECKING

from topcli.errors import ExitCode

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer as Buffer


class _Pipe(io.FileIO):
    """Standard stream that discards output after its reader has gone, as in ``topcli ... | head -1``.

    The command continues, so that its exit code does not depend on when the reader closed the pipe.
    """

    def write(self, data: Buffer, /) -> int | None:
        try:
            return super().write(data)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            return super().write(data)


def _prepare_streams() -> None:
    """Make printing safe: closed streams discard output, and unencodable characters become question marks."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 (for the whole process)
        elif not isinstance(stream, io.TextIOWrapper):
            continue
        elif isinstance(getattr(stream.buffer, "raw", stream.buffer), io.FileIO):
            stream.flush()
            raw = _Pipe(stream.fileno(), "w", closefd=False)
            pipe = raw if stream.write_through else io.BufferedWriter(raw)
            wrapped = io.TextIOWrapper(
                pipe,
                stream.encoding,
                "replace",
                line_buffering=stream.line_buffering,
                write_through=stream.write_through,
            )
            setattr(sys, name, wrapped)
        else:
            stream.reconfigure(errors="replace")


def _drop_output() -> None:
    """Discard the output buffered for stdout."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _unexpected(error: Exception) -> ExitCode:
    """Report an unexpected error, of a user's scheme or top or a bug, and return the exit code."""
    import traceback

    from topcli.cli.output import print_error, print_message, print_message_text
    from topcli.schemes.plugins import users_error

    if shown := users_error(error):
        print_error(shown)
        return shown.exit_code
    if isinstance(error, ImportError) and not (error.name or "").startswith("topcli"):
        print_message(
            f"error: a package cannot be loaded: {error}; is it installed, and is there enough memory (ulimit -v)?"
        )
        return ExitCode.FAILED
    print_message_text("".join(traceback.format_exception(error)))
    print_message("error: internal error; this is a bug in topcli, please report it with the lines above")
    return ExitCode.BUG


def main() -> None:
    """Run the command line and exit with its code; errors of the user are reported without a traceback."""
    if os.name == "nt":
        print("error: topcli does not run on Windows; use WSL, the Windows Subsystem for Linux", file=sys.stderr)
        sys.exit(ExitCode.WRONG_USAGE)
    gc.set_threshold(100_000, 50, 50)  # start-up creates many objects and no garbage
    # no plugins of other packages take part in reading a config; a search for them reads all installed metadata
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    os.environ.pop("MPLBACKEND", None)  # figures are files; the backend of a notebook may be missing here
    _prepare_streams()
    code: int | str | None = ExitCode.SUCCESS
    try:
        from topcli.cli.app import call

        try:
            code = call()
        except SystemExit as leaving:
            code = leaving.code
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = ExitCode.INTERRUPTED
    except OSError as error:
        if error.filename is None:  # files have names
            _drop_output()
            print(f"error: cannot write to standard output ({error.strerror})", file=sys.stderr)
        else:
            from topcli.cli.output import print_message

            print_message(f"error: {error.filename}: {(error.strerror or '').lower()}")
        code = ExitCode.FAILED
    except MemoryError:
        print("error: not enough memory", file=sys.stderr)
        code = ExitCode.FAILED
    except Exception as error:
        code = _unexpected(error)
    sys.exit(code)


def entry() -> None:
    """Run ``main`` for the installed command and exit at once, without finalising the interpreter."""
    try:
        main()
    except SystemExit as leaving:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None))


if __name__ == "__main__":
    entry()
