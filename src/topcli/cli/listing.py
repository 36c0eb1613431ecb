"""``topcli list``: tops, schemes, measures, scenes, sweeps, cases, figures and runs."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.command import Command
from topcli.cli.options import Json, SchemeFiles, load_scheme_files, top_option
from topcli.cli.output import emit_text, print_json, print_message, print_table
from topcli.errors import shortened

list_app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="List tops, schemes, measures, scenes, sweeps, figures, runs.",
)

OnlyTop = Annotated[
    str | None,
    top_option("List only entries for this top."),
]


def _print_list(kind: str, items: list[dict[str, Any]], columns: list[str], as_json: bool, nothing: str = "") -> None:
    if as_json:
        print_json(f"list {kind}", {kind: items})
    elif items:
        header = [column.replace("_", "-") for column in columns]
        kinds = [{type(item[column]) for item in items} - {type(None)} for column in columns]
        numbers = [i for i, kind in enumerate(kinds) if kind and kind <= {int, float}]
        print_table(header, [[_cell(item[column]) for column in columns] for item in items], numbers=numbers)
    else:
        print_message(nothing or f"no {kind}")


def _origins(items: list[dict[str, Any]]) -> list[str]:
    """Column ``origin`` of a list, unless everything in it comes with topcli."""
    return ["origin"] if any(item["origin"] != "topcli" for item in items) else []


def _cell(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "–"
    return f"{value:g}" if isinstance(value, float) else str(value)


@list_app.command(cls=Command, name="tops")
def list_tops(as_json: Json = False) -> None:
    """List the tops with their parameters and invariants.

    The parameters are keys of a config. A step does not get them, but p, the constants of the equations of motion.
    """
    from topcli.tops import TOPS

    items = [
        {
            "name": top.kind,
            "form": top.form,
            "title": top.title,
            "parameters": {name: field.default for name, field in top.model_fields.items()},
            "step_p": list(top.step_constants),
            "components": list(top.components),
            "invariants": [invariant.name for invariant in top.new().invariants()],
            "citation": top.citation,
        }
        for top in TOPS.values()
    ]
    shown = [
        {**item, "top": item["form"], "parameters": [f"{k}={v}" for k, v in item["parameters"].items()]}
        for item in items
    ]
    _print_list("tops", items if as_json else shown, ["top", "title", "parameters", "step_p", "invariants"], as_json)


@list_app.command(cls=Command, name="schemes")
def list_schemes(
    top: OnlyTop = None,
    as_json: Json = False,
    as_markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the documentation page of the schemes.")
    ] = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """List the schemes with their declared traits.

    Plugins that failed are reported on stderr.
    """
    from topcli.schemes.registry import all_schemes, plugin_failures
    from topcli.studies.scheme_page import scheme_data, schemes_page
    from topcli.tops import forms

    load_scheme_files(scheme_files)
    wanted = [form.form for form in forms(top)] if top else None
    if as_markdown:
        emit_text(schemes_page())
        return
    items = [scheme_data(scheme) for scheme in all_schemes() if wanted is None or scheme.top in wanted]
    for item in items:
        item["options"] = {name: str(option["default"]) for name, option in item["options"].items()}
    for failure in plugin_failures():
        print_message(f"plugin {failure.name} failed: {failure.reason}")
    _print_list("schemes", items, ["name", "top", "order", "self_adjoint", "conserves", *_origins(items)], as_json)


@list_app.command(cls=Command, name="compositions")
def list_compositions(as_json: Json = False) -> None:
    """List the compositions that raise a scheme's order.

    Write scheme+composition, such as hk+suzuki4; the scheme must be self-adjoint.
    """
    from topcli.schemes.compose import COMPOSITIONS

    items = [asdict(found) | {"stages": found.stages} for found in COMPOSITIONS.values()]
    _print_list("compositions", items, ["name", "order", "stages", "title", "citation"], as_json)


@list_app.command(cls=Command, name="scenes")
def list_scenes(top: OnlyTop = None, as_json: Json = False) -> None:
    """List the packaged scenes, names that stand for configs."""
    from topcli.config.load import scenes

    items: list[dict[str, Any]] = [
        {
            "name": name,
            "top": first.top.form,
            "scheme": first.scheme.name,
            "h": first.h,
            "N": first.N,
            "trajectories": count,
            "about": about,
        }
        for name, first, count, about in scenes(top)
    ]
    _print_list("scenes", items, ["name", "top", "scheme", "h", "N", "about"], as_json)


@list_app.command(cls=Command, name="sweeps")
def list_sweeps(as_json: Json = False) -> None:
    """List the packaged sweeps for topcli sweep."""
    from topcli.config.load import first_sentence
    from topcli.config.sweep.document import load_sweep, sweep_files

    items: list[dict[str, Any]] = [
        {"name": name, "varied": list(load_sweep(name).keys), "about": first_sentence(path)}
        for name, path in sweep_files().items()
    ]
    _print_list("sweeps", items, ["name", "varied", "about"], as_json)


@list_app.command(cls=Command, name="cases")
def list_cases(top: OnlyTop = None, as_json: Json = False) -> None:
    """List the hard cases of topcli stress."""
    from topcli.studies.stress import CASES
    from topcli.tops import forms

    wanted = [form.form for form in forms(top)] if top else None
    items: list[dict[str, Any]] = [
        {"name": case.name, "top": case.form, "question": case.question}
        for case in CASES
        if wanted is None or case.form in wanted
    ]
    _print_list("cases", items, ["name", "top", "question"], as_json, f"no hard cases for {top}")


@list_app.command(cls=Command, name="measures")
def list_measures(top: OnlyTop = None, as_json: Json = False, scheme_files: SchemeFiles = None) -> None:
    """List the measures of topcli sweep.

    With --top, families such as drift.NAME are listed measure by measure.
    """
    from topcli.schemes.registry import plugin_failures
    from topcli.sweeps.measures import all_measures, measures_of_form
    from topcli.tops import forms

    load_scheme_files(scheme_files)
    found = all_measures() if top is None else measures_of_form(forms(top)[0].form)
    items: list[dict[str, Any]] = [
        {
            "name": one.name,
            "unit": one.unit,
            "summary": one.summary,
            "of_failed": one.of_failed,
            "reproducible": one.reproducible,
            "origin": one.origin,
        }
        for one in found
    ]
    for failure in plugin_failures():
        print_message(f"plugin {failure.name} failed: {failure.reason}")
    _print_list("measures", items, ["name", "unit", "summary", *_origins(items)], as_json)


@list_app.command(cls=Command, name="figures")
def list_figures(as_json: Json = False) -> None:
    """List the figures that topcli plot draws."""
    from topcli.figures.catalogue import FIGURES

    items = [{"name": figure.name, "title": figure.title, "scene": figure.scene} for figure in FIGURES.values()]
    _print_list("figures", items, ["name", "scene", "title"], as_json)


def _short(item: dict[str, Any]) -> dict[str, Any]:
    """A run with short cells for the table; the manifest may come from elsewhere and hold anything."""
    cells = {
        key: value if value is None or isinstance(value, int | float) else shortened(str(value))
        for key, value in item.items()
        if key != "name"
    }
    return item | cells | {"ended": item["ended"] and _local_time(item["ended"])}


def _local_time(stamp: object) -> str:
    """Timestamp of a manifest to the minute, in local time; anything else is returned shortened."""
    from datetime import datetime

    try:
        return datetime.fromisoformat(str(stamp)).astimezone().strftime("%Y-%m-%d %H:%M")
    except (ValueError, OverflowError, OSError):
        return shortened(str(stamp))


@list_app.command(cls=Command, name="runs")
def list_runs(
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="List the run folders in this folder.", show_default="results"),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the runs in a folder, also unfinished or damaged ones.

    A run that another process is computing is running; one whose process ended before it is killed. A resumable run
    continues with topcli run NAME --resume.
    """
    from topcli.errors import UsageError
    from topcli.runs.run_list import listed_runs

    folder = Path("results") if out is None else out
    if out is not None and not os.path.isdir(out):
        raise UsageError(f"--out {out}: no such folder")
    items = listed_runs(folder)
    shown = items if as_json else [_short(item) for item in items]
    progress = ["step", "resumable"] if any(item["resumable"] or not item["ended"] for item in items) else []
    columns = ["name", "outcome", *progress, "scheme", "h", "N", "digest", "ended"]
    _print_list("runs", shown, columns, as_json, f"no runs in {folder}")
