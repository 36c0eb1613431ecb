"""The command line: all commands, imported when needed, and one style for errors of usage."""

from __future__ import annotations

import platform
import re
from collections.abc import Callable
from contextlib import closing
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from topcli import STUDIES, __version__
from topcli.cli import options
from topcli.cli.output import Screen, emit, print_document, print_error, print_lines, print_message
from topcli.errors import ExitCode, TopcliError, UsageError, shortened, successor
from topcli.studies import find_study

_FIRST = ("compare", "order", "bench", "analyse")
"""Studies among the commands that most users need."""
GROUPS = {
    "Run and compare": {
        "run": ("topcli.cli.running", "Run experiments and report on their conservation laws."),
        "sweep": ("topcli.cli.running", "Run all combinations of the values in a sweep file."),
        **{name: STUDIES[name] for name in _FIRST},
    },
    "Studies": {name: place for name, place in STUDIES.items() if name not in _FIRST},
    "Look at results": {
        "report": ("topcli.cli.results", "Write a self-contained HTML page about stored results."),
        "plot": ("topcli.cli.results", "Draw figures as PNG and PDF, with their data as Parquet."),
        "animate": ("topcli.cli.results", "Animate the body of a run, with the trace of its axis."),
        "table": ("topcli.cli.results", "Show tables of a result as text, CSV or LaTeX."),
        "verify": ("topcli.cli.results", "Verify stored results by their checksums."),
    },
    "Reference": {
        "list": ("topcli.cli.reference", "List tops, schemes, scenes, figures, runs and more."),
        "show": ("topcli.cli.reference", "Show a config, a scheme, a top, or a row of a sweep."),
        "cite": ("topcli.cli.reference", "Print the BibTeX of a scheme, a top, or topcli itself."),
        "init": ("topcli.cli.reference", "Copy a packaged scene as a config to start from."),
        "schema": ("topcli.cli.reference", "Print the JSON Schema of the config."),
    },
}
"""Module and first line of the help of each command, by the group in which the help lists them; the function of NAME in
the module is ``NAME_command``, and that of a study has its name."""
COMMANDS = {name: place for group in GROUPS.values() for name, place in group.items()}


def command_function(name: str) -> Callable[..., Any]:
    """Function of the command called ``name``."""
    return find_study(name) if name in STUDIES else getattr(import_module(COMMANDS[name][0]), f"{name}_command")


class Command(TyperCommand):
    """A command that is imported when it is used; its place in the help of all commands needs no import."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Context of the command with its options."""
        return self.whole().make_context(info_name, args, parent, **extra)

    def whole(self) -> Any:
        """The command with its options."""
        name = str(self.name)
        function = command_function(name)
        return options.command_of(function, name, lambda values: perform(name, function, vars(values)))


class _Topcli(TyperGroup):
    """All commands, in the groups and the order of the help."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = {name: Command(name=name, callback=None, help=text) for name, (_, text) in COMMANDS.items()}

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in their groups."""
        width = max(map(len, COMMANDS))
        for title, group in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), text) for name, (_, text) in group.items()])


app = typer.Typer(
    name="topcli",
    cls=_Topcli,
    no_args_is_help=True,
    rich_markup_mode=None,  # rich would make --help three times slower
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Run, measure, compare and draw numerical experiments on discrete spinning tops.",
    epilog="Start with: topcli run kowalevski_hybrid. Exit codes: "
    + "; ".join(f"{code} {code.meaning}" for code in ExitCode)
    + ".",
)


def all_commands() -> dict[str, Any]:
    """Contexts of all commands by name."""
    root = get_command(app)
    top = root.context_class(root, info_name="topcli")
    commands = {name: Command(name=name, callback=None).whole() for name in COMMANDS}
    return {name: command.context_class(command, info_name=name, parent=top) for name, command in commands.items()}


def perform(name: str, function: Callable[..., Any], values: dict[str, Any]) -> None:
    """Call the function of a command, print its result, and exit with its code."""
    as_json, quiet, _ = (values.pop(parameter) for parameter in ("as_json", "quiet", "plugin"))
    with closing(Screen(as_json, quiet)) as screen:
        if options.is_study(function):
            code = perform_study(function, values, screen)
        else:
            data, code = options.call_with(function, values, screen)
            if as_json:
                print_document({"schema_version": 1, "command": name, **data})
    if code:
        raise typer.Exit(code)


def perform_study(study: Callable[..., Any], values: dict[str, Any], screen: Screen) -> int:
    """Call a study, print its report, write files, and return the code of the report."""
    from topcli.cli.results import require_new_file
    from topcli.plugins import FAILURES
    from topcli.studies.report import PICTURES, TABLES

    plot, save, force, verbose = (values.pop(parameter) for parameter in ("plot", "save", "force", "verbose"))
    paths = {"--plot": (plot, PICTURES), "--save": (save, (".json", *TABLES))}
    files = {option: (path, endings) for option, (path, endings) in paths.items() if path is not None}
    # wrong names of files are refused before the study, which may take long
    for option, (path, endings) in files.items():
        if path.suffix not in endings:
            last = f"{', '.join(endings[:-1])} or {endings[-1]}"
            raise UsageError(f"{option} {path}: unknown type of file; use a name ending in {last}")
        require_new_file(path, force, option)
    report = options.call_with(study, values, screen)
    if screen.as_json:
        print_document(report.as_dict())
    screen.show(*filter(None, (report.title, report.answer)))
    for table in report.tables:
        if table.rows and (verbose or table.detail is not True):
            screen.show("", table.cells(verbose))
    for path, _ in files.values():
        screen.say(f"wrote {report.save(path)}")
    for line in report.notes:
        screen.say(line)
    unnamed = [failure for failure in FAILURES.values() if not any(failure in line for line in report.errors)]
    for line in (*(f"error: {line}" for line in report.errors), *unnamed):
        print_message(line)
    return report.code


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
        print_usage_error(error)
        return code


def print_usage_error(error: Any) -> None:
    """Report an error of typer in the style of all other errors, with the nearest name."""

    message = error.format_message().strip()
    if "\n" in message:  # the help, of a command without arguments
        print_lines(message)
        return
    ctx = getattr(error, "ctx", None)
    path = ctx.command_path if ctx is not None else "topcli"
    unknown = re.match(r"No such (?:command|option):? '?([\w-]+)'?", message)
    if unknown and (instead := successor(" ".join([*path.split()[1:], unknown[1]]))):
        print_message(f"error: n{unknown[0][1:]}; {instead}")
        return
    message = re.sub(r" \(Possible options: .*\)$", "", message.removesuffix(".").replace("Value error, ", ""))
    nearest = [f"; did you mean '{name}'?" for name in getattr(error, "possibilities", None) or ()]
    message = message.replace(". Did you", "; did you") + "".join(nearest[:1])
    print_message(f"error: {message[:1].lower()}{shortened(message[1:], 240)} (see {path} --help)")


def _print_version(asked: bool) -> None:
    if asked:
        from topcli.engine.native import cache_folder, cache_problem
        from topcli.store.provenance import installed

        packages = ", ".join(f"{package} {installed(package)}" for package in ("numba", "numpy"))
        problem = cache_problem()
        emit(f"topcli {__version__}")
        emit(f"Python {platform.python_version()}, {packages}")
        emit(f"cache of machine code: {cache_folder()}{f' (not used: {problem})' if problem else ''}")
        raise typer.Exit


@app.callback()
def _topcli(
    version: Annotated[
        bool, typer.Option("--version", help="Print versions and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass
