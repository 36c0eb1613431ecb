"""The typer application: all commands, and one style for errors of usage."""

from __future__ import annotations

import re
from typing import Annotated, Any

import typer

from topcli.cli.command import STUDY, LazyGroup
from topcli.cli.output import emit, print_error, print_message, print_message_text
from topcli.errors import TopcliError, clipped


class _Topcli(LazyGroup):
    """All commands, in the order of the help."""

    places = {  # noqa: RUF012 (a constant)
        "run": "run.run",
        "sweep": "sweep.sweep",
        "verify": "verify.verify",
        "compare": STUDY,
        "analyse": STUDY,
        "bench": "bench.bench",
        "table": "table.table",
        "order": STUDY,
        "plot": "plot.plot",
        "report": "report.report",
        "animate": "animate.animate",
        "lax": STUDY,
        "roundoff": STUDY,
        "stress": STUDY,
        "claims": "claims.claims",
        "show": "inspect.show",
        "init": "inspect.init",
        "schema": "inspect.schema",
        "doctor": "inspect.doctor",
        "cite": "cite.cite",
        "list": "listing.list_app",
    }


app = typer.Typer(
    name="topcli",
    cls=_Topcli,
    no_args_is_help=True,
    rich_markup_mode=None,  # rich would make --help three times slower
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Numerical experiments on discrete spinning tops: run, measure, compare, draw.",
    epilog="First steps: topcli init, topcli run experiment.yaml, topcli report results/NAME --out NAME.html.\n\n"
    "Exit codes: 0 success, 1 a run failed, 2 wrong usage or config, 3 part of several runs failed, "
    "4 a stated tolerance or claim was violated, 70 an internal error, 130 interrupted.",
)


def call() -> int | str | None:
    """Run the command line and return its exit code; errors of the user are reported in a few lines."""
    try:
        return app(prog_name="topcli", standalone_mode=False)
    except TopcliError as error:
        print_error(error)
        return error.exit_code
    except Exception as error:
        # typer exports no common base class of its errors
        code = getattr(error, "exit_code", None)
        if code is None or not hasattr(error, "format_message"):
            raise
        _say_usage(error)
        return code


def _say_usage(error: Any) -> None:
    """Report an error found by typer in the style of all other errors."""
    message = error.format_message().strip()
    if "\n" in message:  # the help, of a command without arguments
        print_message_text(message)
        return
    message = clipped(message, 240).removesuffix(".").replace(". Did you mean", "; did you mean")
    message = re.sub(r" \(Possible options: (.*)\)$", r"; did you mean \1?", message)
    ctx = getattr(error, "ctx", None)
    hint = f" (see {ctx.command_path} --help)" if ctx is not None else ""
    print_message(f"error: {message[:1].lower()}{message[1:]}{hint}")


def _print_version(asked: bool) -> None:
    if asked:
        from topcli import __version__

        emit(f"topcli {__version__}")
        raise typer.Exit


@app.callback()
def _topcli(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass
