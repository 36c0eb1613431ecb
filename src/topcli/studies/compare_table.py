"""Tables of comparisons: a column for each scheme, of one trajectory or of quantiles over an ensemble."""

from __future__ import annotations

from typing import Any

from topcli.engine.precise.numbers import RATIONAL
from topcli.runs.report import comparison_lines
from topcli.table import number
from topcli.tops import TOPS

LOW, MIDDLE, HIGH = "10 %", "median", "90 %"


def comparison_table(figures: dict[str, Any]) -> tuple[str, list[str], list[list[str]]]:
    """Title, header and lines of a comparison, from its figures as ``--json`` prints them."""
    schemes, config = figures["schemes"], figures["config"]
    title = _title(config["name"], _top_title(config), schemes)
    if figures.get("kind") == "ensemble":
        title += _ensemble_title(figures)
        lines = [*_step_lines(schemes), *_ensemble_lines(figures, _reversal_label(schemes))]
    else:
        title += f", precision {config['precision']}" if "precision" in config else ""
        lines = _lines(figures)
    return title, ["", *map(entry_label, schemes)], lines


def reference_note(figures: dict[str, Any]) -> str:
    """Sentence on the reference of the errors of a comparison; empty if it has no errors."""
    found = figures["reference"]
    return f"Errors are norms of the difference of states from the {found['method']}." if found else ""


def _top_title(config: dict[str, Any]) -> str:
    """Title of the top of a resolved config, or its name if there is no such top."""
    kind = config["top"]["kind"]
    forms = [top for top in TOPS.values() if top.kind == kind]
    fits = [top for top in forms if set(top.vectors) == set(config["initial"])]
    return (fits or forms)[0].title if forms else str(kind)


def entry_label(scheme: dict[str, Any]) -> str:
    """Label of an entry, with the options other than the defaults that it does not name."""
    changed = [f"{key}={value}" for key, value in scheme["changed"].items() if key not in scheme["own"]]
    return scheme["label"] + (f" ({', '.join(changed)})" if changed else "")


def _modified_lines(schemes: list[dict[str, Any]]) -> list[list[str]]:
    """Lines of the modified integrals; a dash if a scheme has no such integral."""

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


def _order_cell(reversal: dict[str, Any], rational: bool) -> str:
    """Order of a reversal defect in h, or in a word why there is none; a dash if the steps failed."""
    if reversal["order"] is not None:
        return f"{reversal['order']:.2f}"
    if reversal["defect"] is None:
        return "–"
    return "exact" if rational and reversal["defect"] == 0.0 else "round-off"


def _lines(figures: dict[str, Any]) -> list[list[str]]:
    """Lines of the comparison: a label, then a cell for each scheme."""
    schemes, rational = figures["schemes"], figures["config"].get("precision") == RATIONAL
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
        line("  its order in h", lambda s: _order_cell(s["reversal"], rational)),
        line(swing, lambda s: "–" if s["swing_spacing"] is None else f"{s['swing_spacing']:.4f}"),
        line(_cost_label(schemes), lambda s: f"{s['nanoseconds_per_step']:.1f}"),
        line("compile or load, s", lambda s: f"{s['compile_seconds']:.3f}"),
        *([line("set-up, s", setup)] if any(one["setup_seconds"] is not None for one in schemes) else []),
    ]


def _ensemble_title(figures: dict[str, Any]) -> str:
    """End of the table's title: the number of trajectories and what the lines give of them."""
    return (
        f", {figures['trajectories']} trajectories; {MIDDLE}, {LOW} and {HIGH} quantiles of those that reached the end"
    )


def _ensemble_lines(figures: dict[str, Any], reversal: str) -> list[list[str]]:
    """Lines of the comparison: a label, then a cell for each entry; ``reversal`` is the label of the defect."""
    schemes = figures["schemes"]
    lines = [["reached the end", *(str(one["reached_end"]) for one in schemes)]]
    known = {name: None for one in schemes for name in one["outcomes"] if name != "completed"}
    for outcome in known:
        label = f"  {outcome.replace('_', ' ')}"
        lines.append([label, *(str(one["outcomes"].get(outcome, 0)) for one in schemes)])
    for name, label in _labels(figures, reversal).items():
        found = [one["measures"].get(name) for one in schemes]
        digits = 6 if name.startswith("swing") else 3
        for quantile, prefix in ((MIDDLE, f"{label}, {MIDDLE}"), (LOW, f"  {LOW}"), (HIGH, f"  {HIGH}")):
            lines.append([prefix, *("–" if one is None else number(one[quantile], digits) for one in found)])
        if any(one and one["count"] < scheme["reached_end"] for one, scheme in zip(found, schemes, strict=True)):
            lines.append(["  trajectories with a value", *("–" if one is None else str(one["count"]) for one in found)])
    lines.append(["ns per step, all threads", *(f"{one['nanoseconds_per_step']:.1f}" for one in schemes)])
    return lines


def _labels(figures: dict[str, Any], reversal: str) -> dict[str, str]:
    """Labels of all measures by name, in the order of the lines."""
    invariants = {row["name"]: row["symbol"] for one in figures["schemes"] for row in one["invariants"]}
    labels = {"error.max": "max error", "error.end": "error at the end"}
    for name, symbol in invariants.items():
        labels[f"deviation.{name}"] = f"{symbol} max deviation"
        labels[f"drift.{name}"] = f"{symbol} drift per unit time"
    labels |= {"reversal": reversal, "swing_spacing.first": f"spacing of {figures['swing']} minima"}
    measured = {name for one in figures["schemes"] for name in one["measures"]}
    return {name: label for name, label in labels.items() if name in measured}
