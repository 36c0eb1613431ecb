"""The report of an ensemble: as plain data for ``report.json``, as Markdown, and as lines of a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from topcli.analysis.drift import ROUND_OFF_ULPS
from topcli.analysis.many import QUANTILES, ManyTally, summary_rows
from topcli.config.ensemble import EnsembleExperiment
from topcli.contracts import Ending, Outcome
from topcli.studies.report import SCHEMA_VERSION, finite, markdown_table, number, report_head

SHOWN = 20
"""Failures that are listed one by one; the table of trajectories has them all."""
TITLES = {"max_deviation": "max deviation", "rms_deviation": "rms deviation", "final_deviation": "deviation at the end"}


FAILED = (Outcome.LEFT_MOTION, Outcome.BLEW_UP, Outcome.NO_CONVERGENCE)


def _failure(ending: Ending) -> dict[str, Any]:
    """Step and time at which a trajectory failed: the first of a failure that did not end it."""
    if ending.outcome is Outcome.LEFT_MOTION:
        return {"step": ending.left, "t": ending.left_t}
    return {"step": ending.step, "t": ending.t}


def overall(endings: Sequence[Ending], N: int) -> tuple[Outcome, str]:
    """How the ensemble ended, and a line that says so: interrupted, or completed if all are, or the first failure."""
    counts = Counter(ending.outcome for ending in endings)
    total = len(endings)
    words = {
        Outcome.COMPLETED: "completed",
        Outcome.LEFT_MOTION: "left their energy surface",
        Outcome.BLEW_UP: "blew up",
        Outcome.NO_CONVERGENCE: "did not converge",
        Outcome.INTERRUPTED: "interrupted",
    }
    if counts[Outcome.COMPLETED] == total:
        return Outcome.COMPLETED, f"all {total} trajectories completed {N} step{'s' * (N != 1)}"
    told = ", ".join(f"{counts[outcome]} {word}" for outcome, word in words.items() if counts[outcome])
    message = f"of {total} trajectories {told}"
    failed = [i for i, end in enumerate(endings) if end.outcome in FAILED]
    if failed:
        message += f"; the first of them, trajectory {failed[0]}, {endings[failed[0]].message}"
    if counts[Outcome.INTERRUPTED]:
        return Outcome.INTERRUPTED, message
    return endings[failed[0]].outcome, message


def ensemble_report(
    experiment: EnsembleExperiment, endings: Sequence[Ending], tallies: Sequence[ManyTally], seconds: dict[str, Any]
) -> dict[str, Any]:
    """The content of ``report.json``."""
    first = experiment.first
    outcome, message = overall(endings, first.N)
    failures = [
        {"trajectory": i, "outcome": ending.outcome.value, **_failure(ending)}
        for i, ending in enumerate(endings)
        if ending.outcome in FAILED
    ]
    counters: Counter[str] = Counter()
    for ending in endings:
        counters.update(ending.counters)
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            "kind": "ensemble",
            "name": experiment.name,
            "digest": experiment.digest,
            "top": first.top.kind,
            "top_title": first.top.title,
            "scheme": first.scheme.name,
            "scheme_title": first.scheme.title,
            "h": first.h,
            "N": first.N,
            "trajectories": len(endings),
            "store": experiment.store,
            "outcome": outcome.value,
            "message": message,
            "outcomes": dict(Counter(ending.outcome.value for ending in endings)),
            "failures": failures[:SHOWN],
            "counters": dict(counters),
            "seconds": seconds,
            "round_off_ulps": ROUND_OFF_ULPS,
            "invariants": summary_rows(tallies),
        }
    )


def ensemble_table(report: dict[str, Any]) -> list[list[str]]:
    """Lines of cells, a column for each invariant; the first line is the header."""
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
    """``report.md``: the same content for a reader."""
    listed = [f"- trajectory {f['trajectory']}: {f['outcome']} at step {f['step']}" for f in report["failures"]]
    failed = sum(report["outcomes"].get(outcome.value, 0) for outcome in FAILED)
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
    ]
    return "\n".join(lines)
