"""The command of a study: its options, help and defaults are read from the function, its output from the report."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Sequence
from dataclasses import field, make_dataclass
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer

from topcli.cli.options import (
    HELP,
    Force,
    Json,
    Plot,
    Quiet,
    Save,
    Verbose,
    complete_config,
    complete_scheme,
    complete_top,
    require_new,
)
from topcli.cli.output import (
    ProgressDisplay,
    emit,
    emit_prose,
    print_cells,
    print_document,
    print_message,
    print_warnings,
)
from topcli.errors import UsageError, shortened
from topcli.studies import Watch
from topcli.studies.report import PICTURES, TABLES, Report

NAMES = {"overrides": "--set", "sizes": "--h"}
"""Options that have another name than their parameter."""
METAVARS = {
    "config": "CONFIG",
    "entries": "SCHEME[:KEY=VALUE,...]",
    "file": "FILE",
    "overrides": "KEY=VALUE",
    "path": "FILE",
    "scheme": "SCHEME",
    "schemes": "SCHEME",
    "top": "TOP",
}
"""Words for values in the help; other numbers are N or X, other texts NAME."""
COMPLETE = {"SCHEME": complete_scheme, "TOP": complete_top, "CONFIG": complete_config}
SHARED = {
    "plot": (Plot, None),
    "save": (Save, None),
    "force": (Force, False),
    "verbose": (Verbose, False),
    "as_json": (Json, False),
    "quiet": (Quiet, False),
}
"""Options of all studies, with their defaults."""


def options_of(study: Callable[..., Report]) -> type:
    """Dataclass whose fields are the arguments and options of the command of a study."""
    helps = parameter_helps(study.__doc__)
    fields = [
        study_option(parameter, helps.get(parameter.name, ""))
        for parameter in inspect.signature(study, eval_str=True).parameters.values()
        if parameter.kind is not inspect.Parameter.VAR_KEYWORD and parameter.name != "watch"
    ]
    fields += [(name, annotation, field(default=default)) for name, (annotation, default) in SHARED.items()]
    doc = (study.__doc__ or "").partition("Parameters\n")[0]
    return make_dataclass(study.__name__, fields, kw_only=True, namespace={"__doc__": doc})


def run(study: Callable[..., Report], options: Any) -> None:
    """Call a study, print its report, write files, and exit with the code of the report."""
    values = vars(options)
    plot, save, force, verbose, as_json, quiet = (values.pop(name) for name in SHARED)
    for name, path, endings in (("--plot", plot, PICTURES), ("--save", save, (".json", *TABLES))):
        if path is not None and path.suffix not in endings:
            known = ", ".join(endings[:-1]) + f" or {endings[-1]}"
            raise UsageError(f"{name} {path}: unknown type of file; use a name ending in {known}")
        if path is not None:
            require_new(path, force, name)
    positional: list[Any] = []
    for parameter in inspect.signature(study).parameters.values():
        if takes_argument(parameter) and (value := values.pop(parameter.name, None)) is not None:
            positional += value if isinstance(value, list) else [value]
    watch = _CommandWatch(as_json or quiet, quiet)
    try:
        report = study(*positional, **{name: value for name, value in values.items() if value is not None}, watch=watch)
    finally:
        watch.close()
    if as_json:
        print_document(report.as_dict())
    elif not quiet:
        print_report(report, verbose)
    files = [report.save(path) for path in (plot, save) if path is not None]
    for line in (*(f"wrote {file}" for file in files), *report.notes) if not (as_json or quiet) else ():
        print_message(line)
    print_faults(report)


def print_report(report: Report, verbose: bool) -> None:
    """Print title, answer and tables."""
    for line in (report.title, report.answer):
        if line:
            emit_prose(line)
    for table in report.tables:
        if table.rows and (verbose or table.detail is not True):
            emit()
            print_cells(table.cells(verbose), table.heading)


def print_faults(report: Report) -> None:
    """Print errors, also plugins that failed, and exit with the code of the report."""
    from topcli.schemes.plugins import FAILURES

    for line in report.errors:
        print_message(f"error: {line}")
    for failure in FAILURES:
        if not any(str(failure) in line for line in report.errors):
            print_message(str(failure))
    if report.code:
        raise typer.Exit(report.code)


class _CommandWatch(Watch):
    """Watch that prints warnings, messages and progress."""

    def __init__(self, no_progress: bool, quiet: bool) -> None:
        self._no_progress, self._quiet = no_progress, quiet
        self._display = ProgressDisplay(1, True)

    def begin(self, name: str, *experiments: Any, unit: str = "steps") -> None:
        for experiment in () if self._quiet else experiments:
            print_warnings(experiment)
        self._display = ProgressDisplay(1, self._no_progress, unit=unit)
        self._display.begin(name)

    def __call__(self, done: int, total: int, note: str = "") -> None:
        self._display(done, total, note)

    def close(self) -> None:
        """Remove the progress."""
        self._display.close()


def takes_argument(parameter: inspect.Parameter) -> bool:
    """True for a positional parameter other than the overrides, which is an argument of the command."""
    return parameter.kind is not inspect.Parameter.KEYWORD_ONLY and parameter.name not in NAMES


def study_option(parameter: inspect.Parameter, text: str) -> tuple[str, Any, Any]:
    """Field of the options for a ``parameter`` of a study: name, type with the option, and default."""
    kind, several = value_type(parameter.annotation)
    several = several or parameter.kind is inspect.Parameter.VAR_POSITIONAL
    words = {int: "N", float: "X", str: "NAME"}
    metavar = METAVARS.get(parameter.name) or words.get(kind) or "|".join(get_args(kind))
    shown: dict[str, Any] = {"autocompletion": COMPLETE.get(metavar.partition("[")[0])}
    shown |= {"metavar": metavar} if metavar else {}
    shown |= {"parser": whole_number} if kind is int else {}
    required = parameter.default is inspect.Parameter.empty and parameter.kind is not inspect.Parameter.VAR_POSITIONAL
    default = None if parameter.default in (inspect.Parameter.empty, ()) else parameter.default
    if takes_argument(parameter):
        declared = typer.Argument(help=text, **shown)
    else:
        name = NAMES.get(parameter.name, "--" + parameter.name.replace("_", "-"))
        declared = typer.Option(name, help=HELP.get(name, text), **shown)
    annotation = list[kind] if several else kind
    annotated = Annotated[annotation if required or default is not None else annotation | None, declared]
    return parameter.name, annotated, field() if required else field(default=default)


def value_type(annotation: Any) -> tuple[Any, bool]:
    """Type of a value on the command line, and True if there may be several."""
    kinds = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    for kind in kinds:
        if get_origin(kind) in (Sequence, list, tuple):
            return value_type(get_args(kind)[0])[0], True
    plain = [kind for kind in kinds if kind in (bool, int, float) or get_origin(kind) is Literal]
    return (plain or [str])[0], False


def whole_number(text: str) -> int:
    """Whole number, also written as 1e6."""
    try:
        if (value := float(text)) == int(value):
            return int(value)
    except (ValueError, OverflowError):
        pass
    raise typer.BadParameter(f"{shortened(text)} is not a whole number, such as 1000 or 1e6")


def parameter_helps(doc: str | None) -> dict[str, str]:
    """First sentence on each parameter of a NumPy docstring."""
    section = (doc or "").partition("Parameters\n")[2]
    section = re.split(r"\n *\n *\w+\n *-{3,}", section)[0]
    entries = re.split(r"^ {4}\*{0,2}([\w, *]+)(?: : .*)?\n", section, flags=re.MULTILINE)[1:]
    texts = (" ".join(text.split()) for text in entries[1::2])
    return dict(zip(entries[::2], (re.split(r"(?<=\.) (?=[A-Z])", text)[0] for text in texts), strict=True))
