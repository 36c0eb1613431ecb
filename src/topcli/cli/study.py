"""The command of a study: an option for each parameter of ``measure``, the same output for all."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import typer

from topcli.cli.options import (
    HELP,
    Force,
    Json,
    Out,
    PictureFormats,
    Plot,
    Quiet,
    Results,
    Save,
    Verbose,
    complete_config,
    complete_scheme,
    complete_top,
    picture_formats,
    require_new,
    stored_place,
    write_text,
)
from topcli.cli.output import (
    ProgressDisplay,
    emit,
    emit_prose,
    emit_text,
    messages,
    print_cells,
    print_json,
    print_message,
    print_warnings,
)
from topcli.errors import UsageError
from topcli.show.tables import ENDINGS, tables_of
from topcli.store.files import is_study, require_writable, write_study
from topcli.studies import Watch, imported
from topcli.studies.study import Flag, Result, Study
from topcli.table import Table

SAVED = (".json", ".csv", ".md", ".tex")
"""Endings of the files of ``--save``; ``topcli report`` reads JSON."""
COMPLETE = {"SCHEME": complete_scheme, "TOP": complete_top, "CONFIG": complete_config}


class _CommandWatch(Watch):
    """Watch that prints messages and progress; pictures and stored results need a folder that can be written."""

    def __init__(self, study: Study, as_json: bool, quiet: bool, folder: Path | None, plot: bool) -> None:
        self._display, self._quiet = ProgressDisplay(1, as_json or quiet, unit=study.unit), quiet
        self._folder, self._plot = folder, plot

    def begin(self, name: str, *experiments: Any, file: Path | None = None) -> None:
        """Print warnings about the experiments and require the folder."""
        for experiment in () if self._quiet else experiments:
            print_warnings(experiment)
        if self._folder is not None and (self._plot or file is not None):
            require_writable(self._folder)
        self._display.begin(name)

    def message(self, line: str) -> None:
        """Print a message."""
        messages(self._quiet)(line)

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Show the progress."""
        self._display(done, total, note)

    def close(self) -> None:
        """Remove the progress."""
        self._display.close()


def _shared_options(study: Study) -> dict[str, tuple[Any, Any]]:
    """Options that a study does not declare itself, with their defaults, by the name of the parameter."""
    shared: dict[str, tuple[Any, Any]] = {}
    if study.figure and study.draws:
        shared |= {"plot": (Plot, False), "formats": (PictureFormats, None)}
    if shared or study.file:
        shared |= {"out": (Out, Path("results") if study.file else Path("results/figures"))}
    shared |= {"save": (Save, None), "force": (Force, False), "verbose": (Verbose, False)}
    return {**shared, "as_json": (Json, False), "quiet": (Quiet, False)}


