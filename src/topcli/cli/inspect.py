"""``topcli list``, ``show``, ``init``, ``schema`` and ``doctor``."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.command import Command
from topcli.cli.options import (
    Json,
    SchemeFiles,
    Sets,
    complete_config,
    complete_scheme,
    load_scheme_files,
    top_option,
)
from topcli.cli.talk import emit, emit_text, print_document, print_json, print_table, prose_width, say
from topcli.errors import shortened

list_app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    help="List tops, schemes, measures, scenes, cases, figures, runs.",
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
        say(nothing or f"no {kind}")


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
    """List the tops with their parameters and invariants."""
    from topcli.tops import TOPS

    items = [
        {
            "name": top.kind,
            "form": top.form,
            "title": top.title,
            "parameters": {name: field.default for name, field in top.model_fields.items()},
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
    _print_list("tops", items if as_json else shown, ["top", "title", "parameters", "invariants"], as_json)


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
        say(f"plugin {failure.name} failed: {failure.reason}")
    _print_list("schemes", items, ["name", "top", "order", "self_adjoint", "conserves", "origin"], as_json)


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
    from topcli.studies.measures import all_measures, measures_of_form
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
        say(f"plugin {failure.name} failed: {failure.reason}")
    _print_list("measures", items, ["name", "unit", "summary", "origin"], as_json)


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
    """List the runs in a folder, damaged ones included."""
    from topcli.errors import UsageError
    from topcli.store.manifest import DamagedRun, all_runs

    folder = Path("results") if out is None else out
    if out is not None and not os.path.isdir(out):
        raise UsageError(f"--out {out}: no such folder")
    items: list[dict[str, Any]] = []
    for run in all_runs(folder):
        if isinstance(run, DamagedRun):
            unknown = dict.fromkeys(("scheme", "h", "N", "digest", "ended"))
            items.append({"name": run.folder.name, "outcome": "damaged", **unknown, "reason": run.reason})
            continue
        config = run.manifest["config"]
        items.append(
            {
                "name": run.folder.name,
                "outcome": run.manifest["outcome"],
                "scheme": config["scheme"]["name"],
                "h": config["h"],
                "N": config["N"],
                "digest": run.manifest["digest"][:8],
                "ended": run.manifest["ended"],
            }
        )
    shown = items if as_json else [_short(item) for item in items]
    columns = ["name", "outcome", "scheme", "h", "N", "digest", "ended"]
    _print_list("runs", shown, columns, as_json, f"no finished runs in {folder}")


def _show_scheme(name: str, as_json: bool) -> bool:
    """Print the scheme called ``name`` and return True, or False if there is none."""
    from topcli.studies.scheme_page import scheme_data, scheme_forms, scheme_text

    found = scheme_forms(name)
    if as_json and found:
        print_json("show", {"schemes": [scheme_data(scheme) for scheme in found]})
    elif found:
        emit_text("\n\n".join(scheme_text(scheme, prose_width()) for scheme in found))
    return bool(found)


def complete_config_or_scheme(incomplete: str) -> list[str]:
    """Configs, scenes and schemes that begin with ``incomplete``."""
    return [*complete_config(incomplete), *complete_scheme(incomplete)]


def show(
    config: Annotated[
        str,
        typer.Argument(
            metavar="CONFIG|SCHEME|SWEEP",
            help="A config file, a packaged scene, a scheme, or the folder of a sweep.",
            autocompletion=complete_config_or_scheme,
        ),
    ],
    row: Annotated[
        int | None, typer.Option("--row", metavar="NUMBER", help="Show this row of a sweep as a config.")
    ] = None,
    motion: Annotated[
        bool, typer.Option("--motion", help="Show the class, frequencies and periods of the exact motion.")
    ] = False,
    sets: Sets = None,
    as_json: Json = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Show a config with defaults, a scheme, or a row of a sweep."""
    from topcli.config.load import load_named

    load_scheme_files(scheme_files)
    if motion:
        from topcli.cli.motion import show_motion

        return show_motion(config, row, sets or [], as_json)
    if row is not None or os.path.isdir(config):
        from topcli.cli.sweep import show_sweep

        show_sweep(Path(config), row, sets or [], as_json)
        return
    if not sets and not Path(config).suffix and _show_scheme(config, as_json):
        return
    experiment = load_named(config, sets or [])
    if as_json:
        print_json("show", {"config": experiment.resolved(), "digest": experiment.digest})
    else:
        emit_text(experiment.to_yaml())


def _holds(path: Path, text: str) -> bool:
    """True if the content of the file at ``path`` is ``text``."""
    try:
        return path.read_text(encoding="utf-8") == text
    except (OSError, UnicodeDecodeError):
        return False


def init(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Path of the config, .yaml or .toml.")] = Path(
        "experiment.yaml"
    ),
    top: Annotated[str, top_option("Choose the top.")] = "kowalevski",
    scheme: Annotated[
        str | None,
        typer.Option(
            "--scheme",
            metavar="SCHEME",
            help="Choose the scheme; by default hybrid, hk or the first that fits.",
            autocompletion=complete_scheme,
        ),
    ] = None,
    scheme_files: SchemeFiles = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Write a commented starter config and its JSON Schema.

    The schema is written beside the config, so that editors find it.
    """
    import json

    from topcli.config.load import SUFFIXES
    from topcli.config.schema import config_schema
    from topcli.config.starter import starter_config
    from topcli.errors import UsageError
    from topcli.store.run_folder import write_whole

    load_scheme_files(scheme_files)
    schema_path = path.with_name("topcli.schema.json")
    if path.suffix not in SUFFIXES:
        raise UsageError(f"{path}: unknown type of config; use a name ending in .yaml or .toml")
    text = starter_config(top, scheme, schema_path.name, toml=path.suffix == ".toml")
    schema_text = json.dumps(config_schema(), indent=1, ensure_ascii=False) + "\n"
    taken = [
        one for one, ours in ((path, ""), (schema_path, schema_text)) if os.path.exists(one) and not _holds(one, ours)
    ]
    if taken and not force:
        raise UsageError(f"{taken[0]}: exists already; choose another path, or use --force to overwrite it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(schema_path, lambda temporary: temporary.write_text(schema_text, encoding="utf-8"))
        write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror})") from None
    emit(str(path))
    say(f"wrote {path} and {schema_path}; run it with: topcli run {path}")


def schema() -> None:
    """Print the JSON Schema of the config."""
    from topcli.config.schema import config_schema

    print_document(config_schema())


def doctor(as_json: Json = False, scheme_files: SchemeFiles = None) -> None:
    """Report versions, CPU, compilation cache and plugins."""
    from topcli.errors import UsageError
    from topcli.studies.doctor import diagnosis

    broken = []
    for path in scheme_files or ():
        try:
            load_scheme_files([path])
        except UsageError as error:
            broken.append(str(error))
    found = diagnosis()
    found["problems"] += broken
    if as_json:
        print_json("doctor", found)
        return
    rows = [[key, str(value)] for key, value in found["environment"].items()]
    rows += [[f"cache {key}", str(value)] for key, value in found["cache"].items()]
    rows += [["CPU threads", str(found["threads"])]]
    rows += [[f"plugin {plugin['name']}", plugin["state"]] for plugin in found["plugins"]] or [["plugins", "none"]]
    rows += [["problems", "; ".join(found["problems"]) or "none"]]
    print_table([], rows, numbers=False)
