"""The typer application: all commands, imported when needed, and one style for errors of usage."""

from __future__ import annotations

import difflib
import platform
import re
from collections.abc import Iterator, Mapping, MutableMapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from topcli import STUDIES, __version__
from topcli.cli.commands import COMMANDS, GONE, GROUPS, STUDY
from topcli.cli.output import emit, print_error, print_message, print_message_text
from topcli.errors import ExitCode, TopcliError, clipped
from topcli.studies import find_study

_TYPE = re.compile(r" <[^>]*>$")
_IN_WORDS = (
    (re.compile(r"\[default: \((.*)\)(?=[];])"), r"[default: \1"),
    (re.compile(r"([\d.]+)<=x<=([\d.]+)(?=\]$)"), r"\1 to \2"),
    (re.compile(r"x>=([\d.]+)(?=\]$)"), r"at least \1"),
)
"""Defaults in words without parentheses, and bounds in words."""


def _load_plugins(paths: list[Path] | None) -> None:
    """Register what the files given by ``--plugin`` define."""
    for path in paths or ():
        from topcli.schemes.plugins import load_plugin_file

        load_plugin_file(path)


def _with_plugins(
    plugins: Annotated[
        list[Path] | None,
        typer.Option(
            "--plugin",
            "--scheme-file",
            metavar="FILE",
            help="Load tops, schemes, measures, figures and hard cases from a Python file.",
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
    """A command with the option ``--plugin``; its help marks repeatable options and shows no types of Python."""

    def __init__(self, name: str | None, **attributes: Any) -> None:
        super().__init__(name, **attributes)
        self.params.append(_plugin_option())

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Pieces of the usage, without braces around required arguments."""
        return [piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the options."""
        for title, rows in parameter_rows(self, ctx).items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def parameter_rows(command: Any, ctx: Any) -> dict[str, list[tuple[str, str]]]:
    """Names and help texts of the arguments and of the options of a command, as its help lists them."""
    rows: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
    for parameter in command.get_params(ctx):
        record = parameter.get_help_record(ctx)
        if record is None:
            continue
        name, text = record
        for pattern, words in _IN_WORDS:
            text = pattern.sub(words, text)
        option = parameter.param_type_name == "option"
        if option and parameter.multiple:
            text = f"{text[:-1]}; repeatable]" if text.endswith("]") else f"{text}  [repeatable]"
        rows["Options" if option else "Arguments"].append((_TYPE.sub("", name), text))
    return rows


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
        return self.whole().make_context(info_name, args, parent, **extra)

    def whole(self) -> Any:
        """The command itself, with all options."""
        from topcli.cli import study

        function = find_study(str(self.name))
        command = _typer_command(study.options_of(function), str(self.name))
        read = command.callback
        command.callback = lambda **values: study.run(function, read(**values))
        return command


def _imported(name: str, place: str) -> Any:
    """The command called ``name``, from ``module.function`` or ``module.group`` in this package, or that of a study."""
    if place == STUDY:
        return StudyCommand(name=name, callback=None, help=STUDIES[name][1])
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


class _Topcli(TyperGroup):
    """All commands, in the groups and the order of the help."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = Commands(COMMANDS)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in their groups."""
        width = max(map(len, self.commands))
        for title, entries in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl(
                    [(name.ljust(width), self.commands[name].get_short_help_str(formatter.width)) for name in entries]
                )


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
    """Contexts of all commands, also those of ``topcli list``, by their words after ``topcli``."""
    root = get_command(app)
    top = root.context_class(root, info_name="topcli")
    contexts: dict[str, Any] = {}
    for name in COMMANDS:
        command = root.commands[name]  # pyright: ignore[reportAttributeAccessIssue]
        command = command.whole() if isinstance(command, StudyCommand) else command
        inner = contexts[name] = command.context_class(command, info_name=name, parent=top)
        for sub, listed in getattr(command, "commands", {}).items():
            contexts[f"{name} {sub}"] = listed.context_class(listed, info_name=sub, parent=inner)
    return contexts


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
    ctx = getattr(error, "ctx", None)
    hint = f" (see {ctx.command_path} --help)" if ctx is not None else ""
    unknown = re.match(r"No such (?:command|option):? '?([\w-]+)'?", message)
    if unknown and ctx is not None and (instead := GONE.get(" ".join([*ctx.command_path.split()[1:], unknown[1]]))):
        print_message(f"error: n{unknown[0][1:]}; {instead}")
        return
    message = clipped(message, 240).removesuffix(".").replace(". Did you mean", "; did you mean")
    message = message.replace("', '", "' or '")
    near = difflib.get_close_matches(getattr(error, "option_name", ""), getattr(error, "possibilities", None) or [], 1)
    message = re.sub(r" \(Possible options: .*\)$", lambda _: f"; did you mean {near[0]}?" if near else "", message)
    print_message(f"error: {message[:1].lower()}{message[1:]}{hint}")


def _print_version(asked: bool) -> None:
    if asked:
        from topcli.engine.code_store import cache_folder, cache_problem
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
