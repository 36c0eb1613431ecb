"""Options, arguments and help of a command, read from the signature and the NumPy docstring of its function.

A command is a function. Its positional parameters are arguments, its keyword-only ones options: ``max_steps`` becomes
``--max-steps``. The type, the default and the number of values follow from the annotation, and the help is the first
sentence about the parameter in the docstring. Parameters of several commands are described in ``options.txt``.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, make_dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from typer.core import TyperCommand
from typer.main import get_command

from topcli.errors import shortened

_LINES = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8").splitlines()[1:]
SHARED = {name: (words.split(), *text) for name, words, *text in (re.split(" {2,}", line) for line in _LINES)}
"""Spelling and word for a value, and the help if it is the same everywhere, of parameters of several commands.

Other whole numbers are N, other numbers X, folders DIR, and texts NAME.
"""


def of_all(*, as_json: bool = False, quiet: bool = False, plugin: Sequence[Path] = ()) -> None:
    """Options of every command."""


def of_studies(
    *, plot: Path | None = None, save: Path | None = None, force: bool = False, verbose: bool = False
) -> None:
    """Further options of a study."""


def load_plugins(paths: list[Path] | None) -> None:
    """Register what the files given by ``--plugin`` define."""
    for path in paths or ():
        from topcli.plugins import load_plugin_file

        load_plugin_file(path)


def complete(kinds: str, beginning: str) -> list[str]:
    """Names of some kinds, such as ``CONFIG|SCHEME``, that begin with ``beginning``."""
    names = [name for kind in kinds.split("|") for name in completions_of(kind, beginning.lower())]
    return [name for name in names if name.lower().startswith(beginning.lower())]


def completions_of(kind: str, beginning: str) -> Sequence[str]:
    """Names of a kind that may begin with ``beginning``; compositions of a scheme only after a +."""
    if kind == "TOP":
        from topcli.tops import top_names

        return sorted(top_names())
    if kind == "SCHEME":
        from topcli.schemes.compose import COMPOSITIONS, composition_obstacle
        from topcli.schemes.registry import all_schemes

        schemes = all_schemes()
        bases = {each.name for each in schemes if beginning.startswith(f"{each.name}+")}
        composed = [each.name for each in schemes if each.name in bases and not composition_obstacle(each)]
        compositions = {f"{name}+{composition}" for name in composed for composition in COMPOSITIONS}
        return sorted(compositions | {each.name for each in schemes})
    if kind == "FIGURE":
        from topcli.figures.catalogue import FIGURES

        return list(FIGURES)
    if kind in ("CONFIG", "SWEEP"):
        from topcli.config.files import scene_files

        files = [str(path) for path in sorted(Path("configs").glob("*.*"))] if kind == "CONFIG" else []
        return [*files, *scene_files("" if kind == "CONFIG" else "sweeps")]
    if kind == "RUN" and Path("results").is_dir():
        return sorted(path.name for path in Path("results").iterdir() if path.is_dir())
    return ()


def whole_number(text: str) -> int:
    """Whole number, also written as 1e6."""
    try:
        if (value := float(text)) == int(value):
            return int(value)
    except (ValueError, OverflowError):
        pass
    raise typer.BadParameter(f"{shortened(text)} is not a whole number, such as 1000 or 1e6")


def is_study(function: Callable[..., Any]) -> bool:
    """True for a study, whose progress is watched; other commands print by themselves."""
    return "watch" in inspect.signature(function).parameters


def command_of(function: Callable[..., Any], name: str, perform: Callable[[Any], None]) -> Any:
    """Command of typer for a function; ``perform`` gets the values of the parameters as attributes."""
    doc = inspect.cleandoc(function.__doc__ or "").partition("Parameters\n")[0]
    helps = parameter_helps(function.__doc__)
    fields = [
        option_of(parameter, helps.get(parameter.name, ""))
        for each in (function, *((of_studies,) if is_study(function) else ()), of_all)
        for parameter in inspect.signature(each, eval_str=True).parameters.values()
        if parameter.kind is not parameter.VAR_KEYWORD and parameter.name not in ("watch", "screen")
    ]
    values = make_dataclass(function.__name__, fields, kw_only=True, namespace={"__doc__": doc})
    single = typer.Typer(add_completion=False, rich_markup_mode=None)
    single.command(name, cls=PlainCommand)(values)
    command = get_command(single)
    read: Any = command.callback
    command.name, command.callback = name, lambda **options: perform(read(**options))
    return command


def takes_argument(parameter: inspect.Parameter) -> bool:
    """True for a positional parameter other than the overrides, which is an argument of the command."""
    return parameter.kind is not parameter.KEYWORD_ONLY and parameter.name != "overrides"


def option_of(parameter: inspect.Parameter, text: str) -> tuple[str, Any, Any]:
    """Field of the options for a ``parameter``, whose own help is ``text``: name, type with the option, and default."""
    argument, name = takes_argument(parameter), parameter.name
    kind, several = value_type(parameter.annotation)
    several = several or parameter.kind is parameter.VAR_POSITIONAL
    words, *common = SHARED.get(name, ([],))
    spelt = [word for word in words if word.startswith("-")] or [f"--{name.replace('_', '-')}"]
    word = {int: "N", float: "X", str: "NAME", Path: "DIR"}.get(kind) or "|".join(get_args(kind))
    metavar = next((word for word in words if word.isupper()), word)
    details: dict[str, Any] = {"help": text if argument or not common else common[0], "metavar": metavar or None}
    if kind is int:
        details |= {"min": 1} if name == "threads" else {"parser": whole_number}
    if not get_args(kind):

        def names(incomplete: str) -> list[str]:
            return complete(metavar.partition("[")[0], incomplete)

        details["autocompletion"] = names
    if name == "plugin":  # before all others, whose completion knows what a plugin defines
        details |= {"callback": load_plugins, "is_eager": True}
    required = parameter.default is parameter.empty and parameter.kind is not parameter.VAR_POSITIONAL
    default = None if parameter.default in (parameter.empty, ()) else parameter.default
    declared = typer.Argument(**details) if argument else typer.Option(*spelt, **details)
    annotation = list[kind] if several else kind
    annotated = Annotated[annotation if required or default is not None else annotation | None, declared]
    return name, annotated, field() if required else field(default=default)


def value_type(annotation: Any) -> tuple[Any, bool]:
    """Type of a value on the command line, and True if there may be several."""
    kinds = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    for kind in kinds:
        if get_origin(kind) in (Sequence, list, tuple):
            return value_type(get_args(kind)[0])[0], True
    plain = [kind for kind in kinds if kind in (bool, int, float) or get_origin(kind) is Literal]
    plain += [Path] if kinds[0] is Path and not plain else []
    return (plain or [str])[0], False


def parameter_helps(doc: str | None) -> dict[str, str]:
    """First sentence on each parameter of a NumPy docstring."""
    section = (doc or "").partition("Parameters\n")[2]
    section = re.split(r"\n *\n *\w+\n *-{3,}", section)[0]
    entries = re.split(r"^ {4}\*{0,2}([\w, *]+)(?: : .*)?\n", section, flags=re.MULTILINE)[1:]
    texts = (" ".join(text.split()) for text in entries[1::2])
    return dict(zip(entries[::2], (re.split(r"(?<=\.) (?=[A-Z])", text)[0] for text in texts), strict=True))


def call_with(function: Callable[..., Any], values: Mapping[str, Any], screen: Any) -> Any:
    """Call the function of a command with the values that its user gave, and the ``screen`` if it takes one."""
    values = {name: value for name, value in values.items() if value is not None}
    positional: list[Any] = []
    parameters = inspect.signature(function).parameters
    values |= {name: screen for name in ("watch", "screen") if name in parameters}
    for parameter in parameters.values():
        if takes_argument(parameter) and parameter.name in values:
            value = values.pop(parameter.name)
            positional += value if parameter.kind is parameter.VAR_POSITIONAL else [value]
    return function(*positional, **values)


class PlainCommand(TyperCommand):
    """A command whose help marks repeatable options and shows no types of Python."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Pieces of the usage, without braces around required arguments."""
        return [re.sub("[{}]", "", piece) for piece in super().collect_usage_pieces(ctx)]

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
        if record := parameter.get_help_record(ctx):
            name = re.sub(r" <[^>]*>$", "", record[0])
            text = re.sub(r"(\[default: )\((.*)\)(?=[];])", r"\1\2", record[1])
            option = parameter.param_type_name == "option"
            if option and parameter.multiple:
                text = f"{text[:-1]}; repeatable]" if text.endswith("]") else f"{text}  [repeatable]"
            rows["Options" if option else "Arguments"].append((name, text))
    return rows
