"""Reports on runs and ensembles: data for ``report.json``, and tables that show them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.tally import DEVIATIONS, FIGURES, QUANTILES
from topcli.analysis.verdict import LOST, ROUND_OFF_ULPS, SIGNIFICANCE, InvariantRow
from topcli.contracts import Array, Ending, Outcome
from topcli.engine.endings import Endings
from topcli.errors import counted
from topcli.table import Column, Table, number, plus_minus, rounded_up, ten_digits, two_digits

if TYPE_CHECKING:
    from topcli.analysis.quantities import Quantity
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class ReportColumn(Column):
    """Column of the report on invariants; the path is its key in ``report.json``.

    ``compared`` is True if comparisons of schemes show the column.
    """

    show: Callable[[Any], str] = number
    compared: bool = False

    def value(self, row: Mapping[str, Any]) -> Any:
        """Figure of a row; None in a report that was stored before the column existed."""
        return row.get(self.name)

    def compared_head(self, symbol: str) -> str:
        """Heading in comparisons, for the invariant of this symbol."""
        head, unit, _ = self.head.partition(" per unit time")
        return f"{head} of {symbol}{unit}"


REPORT_COLUMNS = (
    ReportColumn("invariant", "symbol", str),
    ReportColumn("first value", "first", ten_digits),
    ReportColumn("min", "min", ten_digits),
    ReportColumn("max", "max", ten_digits),
    ReportColumn("max deviation", "max_deviation", compared=True),
    ReportColumn("max deviation, relative", "max_deviation_relative"),
    ReportColumn("rms deviation", "rms_deviation"),
    ReportColumn("rms deviation, relative", "rms_deviation_relative"),
    ReportColumn("drift per unit time", "drift", compared=True),
    ReportColumn("standard error of the drift", "drift_error", two_digits, compared=True),
    ReportColumn("95 % bound of the drift", "drift_bound", two_digits),
    ReportColumn("drift over the run", "drift_over_run"),
    ReportColumn("model", "model", str, compared=True),
    ReportColumn("round-off bound", "round_off_bound"),
    ReportColumn("verdict", "verdict", str, compared=True),
)
"""Figures of the invariant report in the order of all its tables; the paths are fields of ``InvariantRow``."""
VERDICT_MARKS = {"lost": "bad", "drifting": "middling", "exact": "good"}
"""Looks of the verdicts on terminals and pages."""
INVARIANTS = Table(
    "invariants",
    REPORT_COLUMNS[1:],
    heading="Conservation laws",
    index="symbol",
    across=REPORT_COLUMNS[0],
    marks=VERDICT_MARKS,
)
"""The invariant report, a column for each invariant."""


def deviation_text(row: Mapping[str, Any]) -> str | None:
    """Largest deviation of an invariant, relative to its first value; absolute, and marked so, if that is 0."""
    relative, absolute = row["max_deviation_relative"], row["max_deviation"]
    return number(relative) if relative is not None or absolute is None else f"{number(absolute)} abs"


def drift_text(row: Mapping[str, Any], short: bool = False) -> str | None:
    """Drift of an invariant per unit time: with its error if it is significant, and otherwise its bound, both 95 %.

    A ``short`` text leaves out spaces, and an error below 10 % of the drift.
    """
    drift, bound = row["drift"], row["drift_bound"]
    if drift is None or bound is None:
        return None
    if row["verdict"] != "drifting":
        return f"< {two_digits(rounded_up(bound))}" if bound else "0"
    error = bound - abs(drift)
    if not short:
        return plus_minus(drift, error)
    return number(drift) if error < 0.1 * abs(drift) else plus_minus(drift, error).replace(" ", "")


BRIEF = Table(
    "invariants",
    (
        Column("invariant", "symbol"),
        Column("first value", "first", ten_digits),
        Column("max deviation", deviation_text),
        Column("drift per unit time", drift_text),
        Column("verdict", "verdict"),
    ),
    caption="Deviations are relative, drifts have 95 % bounds; -v prints all values.",
    numbers=(1, 2, 3),
    marks=VERDICT_MARKS,
)
"""The invariant report as a terminal shows it without ``--verbose``, a line for each invariant."""


def open_lines(rows: Sequence[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """Sentences on rows without a verdict on the drift, each with the labels of the rows that it is about."""
    labels: dict[str, list[str]] = {}
    for name, row in rows:
        if row.get("verdict") in ("undecided", "unjudged"):
            labels.setdefault(row["statement"], []).append(name)
    return [f"{', '.join(dict.fromkeys(names))}: {statement}" for statement, names in labels.items()]


def modified_line(rows: Sequence[Mapping[str, Any]]) -> str:
    """Verdicts on the integrals of the scheme itself in one line; empty if it has none."""
    words: dict[str, list[str]] = {}
    for row in rows:
        word = f"{_within_round_off(row)} within round-off" if "within_round_off" in row else row["verdict"]
        words.setdefault(word, []).append(row["symbol"])
    groups = "; ".join(f"{word}: {', '.join(symbols)}" for word, symbols in words.items())
    return f"modified integrals: {groups}" if groups else ""


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


POWERS = {1: "linearly", 2: "quadratically", 3: "cubically"}


def precision_note(report: Mapping[str, Any]) -> str:
    """Precision of a run and the growth of its numbers, in one line; empty for doubles."""
    precision, growth = report.get("precision"), report.get("digit_growth")
    if precision is None:
        return ""
    if growth is None:
        return f"computed with {precision} digits"
    length = f"computed in rational numbers, which have {growth['bits']} bits at step {growth['step']}"
    if growth["law"] == "polynomial":
        word = POWERS.get(round(growth["power"]), "as a power")
        return f"{length}; the bits grow {word} (as n^{growth['power']:.2f}), as for an integrable map"
    if growth["law"] == "exponential":
        factor = growth["factor"]
        return f"{length}; the bits grow exponentially ({factor:.2f} times a step), as for no integrable map"
    return f"{length}; the run has too few rows to tell how the bits grow"


QUANTITIES = Table(
    "quantities",
    (
        Column("quantity", "name"),
        *(Column(figure, figure, ten_digits) for figure in FIGURES),
    ),
    heading="Quantities",
    index="name",
)
"""The report on the user's own observables."""


