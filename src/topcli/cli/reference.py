"""Commands about what topcli offers: ``topcli list``, ``show``, ``cite``, ``init`` and ``schema``."""

from __future__ import annotations

import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from topcli.cli.output import WIDTH, CommandResult, Screen, print_message, width_of
from topcli.cli.results import require_new_file, stored_place
from topcli.errors import UsageError, quoted
from topcli.table import DASH, Cells

if TYPE_CHECKING:
    from topcli.config.models import Experiment

Item = dict[str, Any]
_Kind = Literal["tops", "schemes", "compositions", "scenes", "sweeps", "cases", "measures", "figures", "runs"]


def tops() -> Iterable[Item]:
    """Tops with their parameters, the keys of a config, and the constants ``step_p`` of a step in Python."""
    from topcli.tops import TOPS, top_origin

    for top in TOPS.values():
        yield {
            "name": top.kind,
            **fields(top, "form", "title"),
            "parameters": {name: field.default for name, field in top.model_fields.items()},
            "step_p": list(top.step_constants),
            "components": list(top.components),
            "invariants": [invariant.name for invariant in top.new().invariants()],
            "citation": top.citation,
            "origin": top_origin(top),
        }


def schemes(top: str | None) -> Iterable[Item]:
    """Schemes of a top, or of all, with their declared properties."""
    from topcli.schemes.registry import all_schemes
    from topcli.studies.describe import scheme_data

    forms = forms_of(top)
    return [scheme_data(scheme) for scheme in all_schemes() if scheme.top in forms]


def compositions() -> Iterable[Item]:
    """Compositions, each written scheme+composition, for example hk+suzuki4."""
    from topcli.schemes.compose import COMPOSITIONS

    return [asdict(composition) | fields(composition, "stages") for composition in COMPOSITIONS.values()]


def scenes(top: str | None) -> Iterable[Item]:
    """Packaged configs of a top, or of all."""
    from topcli.config import load

    for name, first, count, about in load.packaged_scenes(top):
        item = {"name": name, "top": first.top.form, "scheme": first.scheme.name, **fields(first, "h", "N")}
        yield {**item, "trajectories": count, "about": about}


def sweeps() -> Iterable[Item]:
    """Packaged sweep files."""
    from topcli.config.files import first_sentence, sweep_files
    from topcli.config.sweep import load_sweep

    for name, path in sweep_files().items():
        yield {"name": name, "varied": list(load_sweep(name).keys), "about": first_sentence(path)}


def cases(top: str | None) -> Iterable[Item]:
    """Hard cases of ``topcli stress`` for a top, or for all."""
    from topcli.studies.stress import cases_of, forms_with_cases

    for form in forms_with_cases() if top is None else forms_of(top):
        for name, case in cases_of(form).items():
            yield {"name": name, "top": form, "question": case.question}


def measures() -> Iterable[Item]:
    """Measures of ``topcli sweep``; NAME stands for the name of an invariant, a column or a counter."""
    from topcli.sweeps.measures import all_measures

    for measure in all_measures():
        yield fields(measure, "name", "unit", "summary", "of_failed", "origin")


def figures() -> Iterable[Item]:
    """Figures that ``topcli plot`` draws."""
    from topcli.figures.catalogue import FIGURES

    return [fields(figure, "name", "title", "origin") for figure in FIGURES.values()]


def runs(results: Path) -> Iterable[Item]:
    """Runs and sweeps in a folder, including unfinished ones."""
    from topcli.runs.run import listed_runs

    if not os.path.isdir(results) and results != Path("results"):
        raise UsageError(f"--results {results}: no such folder")
    return listed_runs(results)


LISTS: dict[_Kind, tuple[Callable[..., Iterable[Item]], str]] = {
    "tops": (tops, "form title parameters invariants"),
    "schemes": (schemes, "name top title order conserves"),
    "compositions": (compositions, "name order stages title citation"),
    "scenes": (scenes, "name top scheme about"),
    "sweeps": (sweeps, "name varied about"),
    "cases": (cases, "name top question"),
    "measures": (measures, "name unit summary"),
    "figures": (figures, "name title"),
    "runs": (runs, "name kind outcome step N scheme h ended"),
}
"""Function and columns of each list; the function takes the ``top`` or the folder of ``results``, or nothing."""