def command(study: Study) -> Callable[..., None]:
    """Command of a study: measure, store, draw, print, and exit with the code of its faults."""
    measured = [p for p in inspect.signature(study.measure, eval_str=True).parameters.values() if p.name != "watch"]
    flags = []
    if study.printed:
        flags = list(inspect.signature(study.printed, eval_str=True).parameters.values())[2:]
    stored = [p.name for p in measured if _flag(p)[1].metavar == "RUN"]
    shared = {"results": (Results, Path("results"))} if stored else {}
    shared |= _shared_options(study)

    def call(
        *,
        as_json: bool,
        verbose: bool,
        quiet: bool,
        force: bool,
        save: Path | None,
        plot: bool = False,
        formats: list[str] | None = None,
        out: Path | None = None,
        results: Path = Path("results"),
        **given: Any,
    ) -> None:
        if save is not None:
            if save.suffix not in SAVED:
                known = ", ".join(SAVED[:-1]) + f" or {SAVED[-1]}"
                raise UsageError(f"--save {save}: unknown type of file; use a name ending in {known}")
            require_new(save, force, "--save")
        for alone in [_flag(flag)[1].option for flag in flags if _flag(flag)[1].alone and given[flag.name]]:
            if as_json:
                raise UsageError(f"--json and {alone} cannot be used together; choose one")
        if formats and not plot:
            raise UsageError("--format: describes a picture; add --plot")
        chosen = picture_formats(formats) if plot else ()
        for name in stored:
            given[name] = [stored_place(one, results) for one in given[name]]
        arguments, options = _arguments(measured, given)
        watch = _CommandWatch(study, as_json, quiet, out, plot)
        try:
            result = study.measure(*arguments, **options, watch=watch)
        finally:
            watch.close()
        if not (as_json or quiet):
            _print(study, result, verbose, {flag.name: given[flag.name] for flag in flags})
        files = list(map(str, _saved(study, result, save, force))) if save is not None else []
        files += _written(study, result, out, force, chosen)
        if as_json:
            print_json(study.name, {**result.data, "files": files} if out else result.data)
        for file in files if not (as_json or quiet) else ():
            print_message(f"wrote {file}")
        report_faults(study, result, quiet)

    helps = _helps(study.measure.__doc__) | (_helps(study.printed.__doc__) if study.printed else {})
    made = [option for p in (*measured, *flags) if (option := _option(p, helps.get(p.name, ""))) is not None]
    made += [_parameter(name, annotation, default) for name, (annotation, default) in shared.items()]
    call.__signature__ = inspect.Signature(made)  # pyright: ignore[reportFunctionMemberAccess]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in made}
    call.__doc__ = (study.measure.__doc__ or "").partition("Parameters\n")[0]
    if study.figure and study.draws:
        call.__doc__ += f"With --plot, draw {study.draws}.\n"
    return call


def report_faults(study: Study, result: Result, quiet: bool) -> None:
    """Print notes and faults, also plugins that failed, and exit with the code of the faults."""
    from topcli.schemes.plugins import FAILURES

    for line in () if quiet else study.notes(result.data):
        print_message(line)
    code, lines = study.faults(result.data)
    for line in lines:
        print_message(f"error: {line}")
    for failure in FAILURES:
        if not any(str(failure) in line for line in lines):
            print_message(str(failure))
    if code:
        raise typer.Exit(code)


def _print(study: Study, result: Result, verbose: bool, flags: Mapping[str, Any]) -> None:
    """Print tables and sentences of a result, with empty lines around tables."""
    data = result.data
    before: Table | str | None = None
    for part in study.printed_of(result, verbose, **flags):
        if before is not None and not (isinstance(before, str) and isinstance(part, str)):
            emit()
        if isinstance(part, str):
            (emit_text if "\n" in part else emit_prose)(part)
        else:
            print_cells(part.cells(data, verbose), part.title_of(data))
        before = part


def _saved(study: Study, result: Result, path: Path, force: bool) -> list[Path]:
    """Store a result in the format of the ending of ``path``: all data as JSON, or its tables.

    CSV has the DataFrames of the Python interface: the first in ``path``, each other one in a file that ends in its
    name.
    Raises UsageError if such a file exists, unless ``force``.
    """
    if path.suffix == ".json":
        return [study.write(result, path)]
    tables, form = tables_of(study, result.data), ENDINGS[path.suffix]
    if form == "csv":
        filled = tables.filled
        names = [path, *(path.with_stem(f"{path.stem}_{re.sub('[ /]', '_', table.name)}") for table in filled[1:])]
        texts = [table.text(result.data, form) for table in filled]
    else:
        names, texts = [path], [tables.text(form)]
    for name in names:
        require_new(name, force, "--save")
    for name, text in zip(names, texts, strict=True):
        write_text(text, name, "--save")
    return names


