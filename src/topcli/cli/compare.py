"""``topcli compare``: run one experiment under several schemes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from topcli.cli.options import FigureOut, Json, SchemeFiles, Sets, complete_config, complete_scheme, load_scheme_files
from topcli.cli.talk import print_json, print_table, say, say_warnings

PAPER_SCENE = "kowalevski_hk"


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

    h = schemes[0]["reversal"]["h"]
    return [
        line("outcome", lambda s: s["outcome"]),
        line("max error", lambda s: number(s["max_error"])),
        line("error at the end", lambda s: number(s["end_error"])),
        *comparison_lines(schemes),
        *_modified_lines(schemes),
        line(f"reversal defect at h = {h:g}", lambda s: number(s["reversal"]["defect"])),
        line(
            "  its order in h",
            lambda s: "round-off" if s["reversal"]["order"] is None else f"{s['reversal']['order']:.2f}",
        ),
        line(swing, lambda s: "–" if s["swing_spacing"] is None else f"{s['swing_spacing']:.4f}"),
        line("ns per step", lambda s: f"{s['nanoseconds_per_step']:.1f}"),
        line("compile or load, s", lambda s: f"{s['compile_seconds']:.3f}"),
    ]


def _scheme_options(sets: list[str]) -> tuple[dict[str, Any], list[str]]:
    """Options of ``--set scheme.KEY=VALUE`` for all schemes that have them, and the other overrides."""
    from topcli.config.overrides import override_label, parse_override
    from topcli.errors import UsageError

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
    """Name of a scheme, with its options other than the defaults."""
    changed = [f"{key}={value}" for key, value in scheme["changed"].items()]
    return scheme["scheme"] + (f" ({', '.join(changed)})" if changed else "")


Schemes = Annotated[
    list[str], typer.Argument(metavar="SCHEME", help="Names of schemes.", autocompletion=complete_scheme)
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
Plot = Annotated[bool, typer.Option("--plot", help="Draw errors and swings over time.")]


def compare(
    schemes: Schemes,
    config: Config = PAPER_SCENE,
    sets: Sets = None,
    as_json: Json = False,
    plot: Plot = False,
    out: FigureOut = Path("results/figures"),
    scheme_files: SchemeFiles = None,
) -> None:
    """Compare schemes: errors, drifts, reversal, swings, speed."""
    from topcli.config.load import load_experiment
    from topcli.store.run_folder import require_writable
    from topcli.studies.compare import compare_schemes

    load_scheme_files(scheme_files)
    options, others = _scheme_options(sets or [])
    experiment = load_experiment(config, others, any_precision=True)
    say_warnings(experiment)
    if plot:
        require_writable(out)
    comparison = compare_schemes(experiment, schemes, options)
    files: list[str] = []
    if plot:
        from topcli.figures.comparison import loaded_comparison
        from topcli.figures.make import write_figure

        written = write_figure(f"compare_{experiment.name}", loaded_comparison(comparison), out)
        files = [str(path) for path in written]
    if as_json:
        print_json("compare", {**comparison.figures, "files": files})
    else:
        title = f"{experiment.name}: {experiment.top.title}, h = {experiment.h:g}, N = {experiment.N}"
        title += "" if experiment.exact is None else f", precision {experiment.precision}"
        header = ["", *map(_header, comparison.figures["schemes"])]
        print_table(header, _lines(comparison.figures), title)
        for file in files:
            say(f"wrote {file}")
    failed = [scheme for scheme in comparison.figures["schemes"] if scheme["outcome"] != "completed"]
    for scheme in failed:
        say(f"error: {scheme['scheme']}: {scheme['message']}")
    if failed:
        raise typer.Exit(1)
