"""Entry point of ``topcli`` and ``python -m topcli``."""

from __future__ import annotations

import gc
import io
import os
import sys

from topcli.errors import ExitCode


def _drop_output() -> None:
    """Discard the output buffered for stdout, whose reader has gone or whose disk is full."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _reported(error: Exception) -> ExitCode:
    """Report an error of the machine, of a user's code, or a bug of topcli, and return the exit code."""
    import traceback

    from topcli.cli.output import print_error, print_lines, print_message
    from topcli.plugins import users_error

    if isinstance(error, OSError):
        if error.filename is None:  # files have names
            _drop_output()
        print_message(f"error: {error.filename or 'cannot write output'}: {(error.strerror or '').lower()}")
        return ExitCode.FAILED
    if failure := users_error(error):
        print_error(failure)
        return failure.exit_code
    if isinstance(error, MemoryError):
        print_message("error: not enough memory")
        return ExitCode.FAILED
    if isinstance(error, ImportError) and not (error.name or "").startswith("topcli"):
        print_message(f"error: {error}; is the package installed, and is there enough memory?")
        return ExitCode.FAILED
    print_lines("".join(traceback.format_exception(error)))
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
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name) or open(os.devnull, "w")  # noqa: SIM115 (closed by the parent process)
        setattr(sys, name, stream)
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    code: int | str | None = ExitCode.FAILED
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
    except BrokenPipeError:
        _drop_output()  # the reader has gone, as in topcli ... | head -1; lost last lines do not change the code
    except Exception as error:
        code = _reported(error)
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