def report_data(
    about: Mapping[str, Any], rows: Sequence[InvariantRow], quantities: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """Content of ``report.json``: what it is ``about``, a row for each invariant, and for each quantity."""
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            **about,
            "round_off_ulps": ROUND_OFF_ULPS,
            "significance": SIGNIFICANCE,
            "lost": LOST,
            "invariants": [row.as_dict() for row in rows],
            **({"quantities": list(quantities)} if quantities else {}),
        }
    )


def run_report(
    experiment: Experiment,
    digest: str,
    ending: Ending,
    rows: Sequence[InvariantRow],
    seconds: Mapping[str, Any],
    quantities: Sequence[dict[str, Any]],
    crossings: NDArray[np.int64] | None,
    further: Mapping[str, Any],
) -> dict[str, Any]:
    """Content of ``report.json`` of a run, with ``further`` entries on its precision."""
    about = {
        **heading(experiment, experiment.name, digest),
        "outcome": ending.outcome.value,
        "message": ending.message + section_note(experiment, crossings),
        **section_data(crossings),
        "step": ending.step,
        "t": ending.t,
        "left_motion": left_motion(ending),
        "counters": dict(ending.counters),
        "seconds": dict(seconds),
        **further,
    }
    return report_data(about, rows, quantities)


def quantity_rows(
    quantities: Sequence[Quantity], figures: Mapping[str, Array], crossings: NDArray[np.int64] | None
) -> list[dict[str, Any]]:
    """Plain data for each quantity: name, formula, and its ``figures`` (B,) over all trajectories together.

    First, last and mean are averages over the trajectories; of a section, over those with ``crossings`` (B,).
    """
    join, rows = {"min": np.min, "max": np.max}, []
    for quantity in quantities:
        row: dict[str, Any] = {"name": quantity.name, "formula": quantity.formula}
        for figure in FIGURES:
            values = figures[f"{figure}.{quantity.name}"]
            values = values if crossings is None else values[crossings > 0]
            row[figure] = float(join.get(figure, np.mean)(values)) if len(values) else math.nan
        rows.append(row)
    return rows