def list_command(
    items: _Kind, *, top: str | None = None, results: Path = Path("results"), screen: Screen
) -> CommandResult:
    """List tops, schemes, scenes, figures, runs and more.

    Scenes are packaged configs, which run by name; sweeps are packaged sweep files. The outcome of a run is "running"
    while another process computes it, and "killed" if that process ended before the run did. To continue an unfinished
    run or sweep, run it again. For a sweep, the columns step and N count rows.

    Parameters
    ----------
    items : str
        One of tops, schemes, compositions, scenes, sweeps, cases, measures, figures, runs.
    """
    from topcli.plugins import plugin_failures

    for failure in plugin_failures().values():  # items of installed packages are listed too
        print_message(failure)
    function, columns = LISTS[items]
    takes = inspect.signature(function).parameters
    if top is not None and "top" not in takes:
        raise UsageError(f"--top: not for topcli list {items}; it chooses schemes, scenes and cases")
    listed = list(function(**{name: value for name, value in (("top", top), ("results", results)) if name in takes}))
    if listed:
        screen.show(list_table(listed, columns.split()), width=10**6)
    else:
        screen.say(f"no {items} in {results}" if items == "runs" else f"no {items}")
    return CommandResult({"command": f"list {items}", items: listed})


def list_table(items: Sequence[Item], keys: Sequence[str]) -> Cells:
    """Table of the ``keys`` of items; the origin is shown if an item does not come with topcli."""
    keys = [*keys, "origin"] if any(item.get("origin", "topcli") != "topcli" for item in items) else keys
    kinds = [{type(item[key]) for item in items} - {type(None)} for key in keys]
    numbers = [i for i, kind in enumerate(kinds) if kind and kind <= {int, float}]
    heads = ["top" if key == "form" else key for key in keys]
    return Cells("", heads, [[text_of(item[key]) for key in keys] for item in items], numbers=numbers)


def text_of(value: Any) -> str:
    """Cell of a list; a time is shown to the minute, in local time."""
    if isinstance(value, dict):
        value = [key if part is None else f"{key} = {text_of(part)}" for key, part in value.items()]
    if isinstance(value, list):
        return ", ".join(map(str, value)) or DASH
    if isinstance(value, str) and re.fullmatch(r"\d{4}-\d\d-\d\dT.*", value):
        return datetime.fromisoformat(value).astimezone().strftime("%Y-%m-%d %H:%M")
    return DASH if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def fields(record: object, *names: str) -> Item:
    """Attributes of an object by name."""
    return {name: getattr(record, name) for name in names}


def forms_of(top: str | None) -> Sequence[str]:
    """Forms of a top, or of all. Raises UnknownNameError."""
    from topcli.tops import TOPS, forms

    return [form.form for form in forms(top)] if top else list(TOPS)


def cite_command(cited: Sequence[str] = (), *, screen: Screen) -> CommandResult:
    """Print the BibTeX of a scheme, a top, or topcli itself.

    Parameters
    ----------
    cited : sequence of str, optional
        Names of schemes, compositions and tops; by default topcli and the paper.
    """
    from topcli.studies.cite import ALWAYS, bibliography, works_of

    works = {} if cited else {key: bibliography()[key][0] for key in ALWAYS}
    for name in cited:
        works |= works_of(name)
    screen.show("\n\n".join(works.values()))
    return CommandResult({"entries": [{"key": key, "bibtex": bibtex} for key, bibtex in works.items()]})


def show_command(
    subject: str,
    *,
    row: int | None = None,
    top: str | None = None,
    source: bool = False,
    motion: bool = False,
    overrides: Sequence[str] = (),
    results: Path = Path("results"),
    screen: Screen,
) -> CommandResult:
    """Show a config, a scheme, a top, or a row of a sweep.

    Parameters
    ----------
    subject : str
        Config file, packaged scene, scheme, top, or folder of a run or sweep.
    row : int, optional
        Show this row of a stored sweep as a config.
    source : bool, optional
        Show the code generated for a scheme from the equations of motion.
    motion : bool, optional
        Show the class, frequencies and periods of the exact motion.
    """
    from topcli.config.files import is_config, scene_files
    from topcli.config.load import load, load_experiment
    from topcli.errors import UnknownNameError, nearest
    from topcli.schemes.registry import all_schemes
    from topcli.studies import describe
    from topcli.studies.entries import schemes_called
    from topcli.tops import forms, top_names

    folder, config = Path(subject), Path(subject) / "config.yaml"
    if row is not None or (folder.is_dir() and not config.is_file()):
        return show_sweep(stored_place(subject, results), row, overrides, motion, screen)
    config = str(config) if folder.is_dir() else subject
    if motion:
        return show_experiment(load_experiment(config, overrides, any_precision=True), motion, screen)
    # one word may be a scene, a scheme or a top; files, folders and changed configs are none of the latter two
    is_name = not overrides and not folder.suffix and not folder.is_dir()
    names = {scheme.name for scheme in all_schemes()} if is_name else set()
    is_scheme = subject.lower().partition("+")[0] in names
    of_name = schemes_called(subject, [form.form for form in forms(top)] if top else ()) if is_scheme else []
    if (top or source) and not of_name:
        raise UsageError(f"--{'top' if top else 'source'}: needs the name of a scheme, not {quoted(subject)}")
    width = min(WIDTH, width_of(sys.stdout))
    if source:
        code = describe.generated_source(of_name)
        screen.show(code.removesuffix("\n"))
        return CommandResult({"source": code})
    if is_name and subject.lower() in top_names():
        described = [form.new() for form in forms(subject)]
        screen.show("\n\n".join(describe.top_text(each, width) for each in described))
        return CommandResult({"tops": [describe.top_data(each) for each in described]})
    if of_name:
        screen.show(describe.schemes_text(of_name, width))
        return CommandResult({"schemes": [describe.scheme_data(scheme) for scheme in of_name]})
    if is_name and not is_config(subject):
        hint = nearest(subject, {*names, *scene_files(), *top_names()}, "topcli list scenes")
        files = "(configs end in .yaml, .yml or .toml)"
        raise UnknownNameError(f"no packaged scene, scheme or top is called {quoted(subject)} {files}; {hint}")
    return show_experiment(load(config, overrides, rename=True), motion, screen)


