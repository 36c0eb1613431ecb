"""The typer application: the commands by name, each in its own module."""

from __future__ import annotations

from typing import Annotated

import typer

from topcli.cli import bench, compare, inspect, lax, plot, roundoff, run, stress, verify

app = typer.Typer(
    name="topcli",
    no_args_is_help=True,
    rich_markup_mode=None,  # rich would make --help three times slower
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Numerical experiments on discrete spinning tops: run, measure, compare, draw.",
    epilog="Exit codes: 0 fine, 1 a run failed, 2 wrong usage or config, 3 part of several runs failed, "
    "4 a stated tolerance was violated, 130 interrupted.",
)


def _print_version(asked: bool) -> None:
    if asked:
        from topcli import __version__

        print(f"topcli {__version__}")
        raise typer.Exit


@app.callback()
def _topcli(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass


app.command("run")(run.run)
app.command("verify")(verify.verify)
app.command("compare")(compare.compare)
app.command("bench")(bench.bench)
app.command("plot")(plot.plot)
app.command("lax")(lax.lax)
app.command("roundoff")(roundoff.roundoff)
app.command("stress")(stress.stress)
app.add_typer(inspect.list_app, name="list")
app.command("show")(inspect.show)
app.command("init")(inspect.init)
app.command("schema")(inspect.schema)
app.command("doctor")(inspect.doctor)