def section_data(crossings: NDArray[np.int64] | None) -> dict[str, Any]:
    """Entry of ``report.json`` on the crossings of a section by each trajectory (m,); none without a section."""
    if crossings is None:
        return {}
    return {"section": {"crossings": int(crossings.sum()), "never_crossed": int((crossings == 0).sum())}}


def section_note(experiment: Experiment, crossings: NDArray[np.int64] | None) -> str:
    """End of a message on the crossings of a section by each trajectory (m,); empty without a section."""
    section = experiment.section
    if section is None or crossings is None:
        return ""
    where = f"{section.formula} = {section.value:g}" + (
        "" if section.direction == "both" else f" ({section.direction})"
    )
    total, never = int(crossings.sum()), int((crossings == 0).sum())
    if not total:
        return f"; never crossed the section {where}"
    note = f"; {counted(total, 'crossing')} of the section {where}"
    return note + (f"; {never} of {len(crossings)} trajectories never crossed it" if never else "")


ORDINARY = ("iterations", "evaluations", "expansions")
"""Counters of a scheme's normal work; all others count events that are reported as warnings."""


def warning_of(report: dict[str, Any]) -> str:
    """Events counted by the scheme that a user should know about, in one line; empty if there were none."""
    notable = {name: count for name, count in report["counters"].items() if count and name not in ORDINARY}
    if not notable:
        return ""
    events = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in notable.items())
    return (
        f"{events} in {counted(report['step'], 'step')}; topcli show {report['scheme']} lists the limits of this scheme"
    )