def _written(study: Study, result: Result, out: Path | None, force: bool, formats: Sequence[str]) -> list[str]:
    """Store the result of the default options, and draw the figure in the ``formats`` if there are any; the files.

    Raises UsageError if there are other files, unless ``force``.
    """
    files: list[Path] = []
    if out is not None and result.file is not None:
        path = out / result.file
        if not force and not is_study(path):
            require_new(path, force)
        files.append(write_study(path, result.data))
    if out is not None and formats:
        from topcli.figures.figure import write_figure

        loaded = imported(study.figure)(result)
        folder = out / "figures" if study.file else out
        if loaded.panels:
            files += write_figure(study.figure_name(result.data), loaded, folder, formats, force)
    return [str(file) for file in files]


def _arguments(parameters: Sequence[inspect.Parameter], given: Mapping[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Arguments of ``measure`` from the values of the command line; what was not given keeps its default."""
    arguments: list[Any] = []
    options: dict[str, Any] = {}
    for parameter in parameters:
        value = given.get(parameter.name)
        if value is None:
            continue
        flag = _flag(parameter)[1]
        value = flag.read(value) if flag.read else value
        if parameter.kind is inspect.Parameter.VAR_POSITIONAL:
            arguments += value
        elif flag.option:
            options[parameter.name] = value
        else:
            arguments.append(value)
    return arguments, options


def _flag(parameter: inspect.Parameter) -> tuple[Any, Flag]:
    """Type of a parameter and its place on the command line."""
    annotation, flag = parameter.annotation, Flag("--" + parameter.name.replace("_", "-"))
    if get_origin(annotation) is Annotated:
        annotation, *notes = get_args(annotation)
        flag = next((note for note in notes if isinstance(note, Flag)), flag)
    return annotation, flag


def _option(parameter: inspect.Parameter, text: str) -> inspect.Parameter | None:
    """Parameter of the command for a ``parameter`` of ``measure``; None if the command has none."""
    annotation, flag = _flag(parameter)
    if flag.option == "-" or parameter.kind is inspect.Parameter.VAR_KEYWORD:
        return None
    several = parameter.kind is inspect.Parameter.VAR_POSITIONAL
    required = flag.required or (parameter.default is inspect.Parameter.empty and not several)
    default = None if parameter.default in (inspect.Parameter.empty, ()) else parameter.default
    kind, several = _plain(annotation, several)
    kind = str if flag.read else kind
    kind = list[kind] if several or flag.several else kind
    shown: dict[str, Any] = {
        "help": HELP.get(flag.option.split()[0], text) if flag.option else text,
        "autocompletion": COMPLETE.get(flag.metavar.partition("[")[0]),
    }
    if flag.names is not None:
        shown["autocompletion"] = _completion(flag.names)
    given = {"metavar": flag.metavar, "show_default": flag.default, "min": flag.least, "max": flag.most}
    shown |= {key: value for key, value in given.items() if value not in ("", None)}
    declared = typer.Option(*flag.option.split(), **shown) if flag.option else typer.Argument(**shown)
    annotated = Annotated[kind if required or default is not None else kind | None, declared]
    return _parameter(parameter.name, annotated, inspect.Parameter.empty if required else default)


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _plain(annotation: Any, several: bool) -> tuple[Any, bool]:
    """Type of a value on the command line, and whether the option may be repeated."""
    if get_origin(annotation) in (Union, UnionType):
        annotation = next(kind for kind in get_args(annotation) if kind is not NoneType)
    if get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Sequence, list):
        return _plain(get_args(annotation)[0], True)
    return annotation, several


def _completion(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    return lambda incomplete: [name for name in names() if name.startswith(incomplete.lower())]


def _helps(doc: str | None) -> dict[str, str]:
    """First sentence on each parameter of a NumPy docstring."""
    section = (doc or "").partition("Parameters\n")[2]
    section = re.split(r"\n *\n *\w+\n *-{3,}", section)[0]
    entries = re.split(r"^ {4}\*{0,2}(\w+)(?: : .*)?\n", section, flags=re.MULTILINE)[1:]
    texts = (" ".join(text.split()) for text in entries[1::2])
    return dict(zip(entries[::2], (re.split(r"(?<=\.) (?=[A-Z])", text)[0] for text in texts), strict=True))
