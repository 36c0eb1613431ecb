"""Report of an ensemble: plain data for ``report.json``, Markdown for ``report.md``, lines of a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from topcli.analysis.tally import QUANTILES, ROUND_OFF_ULPS
from topcli.config.ensemble import EnsembleExperiment
from topcli.contracts import Ending, Outcome
from topcli.engine.endings import NO_FAILURE, Endings
from topcli.runs.accuracy import seconds_note
from topcli.runs.report import SCHEMA_VERSION, finite, heading, report_head
from topcli.table import markdown_table, number

SHOWN = 20
"""Failures listed in the report; the table of trajectories contains all of them."""
TITLES = {"max_deviation": "max deviation", "rms_deviation": "rms deviation", "final_deviation": "deviation at the end"}


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
        """The first SHOWN trajectories that failed."""
        self._counts: Counter[Outcome] = Counter()

    def add(self, endings: Endings) -> None:
        """Add the endings of the next trajectories."""
        self._counts.update(endings.outcomes)
        self.counters.update(endings.totals)
        for i in endings.failed[: SHOWN - len(self.failures)].tolist():
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
            return f"all {self.total} trajectories completed {self.N} step{'s' * (self.N != 1)}"
        counted = ", ".join(f"{count} {WORDS[Outcome(name)]}" for name, count in self.outcomes.items())
        message = f"of {self.total} trajectories {counted}"
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
) -> dict[str, Any]:
    """Content of ``report.json``; ``invariants`` are the rows of the ensemble's summary."""
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            "kind": "ensemble",
            **heading(experiment.first, experiment.name, digest),
            "trajectories": endings.total,
            "store": experiment.store,
            "outcome": endings.outcome.value,
            "message": endings.message,
            "outcomes": endings.outcomes,
            "failures": [{"trajectory": i, **_failure(ending)} for i, ending in endings.failures],
            "counters": dict(endings.counters),
            "seconds": seconds,
            "round_off_ulps": ROUND_OFF_ULPS,
            "invariants": list(invariants),
        }
    )


def ensemble_table(report: dict[str, Any]) -> list[list[str]]:
    """Ensemble report as lines of cells, a column for each invariant; the first line is the header."""
    rows = report["invariants"]
    lines = [
        ["invariant", *(row["symbol"] for row in rows)],
        ["within round-off", *(f"{row['within_round_off']} of {row['judged']}" for row in rows)],
    ]
    for measure, title in TITLES.items():
        names = QUANTILES if measure == "max_deviation" else ("median", "max")
        lines += [[f"{title}, {name}", *(number(row[measure][name]) for row in rows)] for name in names]
    return lines


def ensemble_markdown(report: dict[str, Any]) -> str:
    """Content of ``report.md``."""
    listed = [f"- trajectory {f['trajectory']}: {f['outcome']} at step {f['step']}" for f in report["failures"]]
    failed = sum(count for outcome, count in report["outcomes"].items() if outcome not in NO_FAILURE)
    if failed > len(listed):
        listed.append(f"- and {failed - len(listed)} more")
    lines = [
        *report_head(report, f"{report['trajectories']} trajectories, ", listed, ", all trajectories together"),
        *markdown_table(ensemble_table(report)),
        "",
        "Deviations of each trajectory are from its own first value, over its recorded rows; the lines give quantiles "
        "over the trajectories. *Within round-off*: trajectories whose largest deviation stays below "
        f"{ROUND_OFF_ULPS:g} ulp × √steps of the invariant's terms.",
        "",
        seconds_note(report["seconds"]),
        "",
    ]
    return "\n".join(lines)
