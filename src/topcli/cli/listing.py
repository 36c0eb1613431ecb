"""``topcli list``: tops, schemes, measures, scenes, sweeps, cases, figures and runs; ``topcli cite``: their works."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from topcli.cli.app import Command
from topcli.cli.options import Json, complete_scheme, complete_top, option, top_option
from topcli.cli.output import emit_text, print_cells, print_json, print_message
from topcli.errors import shortened
from topcli.table import DASH, Cells

list_app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="List tops, schemes, scenes, figures, runs and more.",
)

OnlyTop = Annotated[str | None, top_option("all")]


class Listing(NamedTuple):
    """Items as plain data, the keys that the table shows, and what is said if there is no item.

    The column of ``form`` is called top; ``origin`` is shown if an item does not come with topcli.
    """

    items: Sequence[dict[str, Any]]
    columns: Sequence[str]
    nothing: str = ""


def _listed(listing: Callable[..., Listing | None]) -> None:
    """Make the command ``topcli list NAME`` out of the function ``NAME``."""
    kind = listing.__name__

    @wraps(listing)
    def command(as_json: bool, **options: Any) -> None:
        listed = listing(as_json=as_json, **options)
        if listed is None:
            return
        if as_json:
            print_json(f"list {kind}", {kind: listed.items})
        elif listed.items:
            print_cells(_cells(listed), whole=True)
        else:
            print_message(listed.nothing or f"no {kind}")

    list_app.command(cls=Command, name=kind)(command)


def _cells(listing: Listing) -> Cells:
    items, keys = listing.items, listing.columns
    if any(item.get("origin", "topcli") != "topcli" for item in items):
        keys = [*keys, "origin"]
    kinds = [{type(item[key]) for item in items} - {type(None)} for key in keys]
    numbers = [i for i, kind in enumerate(kinds) if kind and kind <= {int, float}]
    heads = ["top" if key == "form" else key.replace("_", "-") for key in keys]
    return Cells("", heads, [[_text(item[key]) for key in keys] for item in items], numbers=numbers)


def _text(value: Any) -> str:
    if value is None:
        return DASH
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        value = [key if part is None else f"{key} = {_text(part)}" for key, part in value.items()]
    if isinstance(value, list):
        return ", ".join(map(str, value)) or DASH
    return f"{value:g}" if isinstance(value, float) else str(value)


def _fields(thing: object, *names: str) -> dict[str, Any]:
    return {name: getattr(thing, name) for name in names}


def _forms(top: str | None) -> Iterable[str]:
    """Forms of a top, or of all. Raises UnknownNameError."""
    from topcli.schemes.own_tops import forms
    from topcli.tops import TOPS

    return [form.form for form in forms(top)] if top else TOPS


def print_plugin_failures() -> None:
    """Import the plugins of installed packages, and report those that fail."""
    from topcli.schemes.plugins import plugin_failures

    for failure in plugin_failures():
        print_message(str(failure))


@_listed
def tops(as_json: Json = False) -> Listing:
    """List the tops with their parameters and invariants.

    The parameters are keys of a config. The argument p of a step function in Python has other numbers: the constants
    of the equations of motion.
    """
    from topcli.schemes.own_tops import top_origin
    from topcli.tops import TOPS

    print_plugin_failures()  # tops of installed packages are listed too
    items = [
        {
            "name": top.kind,
            **_fields(top, "form", "title"),
            "parameters": {name: field.default for name, field in top.model_fields.items()},
            "step_p": list(top.step_constants),
            "components": list(top.components),
            "invariants": [invariant.name for invariant in top.new().invariants()],
            "citation": top.citation,
            "origin": top_origin(top),
        }
        for top in TOPS.values()
    ]
    return Listing(items, ["form", "title", "parameters", "invariants"])


@_listed
def schemes(
    top: OnlyTop = None,
    as_json: Json = False,
) -> Listing:
    """List the schemes with their declared properties.

    A plugin that cannot be loaded is reported on stderr.
    """
    from topcli.schemes.registry import all_schemes
    from topcli.studies.describe import scheme_data

    wanted = _forms(top)
    items = [scheme_data(scheme) for scheme in all_schemes() if scheme.top in wanted]
    for item in items:
        item["options"] = {name: str(option["default"]) for name, option in item["options"].items()}
    print_plugin_failures()
    return Listing(items, ["name", "top", "title", "order", "conserves"])


@_listed
def compositions(as_json: Json = False) -> Listing:
    """List the compositions that raise a scheme's order.

    A composed scheme is written scheme+composition, for example hk+suzuki4. The scheme must be self-adjoint.
    """
    from topcli.schemes.compose import COMPOSITIONS

    items = [asdict(composition) | _fields(composition, "stages") for composition in COMPOSITIONS.values()]
    return Listing(items, ["name", "order", "stages", "title", "citation"])


@_listed
def scenes(top: OnlyTop = None, as_json: Json = False) -> Listing:
    """List the packaged scenes: configs that can be run by name."""
    from topcli.config import load

    items = [
        {
            "name": name,
            "top": first.top.form,
            "scheme": first.scheme.name,
            **_fields(first, "h", "N"),
            "trajectories": count,
            "about": about,
        }
        for name, first, count, about in load.scenes(top)
    ]
    return Listing(items, ["name", "top", "scheme", "about"])


@_listed
def sweeps(as_json: Json = False) -> Listing:
    """List the packaged sweeps for topcli sweep."""
    from topcli.config.files import first_sentence, sweep_files
    from topcli.config.sweep import load_sweep

    items = [
        {"name": name, "varied": list(load_sweep(name).keys), "about": first_sentence(path)}
        for name, path in sweep_files().items()
    ]
    return Listing(items, ["name", "varied", "about"])


@_listed
def cases(top: OnlyTop = None, as_json: Json = False) -> Listing:
    """List the hard cases of topcli stress."""
    from topcli.studies.stress import cases_of, forms_with_cases

    print_plugin_failures()
    forms = forms_with_cases() if top is None else _forms(top)
    cases = [(form, name, case) for form in forms for name, case in cases_of(form).items()]
    items = [{"name": name, "top": form, "question": case.question} for form, name, case in cases]
    return Listing(items, ["name", "top", "question"])


@_listed
def measures(top: OnlyTop = None, as_json: Json = False) -> Listing:
    """List the measures of topcli sweep.

    With --top, measures such as drift.NAME are listed once for each invariant of the top.
    """
    from topcli.sweeps.measures import all_measures, measures_of_form

    listed = all_measures() if top is None else measures_of_form(next(iter(_forms(top))))
    items = [_fields(measure, "name", "unit", "summary", "of_failed", "reproducible", "origin") for measure in listed]
    print_plugin_failures()
    return Listing(items, ["name", "unit", "summary"])


@_listed
def figures(as_json: Json = False) -> Listing:
    """List the figures that topcli plot draws."""
    from topcli.figures.catalogue import FIGURES

    print_plugin_failures()
    return Listing(
        [_fields(figure, "name", "title", "origin") for figure in FIGURES.values()],
        ["name", "title"],
    )


def _short(item: dict[str, Any]) -> dict[str, Any]:
    """A run with short cells for the table; the manifest may come from elsewhere and hold anything."""
    cells = {
        key: value if value is None or isinstance(value, int | float) else shortened(str(value))
        for key, value in item.items()
    }
    return {**cells, "name": item["name"], "ended": item["ended"] and _local_time(item["ended"])}


def _local_time(stamp: object) -> str:
    """Timestamp of a manifest to the minute, in local time; anything else is returned shortened."""
    from datetime import datetime

    try:
        return datetime.fromisoformat(str(stamp)).astimezone().strftime("%Y-%m-%d %H:%M")
    except (ValueError, OverflowError, OSError):
        return shortened(str(stamp))


@_listed
def runs(
    results: Annotated[Path | None, option("--results", metavar="DIR", default="results")] = None,
    as_json: Json = False,
) -> Listing:
    """List runs and sweeps in a folder, including unfinished ones.

    The outcome of a run is "running" while another process computes it, and "killed" if that process ended before the
    run did. To continue an unfinished run or sweep, use topcli run or topcli sweep with the same config. For a sweep,
    the columns step and N count rows.
    """
    from topcli.errors import UsageError
    from topcli.runs.run import listed_runs

    if results is not None and not os.path.isdir(results):
        raise UsageError(f"--results {results}: no such folder")
    folder = results or Path("results")
    items = listed_runs(folder)
    progress = ["step"] if any(not item["ended"] or item["outcome"] == "interrupted" for item in items) else []
    kind = ["kind"] if any(item["kind"] != "run" for item in items) else []
    columns = ["name", *kind, "outcome", *progress, "N", "scheme", "h", "ended"]
    return Listing(items if as_json else list(map(_short, items)), columns, f"no runs in {folder}")


def complete_cited(incomplete: str) -> list[str]:
    """Names of tops and schemes that begin with ``incomplete``."""
    return [*complete_top(incomplete), *complete_scheme(incomplete)]


def cite(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCHEME|TOP",
            help="Names of schemes, compositions and tops.",
            show_default="topcli and the paper",
            autocompletion=complete_cited,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Print the BibTeX of a scheme, a top, or topcli itself."""
    from topcli.studies.cite import OWN, bibliography, works_of

    works = {} if names else {key: bibliography()[key][0] for key in OWN}
    for name in names or ():
        works |= works_of(name)
    if as_json:
        print_json("cite", {"entries": [{"key": key, "bibtex": bibtex} for key, bibtex in works.items()]})
    else:
        emit_text("\n\n".join(works.values()))
