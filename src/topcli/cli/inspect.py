"""``topcli list``, ``show``, ``init``, ``schema`` and ``doctor``: look before running."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.options import (
    Json,
    Out,
    SchemeFiles,
    Sets,
    complete_config,
    complete_scheme,
    complete_top,
    load_scheme_files,
)
from topcli.cli.talk import print_json, print_table, say

list_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="List tops, schemes, compositions, figures or runs."
)


def _print_list(kind: str, items: list[dict[str, Any]], columns: list[str], as_json: bool) -> None:
    if as_json:
        print_json(f"list {kind}", {kind: items})
    elif items:
        header = [column.replace("_", "-") for column in columns]
        print_table(header, [[_cell(item[column]) for column in columns] for item in items], numbers=False)
    else:
        say(f"no {kind}")


def _cell(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "–"
    return str(value)


@list_app.command("tops")
def list_tops(as_json: Json = False) -> None:
    """The tops, with their parameters, state and invariants."""
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
    shown = [{**item, "parameters": [f"{k}={v}" for k, v in item["parameters"].items()]} for item in items]
    _print_list("tops", items if as_json else shown, ["form", "title", "parameters", "invariants"], as_json)


@list_app.command("schemes")
def list_schemes(
    top: Annotated[
        str | None, typer.Option("--top", help="Only those for this top.", autocompletion=complete_top)
    ] = None,
    as_json: Json = False,
    as_markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the documentation page of the schemes.")
    ] = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """The registered schemes with their declared traits; plugins that failed are named on stderr."""
    from topcli.schemes.registry import all_schemes, plugin_failures
    from topcli.tops import forms

    load_scheme_files(scheme_files)
    wanted = [form.form for form in forms(top)] if top else None
    if as_markdown:
        from topcli.studies.scheme_page import schemes_page

        print(schemes_page(), end="")
        return
    items = [
        {
            "name": scheme.name,
            "top": scheme.top,
            "title": scheme.title,
            "order": scheme.order,
            "explicit": scheme.explicit,
            "self_adjoint": scheme.self_adjoint,
            "conserves": list(scheme.conserves),
            "options": {name: str(field.default) for name, field in scheme.options.model_fields.items()},
            "equations": scheme.equations,
            "citation": scheme.citation,
            "limits": dict(scheme.limits),
            "origin": scheme.origin,
        }
        for scheme in all_schemes()
        if wanted is None or scheme.top in wanted
    ]
    for failure in plugin_failures():
        say(f"plugin {failure.name} failed: {failure.reason}")
    _print_list("schemes", items, ["name", "top", "order", "self_adjoint", "conserves", "origin"], as_json)


@list_app.command("compositions")
def list_compositions(as_json: Json = False) -> None:
    """The compositions that raise the order of a self-adjoint scheme: write scheme+composition, such as hk+suzuki4."""
    from topcli.schemes.compose import COMPOSITIONS

    items: list[dict[str, Any]] = [
        {
            "name": found.name,
            "title": found.title,
            "order": found.order,
            "stages": found.stages,
            "weights": list(found.weights),
            "citation": found.citation,
        }
        for found in COMPOSITIONS.values()
    ]
    _print_list("compositions", items, ["name", "order", "stages", "title", "citation"], as_json)


@list_app.command("cases")
def list_cases(as_json: Json = False) -> None:
    """The hard cases of ``topcli stress``, each with its question."""
    from topcli.studies.stress import CASES

    items: list[dict[str, Any]] = [{"name": case.name, "top": case.form, "question": case.question} for case in CASES]
    _print_list("cases", items, ["name", "top", "question"], as_json)


@list_app.command("figures")
def list_figures(as_json: Json = False) -> None:
    """The figures that ``topcli plot`` draws."""
    from topcli.figures.catalogue import FIGURES

    items: list[dict[str, Any]] = [
        {"name": spec.name, "title": spec.title, "scene": spec.scene} for spec in FIGURES.values()
    ]
    items.append({"name": "stress", "title": "every scheme in the hard cases of its top", "scene": "topcli stress"})
    _print_list("figures", items, ["name", "scene", "title"], as_json)


@list_app.command("runs")
def list_runs(out: Out = Path("results"), as_json: Json = False) -> None:
    """The runs in a folder of run folders; one with a bad manifest is listed as damaged."""
    from topcli.store.manifest import DamagedRun, all_runs

    items: list[dict[str, Any]] = []
    for run in all_runs(out):
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
    _print_list("runs", items, ["name", "outcome", "scheme", "h", "N", "digest", "ended"], as_json)


def _show_scheme(name: str, as_json: bool) -> bool:
    """Show the scheme called ``name``; whether there is one."""
    from topcli.studies.scheme_page import scheme_data, scheme_forms, scheme_text

    found = scheme_forms(name)
    if as_json and found:
        print_json("show", {"schemes": [scheme_data(scheme) for scheme in found]})
    elif found:
        print("\n\n".join(map(scheme_text, found)))
    return bool(found)


def complete_config_or_scheme(incomplete: str) -> list[str]:
    """Configs, scenes and schemes that begin with ``incomplete``."""
    return [*complete_config(incomplete), *complete_scheme(incomplete)]


def show(
    config: Annotated[
        str,
        typer.Argument(
            metavar="CONFIG|SCHEME",
            help="A config file, a packaged scene, or a scheme.",
            autocompletion=complete_config_or_scheme,
        ),
    ],
    sets: Sets = None,
    as_json: Json = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Show a config as it will run, with every default; or a scheme: what it is, claims, and where it fails."""
    from topcli.config.load import load_any

    load_scheme_files(scheme_files)
    if not sets and not Path(config).suffix and _show_scheme(config, as_json):
        return
    experiment = load_any(config, sets or [])
    if as_json:
        print_json("show", {"config": experiment.resolved(), "digest": experiment.digest})
    else:
        print(experiment.to_yaml(), end="")


