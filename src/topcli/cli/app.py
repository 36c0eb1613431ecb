"""The typer application: all commands, imported when needed, and one style for errors of usage."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, MutableMapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from topcli.cli.output import emit, print_error, print_message, print_message_text
from topcli.errors import ExitCode, TopcliError, UsageError, clipped
from topcli.studies import STUDIES, find_study

STUDY = "study"
"""Place of a command that follows from a study."""
_TYPE = re.compile(r" <[^>]*>$")
WITHOUT_PLUGINS = frozenset(("verify", "table", "claims", "compositions", "sweeps", "runs"))
"""Commands that meet no scheme, top, measure, figure or case of a user: they have no option ``--plugin``."""


FAILED_PLUGINS = "topcli.plugins.failed"
"""Key of the messages about the files of ``--plugin`` that failed, in the context of ``topcli doctor``."""


def _load_plugins(ctx: typer.Context, paths: list[Path] | None) -> None:
    """Register what the files given by ``--plugin`` define; ``topcli doctor`` reports those that fail."""
    for path in paths or ():
        from topcli.schemes.registry import load_plugin_file

        try:
            load_plugin_file(path)
        except UsageError as error:
            if ctx.command.name != "doctor":
                raise
            ctx.meta.setdefault(FAILED_PLUGINS, []).append(str(error))


def _with_plugins(
    plugins: Annotated[
        list[Path] | None,
        typer.Option(
            "--plugin",
            "--scheme-file",
            metavar="FILE",
            help="Load tops, schemes, measures, figures, cases from a file.",
            callback=_load_plugins,
            expose_value=False,
            is_eager=True,  # the completion of other options knows them
        ),
    ] = None,
) -> None:
    pass


@cache
def _plugin_option() -> Any:
    """The option ``--plugin``, which all commands share."""
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command()(_with_plugins)
    return get_command(single).params[0]


class Command(TyperCommand):
    """A command with the option ``--plugin``, whose help lists arguments without types such as ``<list[str]>``."""

    def __init__(self, name: str | None, **attributes: Any) -> None:
        super().__init__(name, **attributes)
        if name not in WITHOUT_PLUGINS:
            self.params.append(_plugin_option())

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the options."""
        write = formatter.write_dl
        formatter.write_dl = lambda rows, *args, **kwargs: write(
            [(_TYPE.sub("", name), text) for name, text in rows], *args, **kwargs
        )
        super().format_options(ctx, formatter)
        formatter.write_dl = write


class Commands(MutableMapping[str, Any]):
    """Commands by name, given as ``module.function`` or ``module.group`` and imported when they are first needed.

    A command imports its own module only; the help, a completion and an unknown name import what they list.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        self._commands: dict[str, Any] = dict(places)

    def __getitem__(self, name: str) -> Any:
        command = self._commands[name]
        if isinstance(command, str):
            command = self._commands[name] = _imported(name, command)
        return command

    def __setitem__(self, name: str, command: Any) -> None:
        self._commands[name] = command

    def __delitem__(self, name: str) -> None:
        del self._commands[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._commands)

    def __len__(self) -> int:
        return len(self._commands)


class StudyCommand(TyperCommand):
    """Command of a study that is imported when it is used; its place in the help of all commands needs no import."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Context of the command itself."""
        from topcli.cli.study import command

        name = str(self.name)
        return _typer_command(command(find_study(name)), name).make_context(info_name, args, parent, **extra)


def _imported(name: str, place: str) -> Any:
    """The command called ``name``, from ``module.function`` or ``module.group`` in this package, or that of a study."""
    if place == STUDY:
        return StudyCommand(name=name, callback=None, help=STUDIES[name].help)
    module, attribute = place.split(".")
    return _typer_command(getattr(import_module(f"topcli.cli.{module}"), attribute), name)


def _typer_command(function: Any, name: str) -> Any:
    """Command of typer from a function or a group of commands."""
    if not isinstance(function, typer.Typer):
        single = typer.Typer(add_completion=False, rich_markup_mode=None)
        single.command(name, cls=Command)(function)
        function = single
    command = get_command(function)
    command.name = name
    return command


class LazyGroup(TyperGroup):
    """Base of a group whose ``places`` name its commands and where they are."""

    places: Mapping[str, str] = {}

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = Commands(self.places)


class _Topcli(LazyGroup):
    """All commands, in the order of the help."""

    places = {  # noqa: RUF012 (a constant)
        "run": "run.run",
        "sweep": "sweep.sweep",
        "verify": "results.verify",
        "compare": STUDY,
        "analyse": STUDY,
        "bench": "bench.bench",
        "table": "results.table",
        "order": STUDY,
        "plot": "plot.plot",
        "report": "results.report",
        "animate": "results.animate",
        "lax": STUDY,
        "integrability": STUDY,
        "discover": STUDY,
        "roundoff": STUDY,
        "lyapunov": STUDY,
        "frequencies": STUDY,
        "stress": STUDY,
        "check": STUDY,
        "claims": STUDY,
        "show": "inspect.show",
        "init": "inspect.init",
        "schema": "inspect.schema",
        "doctor": "inspect.doctor",
        "cite": "listing.cite",
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
    f"Exit codes: {', '.join(f'{code} {code.meaning}' for code in ExitCode)}.",
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
