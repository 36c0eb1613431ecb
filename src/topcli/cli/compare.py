"""``topcli compare``: run one experiment under several schemes, options or steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.files import Overwrite, require_new
from topcli.cli.hints import compare_hint, hint_instead
from topcli.cli.options import FigureOut, Json, SchemeFiles, Sets, complete_config, complete_scheme, load_scheme_files
from topcli.cli.output import ProgressDisplay, emit_prose, print_json, print_message, print_table, print_warnings
from topcli.errors import UsageError

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment

PAPER_SCENE = "kowalevski_hk"
DEFAULT_REFERENCE = "taylor"


def _scheme_options(sets: list[str]) -> tuple[dict[str, Any], list[str]]:
    """Options of ``--set scheme.KEY=VALUE`` for all schemes that have them, and the other overrides."""
    from topcli.config.overrides import override_label, parse_override

    options, others = {}, []
    for text in sets:
        path, value = parse_override(text)
        if path == ("scheme",):
            raise UsageError(f"{override_label(text)}: name the schemes as arguments of the command line")
        if path[0] == "scheme" and len(path) == 2 and path[1] != "name":
            options[path[1]] = value
        else:
            others.append(text)
    return options, others


def _show(figures: dict[str, Any], files: list[str], as_json: bool) -> None:
    """Print a comparison and the ``files`` written, with a warning if it has few rows."""
    from topcli.studies.compare_table import comparison_table, reference_note

    if as_json:
        print_json("compare", {**figures, "files": files})
    else:
        title, header, lines = comparison_table(figures)
        print_table(header, lines, title)
        if note := reference_note(figures):
            emit_prose(note)
        for file in files:
            print_message(f"wrote {file}")
    if figures["few_rows"]:
        print_message(
            f"warning: the steps share {figures['rows']} times, at which the errors are compared; "
            "steps whose ratio is simple, such as 2 or 5, share more"
        )


@dataclass(frozen=True)
class _Outputs:
    """Targets of the results of a comparison: a folder of ``pictures``, a JSON file, stdout as JSON."""

    pictures: Path | None
    saved: Path | None
    as_json: bool


def _compare_one(
    experiment: Experiment, entries: list[str], options: dict[str, Any], outputs: _Outputs, reference: str
) -> int:
    """Compare entries on one trajectory, print, draw and store the result; the exit code."""
    from topcli.studies.compare import compare_schemes, comparison_document, write_comparison

    comparison = compare_schemes(experiment, entries, options, reference)
    files: list[str] = []
    if outputs.pictures is not None:
        from topcli.figures.comparison import loaded_comparison
        from topcli.figures.make import write_figure

        written = write_figure(f"compare_{experiment.name}", loaded_comparison(comparison), outputs.pictures)
        files = [str(path) for path in written]
    if outputs.saved is not None:
        files.append(str(write_comparison(outputs.saved, comparison_document(comparison))))
    compared = comparison.figures["schemes"]
    _show(comparison.figures, files, outputs.as_json)
    failed = [scheme for scheme in compared if scheme["outcome"] != "completed"]
    for scheme in failed:
        print_message(f"error: {scheme['label']}: {scheme['message']}")
    return _say_code_failures(comparison.figures) or (1 if failed else 0)


def _compare_ensemble(
    experiment: EnsembleExperiment, entries: list[str], options: dict[str, Any], outputs: _Outputs, reference: str
) -> int:
    """Compare entries on an ensemble, print and store the result; the exit code."""
    from topcli.cli.compare_ensemble import say_ensemble_failures
    from topcli.studies.compare import write_comparison
    from topcli.studies.compare_ensemble import compare_ensemble

    display = ProgressDisplay(1, outputs.as_json)
    display.begin(experiment.name)
    try:
        figures = compare_ensemble(experiment, entries, options, display, reference)
    finally:
        display.close()
    files = [] if outputs.saved is None else [str(write_comparison(outputs.saved, figures))]
    _show(figures, files, outputs.as_json)
    code = say_ensemble_failures(figures)
    return _say_code_failures(figures) or code


def _say_code_failures(figures: Mapping[str, Any]) -> int:
    """Report entries whose code fails; the exit code if there are any, beside others that were compared, else 0."""
    for one in figures["failed"]:
        print_message(f"error: {one['label']}: {one['reason']}")
    return 3 if figures["failed"] else 0


Entries = Annotated[
    list[str],
    typer.Argument(
        metavar="SCHEME[:KEY=VALUE,...]",
        help="Name schemes, each with its own h and options.",
        autocompletion=complete_scheme,
    ),
]
Config = Annotated[
    str,
    typer.Option(
        "--config",
        metavar="CONFIG",
        help="Read the experiment from a config or scene.",
        autocompletion=complete_config,
    ),
]
Reference = Annotated[
    str,
    typer.Option("--reference", metavar="KIND", help="Take errors from taylor (series) or exact (closed form)."),
]
Plot = Annotated[bool, typer.Option("--plot", help="Draw errors and swings over time.")]
Save = Annotated[
    Path | None,
    typer.Option("--save", metavar="FILE", help="Store the comparison as JSON for topcli report."),
]


def compare(
    entries: Entries,
    config: Config = PAPER_SCENE,
    sets: Sets = None,
    reference: Reference = DEFAULT_REFERENCE,
    as_json: Json = False,
    plot: Plot = False,
    out: FigureOut = Path("results/figures"),
    save: Save = None,
    force: Overwrite = False,
    scheme_files: SchemeFiles = None,
) -> None:
    """Compare schemes: errors, drifts, reversal, swings, speed.

    An entry is a scheme with its own options and step: topcli compare hk hk:h=0.01 hybrid:branch=sign. Entries with
    different steps cover the same time and are compared at the times that all of them reach. Of an ensemble, median
    and quantiles over the trajectories are given.
    """
    from topcli.config.load import load_any
    from topcli.config.models import Experiment
    from topcli.store.run_folder import require_writable

    if save is not None:
        if save.suffix != ".json":
            raise UsageError(f"--save {save}: unknown type of file; use a name ending in .json")
        require_new(save, force, "--save")
    load_scheme_files(scheme_files)
    options, others = _scheme_options(sets or [])
    experiment = load_any(config, others)
    print_warnings(experiment)
    if not isinstance(experiment, Experiment):
        if plot:
            raise UsageError(f"--plot draws one trajectory, and {experiment.name} is an ensemble of {experiment.count}")
        with hint_instead(entries, compare_hint):
            code = _compare_ensemble(experiment, entries, options, _Outputs(None, save, as_json), reference)
    else:
        if plot:
            require_writable(out)
        outputs = _Outputs(out if plot else None, save, as_json)
        with hint_instead(entries, compare_hint):
            code = _compare_one(experiment, entries, options, outputs, reference)
    if code:
        raise typer.Exit(code)
