"""Table of ``topcli compare`` for an ensemble: quantiles over the trajectories that reached the end."""

from __future__ import annotations

from typing import Any

from topcli.cli.talk import say

LOW, MIDDLE, HIGH = "10 %", "median", "90 %"


def ensemble_title(figures: dict[str, Any]) -> str:
    """End of the table's title: the number of trajectories and what the lines give of them."""
    return (
        f", {figures['trajectories']} trajectories; {MIDDLE}, {LOW} and {HIGH} quantiles of those that reached the end"
    )


def ensemble_lines(figures: dict[str, Any], reversal: str) -> list[list[str]]:
    """Lines of the comparison: a label, then a cell for each entry; ``reversal`` is the label of the defect."""
    from topcli.studies.report import number

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


def say_ensemble_failures(figures: dict[str, Any]) -> int:
    """Report trajectories that failed and measures without a value; the exit code."""
    schemes = figures["schemes"]
    for one in schemes:
        if set(one["outcomes"]) != {"completed"}:
            say(f"error: {one['label']}: {one['message']}")
        for name, fault in one["faults"].items():
            missing = f"no value for {fault['count']} of {figures['trajectories']} trajectories"
            say(f"warning: {one['label']}: {name}: {missing}; trajectory {fault['trajectory']}: {fault['reason']}")
    if all(set(one["outcomes"]) == {"completed"} for one in schemes):
        return 0
    return 3 if any("completed" in one["outcomes"] for one in schemes) else 1