def _holds(path: Path, text: str) -> bool:
    """Whether the file at ``path`` holds just ``text``."""
    try:
        return path.read_text(encoding="utf-8") == text
    except (OSError, UnicodeDecodeError):
        return False


def init(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="The config to write.")] = Path("experiment.yaml"),
    top: Annotated[str, typer.Option("--top", help="Which top.", autocompletion=complete_top)] = "kowalevski",
    scheme: Annotated[str, typer.Option("--scheme", help="Which scheme.", autocompletion=complete_scheme)] = "hybrid",
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Write a commented starter config, and its JSON Schema beside it for the editor."""
    import json

    from topcli.config.schema import config_schema
    from topcli.config.starter import starter_config
    from topcli.errors import UsageError
    from topcli.store.run_folder import write_whole

    schema_path = path.with_name("topcli.schema.json")
    if path.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{path}: the starter config is YAML; give a name ending in .yaml")
    text = starter_config(top, scheme, schema_path.name)
    schema_text = json.dumps(config_schema(), indent=1, ensure_ascii=False) + "\n"
    taken = [one for one, ours in ((path, ""), (schema_path, schema_text)) if one.exists() and not _holds(one, ours)]
    if taken and not force:
        raise UsageError(f"{taken[0]}: exists already; choose another name or folder, or --force to overwrite it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(schema_path, lambda temporary: temporary.write_text(schema_text, encoding="utf-8"))
        write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be written ({error.strerror})") from None
    print(path)
    say(f"wrote {path} and {schema_path}; run it with: topcli run {path}")


def schema() -> None:
    """Print the JSON Schema of the config."""
    import json

    from topcli.config.schema import config_schema

    print(json.dumps(config_schema(), indent=1, ensure_ascii=False))


def doctor(as_json: Json = False, scheme_files: SchemeFiles = None) -> None:
    """Report versions, CPU, threads, the cache of compiled code, and plugins with their errors."""
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
    width = max(len(row[0]) for row in rows)
    for key, value in rows:
        print(f"{key.ljust(width)}  {value}")