def comparison_lines(schemes: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Compared figures of each invariant as lines: a label, then a cell for each of the ``schemes``."""
    return [
        [column.compared_head(rows[0]["symbol"]), *map(column.text, rows)]
        for rows in zip(*(scheme["invariants"] for scheme in schemes), strict=True)
        for column in REPORT_COLUMNS
        if column.compared
    ]


def seconds_note(seconds: Mapping[str, Any]) -> str:
    """Times of a run in a sentence."""
    return f"Compiling or loading the code took {seconds['compile']:.3g} s, and the run {seconds['run']:.3g} s."


SHOWN_TRAJECTORIES = 20
"""Failures listed in the report; the table of trajectories contains all of them."""


WORDS = {
    Outcome.COMPLETED: "completed",
    Outcome.LEFT_MOTION: "left their energy surface",
    Outcome.BLEW_UP: "blew up",
    Outcome.NO_CONVERGENCE: "did not converge",
    Outcome.INTERRUPTED: "interrupted",
    Outcome.DIGIT_LIMIT: "reached the limit of digits",
}
"""Outcomes as words of a sentence."""


def _failure(ending: Ending) -> dict[str, Any]:
    """Outcome of a failed trajectory, with the step and time at which it ended or first left its energy surface."""
    at = (ending.left, ending.left_t) if ending.outcome is Outcome.LEFT_MOTION else (ending.step, ending.t)
    return {"outcome": ending.outcome.value, "step": at[0], "t": at[1]}


class EndingTally:
    """Counts of outcomes over the trajectories of an ensemble of N steps, added up block by block."""

    def __init__(self, N: int) -> None:
        self.N, self.total = N, 0
        self.counters: Counter[str] = Counter()
        self.failures: list[tuple[int, Ending]] = []
        """The first ``SHOWN_TRAJECTORIES`` that failed, by number."""
        self._counts: Counter[Outcome] = Counter()

    def add(self, endings: Endings) -> None:
        """Add the endings of the next trajectories."""
        self._counts.update(endings.outcomes)
        self.counters.update(endings.totals)
        for i in endings.failed[: SHOWN_TRAJECTORIES - len(self.failures)].tolist():
            self.failures.append((self.total + i, endings[i]))
        self.total += len(endings)

    @property
    def outcomes(self) -> dict[str, int]:
        """Number of trajectories for each outcome that occurs."""
        return {outcome.value: self._counts[outcome] for outcome in Outcome if self._counts[outcome]}

    @property
    def outcome(self) -> Outcome:
        """Outcome of the ensemble: interrupted if any trajectory is; else that of the first failure; else completed."""
        if self._counts[Outcome.INTERRUPTED]:
            return Outcome.INTERRUPTED
        return self.failures[0][1].outcome if self.failures else Outcome.COMPLETED

    @property
    def message(self) -> str:
        """Outcomes of the trajectories, and the first failure, in one line."""
        if self._counts[Outcome.COMPLETED] == self.total:
            return f"all {self.total} trajectories completed {counted(self.N, 'step')}"
        outcomes = ", ".join(f"{count} {WORDS[Outcome(name)]}" for name, count in self.outcomes.items())
        message = f"of {self.total} trajectories {outcomes}"
        if self.failures:
            number, ending = self.failures[0]
            message += f"; the first of them, trajectory {number}, {ending.message}"
        return message


def ensemble_report(
    experiment: EnsembleExperiment,
    digest: str,
    endings: EndingTally,
    invariants: Sequence[dict[str, Any]],
    seconds: dict[str, Any],
    quantities: Sequence[dict[str, Any]] = (),
    crossings: NDArray[np.int64] | None = None,
) -> dict[str, Any]:
    """Content of ``report.json``; ``invariants`` and ``quantities`` are the rows of the ensemble's summaries."""
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            "kind": "ensemble",
            **heading(experiment.first, experiment.name, digest),
            "trajectories": endings.total,
            "store": experiment.store,
            "outcome": endings.outcome.value,
            "message": endings.message + section_note(experiment.first, crossings),
            **section_data(crossings),
            "outcomes": endings.outcomes,
            "failures": [{"trajectory": i, **_failure(ending)} for i, ending in endings.failures],
            "counters": dict(endings.counters),
            "seconds": seconds,
            "round_off_ulps": ROUND_OFF_ULPS,
            "invariants": list(invariants),
            **({"quantities": list(quantities)} if quantities else {}),
        }
    )


def _within_round_off(row: Mapping[str, Any]) -> str:
    """Number of trajectories whose invariant stays within round-off, of those judged."""
    return f"{row['within_round_off']} of {row['judged']}"


ENSEMBLE = Table(
    "invariants",
    (
        Column("within round-off", _within_round_off),
        *(Column("", key) for key in ("within_round_off", "judged")),
        *(
            Column(f"{measure.replace('_', ' ')}, {name}", f"{measure}.{name}", number)
            for measure in DEVIATIONS
            for name in (QUANTILES if measure == "max_deviation" else ("median", "max"))
        ),
    ),
    heading="Conservation laws",
    index="symbol",
    across=Column("invariant", "symbol"),
)
"""The ensemble report, a column for each invariant."""


def ensemble_statements(report: Mapping[str, Any]) -> list[str]:
    """Conservation of each invariant over the trajectories, in a sentence."""
    lines = []
    for row in report["invariants"]:
        middle, most = (two_digits(row["max_deviation"][name]) for name in ("median", "max"))
        within = f"{row['within_round_off']} of {counted(row['judged'], 'trajectory')} within round-off"
        lines.append(f"{row['symbol']}: {within}; largest deviation: median {middle}, maximum {most}")
    return lines


ENSEMBLE_BRIEF = Table(
    "invariants",
    (
        Column("invariant", "symbol"),
        Column("within round-off", _within_round_off),
        Column("max deviation, median", "max_deviation.median", number),
        Column("max deviation, max", "max_deviation.max", number),
    ),
    caption="Quantiles over the trajectories; -v prints all values.",
)
"""Summary of an ensemble as a terminal shows it without ``--verbose``."""