def show_experiment(experiment: Experiment, motion: bool, screen: Screen) -> CommandResult:
    """Print the resolved config of an experiment, or what the closed form says about its ``motion``."""
    data = {"config": experiment.resolved(), "digest": experiment.digest}
    if not motion:
        screen.show(experiment.to_yaml().removesuffix("\n"))
        return CommandResult(data)
    from topcli.analysis.motion import motion_table
    from topcli.analysis.motion.of_top import motion_of

    of_top = motion_of(experiment.top, experiment.y0)
    screen.show(replace(motion_table(of_top).cells(), title=f"{experiment.name}: {of_top.title}"))
    return CommandResult({**data, "motion": of_top.as_dict()})


def show_sweep(
    folder: Path, number: int | None, overrides: Sequence[str], motion: bool, screen: Screen
) -> CommandResult:
    """Print a row of the sweep in ``folder``, or the whole sweep file if ``number`` is None."""
    from topcli.config.load import load_experiment
    from topcli.sweeps.store import stored_sweep_file

    sweep = stored_sweep_file(folder, overrides if number is None else [])
    if number is None:
        if motion:
            raise UsageError("--motion: needs a single experiment; choose a row of the sweep with --row")
        screen.show(sweep.to_yaml().removesuffix("\n"))
        return CommandResult({"sweep": sweep.resolved(), "digest": sweep.digest})
    try:
        row = sweep.row(number)
    except IndexError as error:
        raise UsageError(f"{folder}: {error}") from None
    return show_experiment(load_experiment(row.resolved(), overrides, any_precision=True), motion, screen)


def init_command(
    path: Path = Path("experiment.yaml"), *, config: str = "kowalevski_hk", force: bool = False, screen: Screen
) -> CommandResult:
    """Copy a packaged scene as a config to start from.

    The JSON Schema of configs is written to the same folder, where text editors find it.

    Parameters
    ----------
    path : path, optional
        Path of the config, .yaml or .toml.
    """
    from topcli.config.files import find_config
    from topcli.config.schema import config_schema
    from topcli.store.files import json_text, write_by_ending

    schema_path, scene = path.with_name("topcli.schema.json"), find_config(config)
    if path.suffix != scene.suffix:
        raise UsageError(f"{path}: {config} is in another format; use a name that ends in {scene.suffix}")
    require_new_file(path, force, "")
    unnamed = re.sub(r"^name *[:=].*\n", "", scene.read_text(encoding="utf-8"), count=1, flags=re.MULTILINE)
    modeline = "#:schema " if path.suffix == ".toml" else "# yaml-language-server: $schema="
    write_by_ending(path, {scene.suffix: lambda: f"{modeline}{schema_path.name}\n{unnamed}"})
    write_by_ending(schema_path, {".json": lambda: json_text(config_schema())})
    screen.show(str(path))
    screen.say(f"wrote {path} and {schema_path}")
    screen.say(f"next: topcli run {path}")
    return CommandResult({"files": [str(path), str(schema_path)]})


def schema_command(*, screen: Screen) -> CommandResult:
    """Print the JSON Schema of the config."""
    from topcli.config.schema import config_schema
    from topcli.store.files import json_text

    screen.show(json_text(config_schema()).removesuffix("\n"))
    return CommandResult({"schema": config_schema()})
