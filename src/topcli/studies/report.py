"""The report of a run: as plain data for ``report.json`` and as Markdown for ``report.md``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from topcli.analysis.drift import LOST, ROUND_OFF_ULPS, SIGNIFICANCE, TERMS, InvariantRow
from topcli.contracts import Ending

SCHEMA_VERSION = 1


def number(value: float | None, digits: int = 3) -> str:
    """A number for a table: short, with an exponent where it helps, a dash for None."""
    if value is None:
        return "–"
    if value == 0.0:
        return "0"
    if not math.isfinite(value):
        return str(value)
    return f"{value:.{digits}g}" if 1e-3 <= abs(value) < 1e5 else f"{value:.{max(digits - 2, 1)}e}"


def exact_number(value: float | None) -> str:
    """A number to ten digits: enough to see how an invariant moves; a dash for None."""
    return "–" if value is None else f"{value:.10g}"


INVARIANT_COLUMNS = (
    "invariant",
    "first",
    "min",
    "max",
    "max deviation",
    "relative",
    "rms deviation",
    "relative",
    "drift per unit time",
    "± standard error",
    "over the run",
    "model",
    "scatter",
    "round-off bound",
    "verdict",
)


def invariant_cells(row: dict[str, Any]) -> tuple[str, ...]:
    """One line of the invariant table, for the terminal and for Markdown, from a row of ``report.json``."""
    return (
        row["symbol"],
        exact_number(row["first"]),
        exact_number(row["min"]),
        exact_number(row["max"]),
        number(row["max_deviation"]),
        number(row["max_deviation_relative"]),
        number(row["rms_deviation"]),
        number(row["rms_deviation_relative"]),
        number(row["drift"]),
        number(row["drift_error"], 2),
        number(row["drift_over_run"]),
        row["model"] or "–",
        number(row["scatter"]),
        number(row["round_off_bound"]),
        row["verdict"],
    )


def finite(data: Any) -> Any:
    """The same plain data with null for numbers that JSON does not have (nan, inf)."""
    if isinstance(data, float) and not math.isfinite(data):
        return None
    if isinstance(data, dict):
        return {key: finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [finite(value) for value in data]
    return data


def left_motion(ending: Ending) -> dict[str, Any] | None:
    """First recorded step and time at which a run was far off its energy surface; None for never."""
    return None if ending.left is None else {"step": ending.left, "t": ending.left_t}


def report_data(summary: dict[str, Any], rows: Sequence[InvariantRow]) -> dict[str, Any]:
    """The content of ``report.json``: the run's ``summary`` and a row for each invariant."""
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            **summary,
            "round_off_ulps": ROUND_OFF_ULPS,
            "significance": SIGNIFICANCE,
            "lost": LOST,
            "invariants": [row.as_dict() for row in rows],
        }
    )


ORDINARY = ("iterations", "evaluations", "expansions", "corrections", "chart_switches")
"""Counters of a scheme's normal work; any other counts events that a user should know of."""


def warning_of(report: dict[str, Any]) -> str:
    """What was counted that a user should know of, as a line; empty where there was nothing."""
    counted = {name: count for name, count in report["counters"].items() if count and name not in ORDINARY}
    if not counted:
        return ""
    told = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counted.items())
    return f"{told} in {report['step']} steps; topcli show {report['scheme']} tells of limits"


def invariant_table(report: dict[str, Any]) -> list[list[str]]:
    """The invariant report as lines of cells, a column for each invariant; the first line is the header."""
    cells = [invariant_cells(row) for row in report["invariants"]]
    return [[label, *(cell[i] for cell in cells)] for i, label in enumerate(INVARIANT_COLUMNS)]


def markdown_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Lines of cells as a Markdown table; the first line is the header."""
    ruled = ["| " + " | ".join(line) + " |" for line in lines]
    return [ruled[0], "|" + " --- |" * len(lines[0]), *ruled[1:]]


def report_head(report: dict[str, Any], extent: str = "", listed: Sequence[str] = (), where: str = "") -> list[str]:
    """The lines that a report of one run and one of an ensemble begin with, down to the table of invariants.

    ``extent`` stands before h, ``listed`` below the outcome, ``where`` behind the word counters.
    """
    counters = ", ".join(f"{name.replace('_', ' ')}: {count}" for name, count in report["counters"].items())
    return [
        f"# {report['name']}",
        "",
        f"{report['top_title']}, scheme **{report['scheme']}** ({report['scheme_title']}), "
        f"{extent}h = {report['h']!r}, N = {report['N']}. All quantities are dimensionless.",
        "",
        f"**{report['outcome']}**: {report['message']}.",
        *(["", *listed] if listed else []),
        *(["", f"Counters{where}: {counters}."] if counters else []),
        "",
        "## Conservation laws",
        "",
    ]


def report_markdown(report: dict[str, Any]) -> str:
    """``report.md``: the same content for a reader."""
    lines = [
        *report_head(report),
        *markdown_table(invariant_table(report)),
        "",
        *(f"- {row['symbol']} ({row['name']}) **{row['verdict']}**: {row['reason']}." for row in report["invariants"]),
        "",
        f"Deviations are from the first value. *exact*: no deviation beyond {ROUND_OFF_ULPS:g} ulp × √steps of the "
        f"invariant's terms. *lost*: a deviation of more than {LOST:g} of the first value (or of {TERMS:g} of the "
        f"terms). *drifting*: the fitted slope exceeds {SIGNIFICANCE:g} standard errors and moves the mean "
        "further than twice the scatter about it. *bounded*: neither. *unjudged*: too little to judge by. The standard "
        "error is that of the model: a linear trend with noise that does not grow, or a random walk, which has a slope "
        "in any one run.",
        "",
        f"Compiled or loaded in {report['seconds']['compile']:.3g} s, ran in {report['seconds']['run']:.3g} s.",
        "",
    ]
    return "\n".join(lines)
