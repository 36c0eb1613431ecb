"""``topcli show``, ``init`` and ``schema``."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from topcli.cli.options import (
    Force,
    Json,
    Quiet,
    Results,
    Sets,
    complete_config,
    complete_scheme,
    config_option,
    hint_instead,
    require_new,
    show_hint,
    stored_place,
    top_option,
    write_text,
)
from topcli.cli.output import (
    emit,
    emit_prose,
    emit_text,
    print_cells,
    print_document,
    print_json,
    print_message,
    prose_width,
)
from topcli.errors import UsageError, quoted


def complete_config_or_scheme(incomplete: str) -> list[str]:
    """Configs, scenes and schemes that begin with ``incomplete``."""
    return [*complete_config(incomplete), *complete_scheme(incomplete)]


def show(
    config: Annotated[
        str,
        typer.Argument(
            metavar="CONFIG|SCHEME|TOP|FOLDER",
            help="Config file, packaged scene, scheme, top, or folder of a run or sweep.",
            autocompletion=complete_config_or_scheme,
        ),
    ],
    row: Annotated[
        int | None, typer.Option("--row", metavar="NUMBER", help="Show this row of a stored sweep as a config.")
    ] = None,
    top: Annotated[str | None, top_option("for a scheme, all tops to which it applies")] = None,
    source: Annotated[
        bool, typer.Option("--source", help="Show the code generated for a scheme from the equations of motion.")
    ] = False,
    motion: Annotated[
        bool, typer.Option("--motion", help="Show the class, frequencies and periods of the exact motion.")
    ] = False,
    sets: Sets = None,
    results: Results = Path("results"),
    as_json: Json = False,
) -> None:
    """Show a config, a scheme, a top, or a row of a sweep."""
    from topcli.config.load import load
    from topcli.schemes.own_tops import forms, top_names
    from topcli.studies.describe import generated_source, scheme_data, scheme_forms, schemes_text, top_data, top_text

    if motion:
        return show_motion(config, row, sets or [], as_json)
    folder, stored = Path(config), Path(config) / "config.yaml"
    if row is None and os.path.isdir(folder) and os.path.isfile(stored):  # the folder of a run
        config = str(stored)
    elif row is not None or os.path.isdir(folder):
        from topcli.cli.sweep import show_sweep

        return show_sweep(stored_place(folder, results), row, sets or [], as_json)
    is_name = not sets and not folder.suffix
    schemes = scheme_forms(config, top) if is_name else []
    if (top or source) and not schemes:
        raise UsageError(f"--{'top' if top else 'source'}: needs the name of a scheme, not {quoted(config)}")
    if source:
        emit_text(generated_source(schemes))
        return
    if is_name and config.lower() in top_names():
        shown = [cls.new() for cls in forms(config)]
        if as_json:
            print_json("show", {"tops": [top_data(one) for one in shown]})
        else:
            emit_text("\n\n".join(top_text(one, prose_width()) for one in shown))
        return
    if schemes:
        if as_json:
            print_json("show", {"schemes": [scheme_data(scheme) for scheme in schemes]})
        else:
            emit_text(schemes_text(schemes, prose_width()))
        return
    with hint_instead([config], show_hint):
        experiment = load(config, sets or [], rename=True)
    if as_json:
        print_json("show", {"config": experiment.resolved(), "digest": experiment.digest})
    else:
        emit_text(experiment.to_yaml())


def init(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Path of the config, .yaml or .toml.")] = Path(
        "experiment.yaml"
    ),
    config: Annotated[str, config_option()] = "kowalevski_hk",
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Copy a packaged scene as a config to start from.

    The JSON Schema of configs is written to the same folder, where text editors find it.
    """
    import json

    from topcli.config.files import find_config
    from topcli.config.schema import config_schema

    schema_path, scene = path.with_name("topcli.schema.json"), find_config(config)
    if path.suffix != scene.suffix:
        raise UsageError(f"{path}: {config} is in another format; use a name that ends in {scene.suffix}")
    require_new(path, force, "")
    unnamed = re.sub(r"^name *[:=].*\n", "", scene.read_text(encoding="utf-8"), count=1, flags=re.MULTILINE)
    modeline = "#:schema " if path.suffix == ".toml" else "# yaml-language-server: $schema="
    write_text(f"{modeline}{schema_path.name}\n{unnamed}", path, "")
    write_text(json.dumps(config_schema(), indent=1, ensure_ascii=False) + "\n", schema_path, "")
    if not quiet:
        emit(str(path))
        print_message(f"wrote {path} and {schema_path}")
        print_message(f"next: topcli run {path}")


def schema() -> None:
    """Print the JSON Schema of the config."""
    from topcli.config.schema import config_schema

    print_document(config_schema())


def show_motion(config: str, row: int | None, sets: Sequence[str], as_json: bool) -> None:
    """Print what the closed form says about the motion of a config. Raises UsageError for a sweep or an ensemble."""
    from topcli.analysis.motion import motion_table
    from topcli.analysis.motion.of_top import motion_of
    from topcli.config.load import load_experiment

    if row is not None or Path(config).is_dir():
        raise UsageError(
            "--motion: needs a single experiment, not a sweep; "
            "save a row with `topcli show SWEEP --row NUMBER > FILE.yaml` and name that file"
        )
    experiment = load_experiment(config, sets, any_precision=True)
    motion = motion_of(experiment.top, experiment.y0)
    if as_json:
        print_json("show", {"config": experiment.resolved(), "digest": experiment.digest, "motion": motion.as_dict()})
        return
    print_cells(motion_table(motion).cells(), f"{experiment.name}: {motion.title}")
    for note in motion.notes:
        emit_prose(note)
