"""Report of a run: plain data for ``report.json``, Markdown for ``report.md``, cells for tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from topcli.analysis.tally import LOST, ROUND_OFF_ULPS, SIGNIFICANCE, TERMS, InvariantRow
from topcli.contracts import Ending
from topcli.runs.accuracy import accuracy_note, seconds_note
from topcli.table import Column, Table, exact_number, number, two_digits

if TYPE_CHECKING:
    from topcli.analysis.digit_growth import DigitGrowth
    from topcli.config.models import Experiment

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class ReportColumn(Column):
    """Figure of the report on one invariant; the path is its key in ``report.json``.

    ``compared`` is the heading in comparisons of schemes, where {} is the invariant's symbol; empty if not shown there.
    """

    show: Callable[[Any], str] = number
    compared: str = ""


REPORT_COLUMNS = (
    ReportColumn("invariant", "symbol", str),
    ReportColumn("first", "first", exact_number),
    ReportColumn("min", "min", exact_number),
    ReportColumn("max", "max", exact_number),
    ReportColumn("max deviation", "max_deviation", compared="{} max deviation"),
    ReportColumn("relative", "max_deviation_relative"),
    ReportColumn("rms deviation", "rms_deviation"),
    ReportColumn("relative", "rms_deviation_relative"),
    ReportColumn("drift per unit time", "drift", compared="{} drift per unit time"),
    ReportColumn("± standard error", "drift_error", two_digits, compared="  its standard error"),
    ReportColumn("over the run", "drift_over_run"),
    ReportColumn("model", "model", str, compared="  model"),
    ReportColumn("scatter", "scatter"),
    ReportColumn("round-off bound", "round_off_bound"),
    ReportColumn("verdict", "verdict", str, compared="  verdict"),
)
"""Figures of the invariant report in the order of all its tables; the paths are fields of ``InvariantRow``."""
INVARIANTS = Table(
    "invariants", REPORT_COLUMNS[1:], heading="Conservation laws", index="symbol", across=REPORT_COLUMNS[0]
)
"""The invariant report, a column for each invariant."""


def finite(data: Any) -> Any:
    """Plain data with None for numbers that JSON does not have (nan, inf)."""
    if isinstance(data, float) and not math.isfinite(data):
        return None
    if isinstance(data, dict):
        return {key: finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [finite(value) for value in data]
    return data


def left_motion(ending: Ending) -> dict[str, Any] | None:
    """First recorded step and time at which a run was far off its energy surface; None if it never was."""
    return None if ending.left is None else {"step": ending.left, "t": ending.left_t}


def heading(experiment: Experiment, name: str, digest: str) -> dict[str, Any]:
    """First entries of ``report.json``, of a run or an ensemble."""
    return {
        "name": name,
        "digest": digest,
        "top": experiment.top.kind,
        "top_title": experiment.top.title,
        "scheme": experiment.scheme.name,
        "scheme_title": experiment.scheme.title,
        "h": experiment.h,
        "N": experiment.N,
    }


def precision_data(precision: int | str, library: str, growth: DigitGrowth | None) -> dict[str, Any]:
    """Entries of ``report.json`` of a run in another precision than double, with the growth of rational numbers."""
    return {
        "precision": precision,
        "library": library,
        **({} if growth is None else {"digit_growth": growth.as_dict()}),
    }


POWERS = {1: "linearly", 2: "quadratically", 3: "cubically"}


def precision_note(report: Mapping[str, Any]) -> str:
    """Precision of a run and the growth of its numbers, in one line; empty for doubles."""
    precision, growth = report.get("precision"), report.get("digit_growth")
    if precision is None:
        return ""
    if growth is None:
        return f"computed with {precision} digits"
    length = f"computed in rational numbers of {growth['bits']} bits at step {growth['step']}"
    if growth["law"] == "polynomial":
        word = POWERS.get(round(growth["power"]), "as a power")
        return f"{length}; they grow {word} (as n^{growth['power']:.2f}), as on orbits of integrable maps"
    if growth["law"] == "exponential":
        factor = growth["factor"]
        return f"{length}; they grow exponentially ({factor:.2f} times a step), which no integrable map does"
    return f"{length}; too few rows for the law of their growth"


def report_data(summary: dict[str, Any], rows: Sequence[InvariantRow]) -> dict[str, Any]:
    """Content of ``report.json``: the ``summary`` of the run and a row for each invariant."""
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
"""Counters of a scheme's normal work; all others count events that are reported as warnings."""


def warning_of(report: dict[str, Any]) -> str:
    """Events counted by the scheme that a user should know about, in one line; empty if there were none."""
    counted = {name: count for name, count in report["counters"].items() if count and name not in ORDINARY}
    if not counted:
        return ""
    events = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counted.items())
    return f"{events} in {report['step']} steps; topcli show {report['scheme']} lists its limits"


def comparison_lines(schemes: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Compared figures of each invariant as lines: a label, then a cell for each of the ``schemes``."""
    return [
        [column.compared.format(rows[0]["symbol"]), *map(column.text, rows)]
        for rows in zip(*(scheme["invariants"] for scheme in schemes), strict=True)
        for column in REPORT_COLUMNS
        if column.compared
    ]


def report_head(report: dict[str, Any], extent: str = "", listed: Sequence[str] = (), where: str = "") -> list[str]:
    """First lines of ``report.md``, of a run or an ensemble, up to the table of invariants.

    ``extent`` comes before h, ``listed`` after the outcome, ``where`` after the word "Counters".
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
        *(["", f"{note[0].upper()}{note[1:]}."] if (note := precision_note(report)) else []),
        *(["", f"Counters{where}: {counters}."] if counters else []),
        "",
        "## Conservation laws",
        "",
    ]


def report_markdown(report: dict[str, Any]) -> str:
    """Content of ``report.md``."""
    lines = [
        *report_head(report),
        *INVARIANTS.cells(report).markdown(),
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
        seconds_note(report["seconds"]),
        *(["", f"{note[0].upper()}{note[1:]}."] if (note := accuracy_note(report)) else []),
        "",
    ]
    return "\n".join(lines)
