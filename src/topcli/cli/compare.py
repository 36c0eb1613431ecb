"""``topcli compare``: run one experiment under several schemes, options or steps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from topcli.cli.options import FigureOut, Json, SchemeFiles, Sets, complete_config, complete_scheme, load_scheme_files
from topcli.cli.talk import ProgressDisplay, print_json, print_table, say, say_warnings
from topcli.errors import UsageError, quoted

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment

PAPER_SCENE = "kowalevski_hk"
DEFAULT_REFERENCE = "taylor"


def _modified_lines(schemes: list[dict[str, Any]]) -> list[list[str]]:
    """Lines of the modified integrals; a dash if a scheme has no such integral."""
    from topcli.studies.report import number

    def correction(row: dict[str, Any]) -> str:
        found = row["correction"]
        power = {1: "h", 2: "h²"}.get(found["power"], f"h^{found['power']}")
        return f"{number(found['size'])} = {found['coefficient']:.3g} {power}"

    each = [{row["name"]: row for row in scheme["modified"]} for scheme in schemes]
    lines = []
    for name, known in {name: row for rows in each for name, row in rows.items()}.items():
        found = [rows.get(name) for rows in each]
        cells = [(f"{known['symbol']} max deviation", lambda row: number(row["max_deviation"]))]
        cells.append(("  verdict", lambda row: row["verdict"]))
        if "correction" in known:
            cells.append((f"  less {known['correction']['of']}, at most", correction))
        lines += [[label, *("–" if row is None else cell(row) for row in found)] for label, cell in cells]
    return lines


def _one_step(schemes: list[dict[str, Any]]) -> bool:
    """True if all entries have the same step size."""
    return len({scheme["h"] for scheme in schemes}) == 1


def _step_lines(schemes: list[dict[str, Any]]) -> list[list[str]]:
    """Lines of the step sizes and the numbers of steps if entries differ in them."""
    if _one_step(schemes):
        return []
    return [["h", *(f"{one['h']:g}" for one in schemes)], ["N", *(str(one["N"]) for one in schemes)]]


def _reversal_label(schemes: list[dict[str, Any]]) -> str:
    return "reversal defect" + (f" at h = {abs(schemes[0]['h']):g}" if _one_step(schemes) else "")


def _cost_label(schemes: list[dict[str, Any]]) -> str:
    return "ns per step" + (", of a closed form per state" if any(one["closed_form"] for one in schemes) else "")


def _title(name: str, top: str, schemes: list[dict[str, Any]]) -> str:
    """Title of the table: experiment, top, and the steps, or the time if the steps differ."""
    first = schemes[0]
    steps = (
        f"h = {first['h']:g}, N = {first['N']}" if _one_step(schemes) else f"t from 0 to {first['N'] * first['h']:g}"
    )
    return f"{name}: {top}, {steps}"


def _lines(figures: dict[str, Any]) -> list[list[str]]:
    """Lines of the comparison: a label, then a cell for each scheme."""
    from topcli.studies.report import comparison_lines, number

    schemes = figures["schemes"]
    spacing = figures["reference"]["swing_spacing"]
    swing = f"spacing of {figures['reference']['swing']} minima"
    if spacing is not None:
        swing += f" (reference {spacing:.4f})"

    def line(label: str, cell: Any) -> list[str]:
        return [label, *(cell(scheme) for scheme in schemes)]

    def setup(scheme: dict[str, Any]) -> str:
        seconds = scheme["setup_seconds"]
        return "–" if seconds is None else f"{seconds:.3f}"

    return [
        *_step_lines(schemes),
        line("outcome", lambda s: s["outcome"]),
        line("max error", lambda s: number(s["max_error"])),
        line("error at the end", lambda s: number(s["end_error"])),
        *comparison_lines(schemes),
        *_modified_lines(schemes),
        line(_reversal_label(schemes), lambda s: number(s["reversal"]["defect"])),
        line(
            "  its order in h",
            lambda s: "round-off" if s["reversal"]["order"] is None else f"{s['reversal']['order']:.2f}",
        ),
        line(swing, lambda s: "–" if s["swing_spacing"] is None else f"{s['swing_spacing']:.4f}"),
        line(_cost_label(schemes), lambda s: f"{s['nanoseconds_per_step']:.1f}"),
        line("compile or load, s", lambda s: f"{s['compile_seconds']:.3f}"),
        *([line("set-up, s", setup)] if any(one["setup_seconds"] is not None for one in schemes) else []),
    ]


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


def _header(scheme: dict[str, Any]) -> str:
    """Label of an entry, with the options other than the defaults that it does not name."""
    changed = [f"{key}={value}" for key, value in scheme["changed"].items() if key not in scheme["own"]]
    return scheme["label"] + (f" ({', '.join(changed)})" if changed else "")


def _warn_of_few_rows(figures: dict[str, Any]) -> None:
    if figures["few_rows"]:
        say(
            f"warning: the steps share {figures['rows']} times, at which the errors are compared; "
            "steps whose ratio is simple, such as 2 or 5, share more"
        )


def _compare_one(
    experiment: Experiment,
    entries: list[str],
    options: dict[str, Any],
    reference: str,
    pictures: Path | None,
    as_json: bool,
) -> int:
    """Compare entries on one trajectory, print the result and draw it into ``pictures``; the exit code."""
    from topcli.studies.compare import compare_schemes

    comparison = compare_schemes(experiment, entries, options, reference)
    files: list[str] = []
    if pictures is not None:
        from topcli.figures.comparison import loaded_comparison
        from topcli.figures.make import write_figure

        written = write_figure(f"compare_{experiment.name}", loaded_comparison(comparison), pictures)
        files = [str(path) for path in written]
    compared = comparison.figures["schemes"]
    if as_json:
        print_json("compare", {**comparison.figures, "files": files})
    else:
        title = _title(experiment.name, experiment.top.title, compared)
        title += "" if experiment.exact is None else f", precision {experiment.precision}"
        if reference != DEFAULT_REFERENCE:
            title += f", errors from the {comparison.figures['reference']['method']}"
        print_table(["", *map(_header, compared)], _lines(comparison.figures), title)
        for file in files:
            say(f"wrote {file}")
    _warn_of_few_rows(comparison.figures)
    failed = [scheme for scheme in compared if scheme["outcome"] != "completed"]
    for scheme in failed:
        say(f"error: {scheme['label']}: {scheme['message']}")
    return 1 if failed else 0


def _compare_ensemble(
    experiment: EnsembleExperiment, entries: list[str], options: dict[str, Any], as_json: bool
) -> int:
    """Compare entries on an ensemble and print the result; the exit code."""
    from topcli.cli.compare_ensemble import ensemble_lines, ensemble_title, say_ensemble_failures
    from topcli.studies.compare_ensemble import compare_ensemble

    display = ProgressDisplay(1, as_json)
    display.begin(experiment.name)
    try:
        figures = compare_ensemble(experiment, entries, options, display)
    finally:
        display.close()
    compared = figures["schemes"]
    if as_json:
        print_json("compare", figures)
    else:
        title = _title(experiment.name, experiment.top.title, compared) + ensemble_title(figures)
        lines = ensemble_lines(figures, _reversal_label(compared))
        print_table(["", *map(_header, compared)], [*_step_lines(compared), *lines], title)
    _warn_of_few_rows(figures)
    return say_ensemble_failures(figures)


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


def compare(
    entries: Entries,
    config: Config = PAPER_SCENE,
    sets: Sets = None,
    reference: Reference = DEFAULT_REFERENCE,
    as_json: Json = False,
    plot: Plot = False,
    out: FigureOut = Path("results/figures"),
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

    load_scheme_files(scheme_files)
    options, others = _scheme_options(sets or [])
    experiment = load_any(config, others)
    say_warnings(experiment)
    if not isinstance(experiment, Experiment):
        if plot:
            raise UsageError(f"--plot draws one trajectory, and {experiment.name} is an ensemble of {experiment.count}")
        if reference != DEFAULT_REFERENCE:
            raise UsageError(
                f"--reference {quoted(reference)}: chooses the reference of one trajectory, and {experiment.name} is "
                f"an ensemble of {experiment.count}"
            )
        code = _compare_ensemble(experiment, entries, options, as_json)
    else:
        if plot:
            require_writable(out)
        code = _compare_one(experiment, entries, options, reference, out if plot else None, as_json)
    if code:
        raise typer.Exit(code)
