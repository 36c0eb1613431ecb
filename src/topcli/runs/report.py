"""Reports on runs and ensembles: data for ``report.json``, and tables that show them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.tally import DEVIATIONS, QUANTILES, QUANTITY_FIGURES
from topcli.analysis.verdict import LOST, ROUND_OFF_ULPS, SIGNIFICANCE, InvariantRow
from topcli.contracts import Array, Ending, Outcome
from topcli.engine.endings import Endings
from topcli.errors import counted
from topcli.table import Format, Table, number, plus_minus, rounded_up, ten_digits, two_digits

if TYPE_CHECKING:
    from topcli.analysis.quantities import Quantity
    from topcli.config.models import Experiment

SCHEMA_VERSION = 1


NAMES = {
    "symbol": "invariant",
    "first": "first value",
    "max_deviation_relative": "max deviation, relative",
    "rms_deviation_relative": "rms deviation, relative",
    "drift": "drift per unit time",
    "drift_error": "standard error of the drift",
    "drift_bound": "95 % bound of the drift",
    "round_off_bound": "round-off bound",
    "within_round_off": "within round-off",
}
"""Headings of figures on an invariant that are not their names."""
FORMATS: dict[str, Format] = {
    **dict.fromkeys(("first", "min", "max"), ten_digits),
    "drift_error": two_digits,
    "drift_bound": lambda bound: two_digits(bound and rounded_up(bound)),
}
SENTENCES = ("name", "statement", "reason")
"""Fields that tables leave out."""
VERDICT_MARKS = {"lost": "bad", "drifting": "middling", "exact": "good"}
"""Looks of the verdicts on terminals and pages."""


def invariant_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Table of all figures on the invariants, one a column."""
    lines = [{key: value for key, value in row.items() if key not in SENTENCES} for row in rows]
    return Table("Conservation laws", lines, FORMATS, names=NAMES, across=True, marks=VERDICT_MARKS)


def report_tables(report: Mapping[str, Any]) -> list[Table]:
    """Tables of the content of ``report.json``: invariants, and the user's own observables."""
    invariants = ensemble_table if report.get("kind") == "ensemble" else invariant_table
    quantities = [{key: row[key] for key in ("name", *QUANTITY_FIGURES)} for row in report.get("quantities", ())]
    formats: dict[str, Format] = dict.fromkeys(QUANTITY_FIGURES, ten_digits)
    observables = [Table("Quantities", quantities, formats, names={"name": "quantity"})] if quantities else []
    return [invariants(report["invariants"]), *observables]


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


def brief_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Table of the invariants as a terminal shows it without ``--verbose``, a line for each."""
    columns = ("symbol", "first", "max_deviation", "drift", "verdict")
    lines = [
        {**{key: row[key] for key in columns}, "max_deviation": deviation_text(row), "drift": drift_text(row)}
        for row in rows
    ]
    caption = "Deviations are relative, drifts have 95 % bounds; -v prints all values."
    return Table("", lines, FORMATS, names=NAMES, right=columns[1:4], caption=caption, marks=VERDICT_MARKS)


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


def precision_note(report: Mapping[str, Any]) -> str:
    """Precision of a run in one line; empty for doubles."""
    precision = report.get("precision")
    if precision is None:
        return ""
    return f"computed with {precision} digits" if isinstance(precision, int) else "computed in rational numbers"


def _common(
    experiment: Experiment,
    digest: str,
    outcome: Outcome,
    message: str,
    seconds: Mapping[str, Any],
    quantities: Sequence[dict[str, Any]],
    crossings: NDArray[np.int64] | None,
) -> dict[str, Any]:
    """Entries of ``report.json`` that runs and ensembles share."""
    return {
        "schema_version": SCHEMA_VERSION,
        "name": experiment.name,
        "digest": digest,
        "top": experiment.top.kind,
        "top_title": experiment.top.title,
        "scheme": experiment.scheme.name,
        "scheme_title": experiment.scheme.title,
        "h": experiment.h,
        "N": experiment.N,
        "outcome": outcome.value,
        "message": message + section_note(experiment, crossings),
        **section_data(crossings),
        "seconds": dict(seconds),
        "round_off_ulps": ROUND_OFF_ULPS,
        **({"quantities": list(quantities)} if quantities else {}),
    }


def report_of_run(
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
    return finite(
        {
            **_common(experiment, digest, ending.outcome, ending.message, seconds, quantities, crossings),
            "step": ending.step,
            "t": ending.t,
            "left_motion": None if ending.left is None else {"step": ending.left, "t": ending.left_t},
            "counters": dict(ending.counters),
            **further,
            "significance": SIGNIFICANCE,
            "lost": LOST,
            "invariants": [row.as_dict() for row in rows],
        }
    )


def quantity_rows(
    quantities: Sequence[Quantity], figures: Mapping[str, Array], crossings: NDArray[np.int64] | None
) -> list[dict[str, Any]]:
    """Plain data for each quantity: name, formula, and its ``figures`` (B,) over all trajectories together.

    First, last and mean are averages over the trajectories; of a section, over those with ``crossings`` (B,).
    """
    join, rows = {"min": np.min, "max": np.max}, []
    for quantity in quantities:
        row: dict[str, Any] = {"name": quantity.name, "formula": quantity.formula}
        for figure in QUANTITY_FIGURES:
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
    surface = experiment.crossings
    if surface is None or crossings is None:
        return ""
    where = f"{surface.formula} = {surface.value:g}" + (
        "" if surface.direction == "both" else f" ({surface.direction})"
    )
    total, never = int(crossings.sum()), int((crossings == 0).sum())
    if not total:
        return f"; no crossing of the section {where}"
    note = f"; {counted(total, 'crossing')} of the section {where}"
    return note + (f"; {never} of {len(crossings)} trajectories have not crossed it" if never else "")


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


SHOWN_TRAJECTORIES = 20
"""Failures listed in the report; the table of trajectories contains all of them."""


_WORDS = {
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


def ensemble_outcome(endings: Endings) -> Outcome:
    """Outcome of an ensemble: interrupted if any trajectory is; else that of the first failure; else completed."""
    if Outcome.INTERRUPTED in endings.outcomes:
        return Outcome.INTERRUPTED
    failed = endings.failed
    return endings[int(failed[0])].outcome if len(failed) else Outcome.COMPLETED


def ensemble_message(endings: Endings, N: int) -> str:
    """Outcomes of the trajectories of an ensemble of N steps, and the first failure, in one line."""
    counts, failed = endings.outcomes, endings.failed
    if counts.get(Outcome.COMPLETED) == len(endings):
        return f"all {len(endings)} trajectories completed {counted(N, 'step')}"
    outcomes = ", ".join(f"{count} {_WORDS[outcome]}" for outcome, count in counts.items())
    message = f"of {len(endings)} trajectories {outcomes}"
    if len(failed):
        message += f"; the first of them, trajectory {failed[0]}, {endings[int(failed[0])].message}"
    return message


def report_of_ensemble(
    experiment: Experiment,
    digest: str,
    endings: Endings,
    invariants: Sequence[dict[str, Any]],
    seconds: Mapping[str, Any],
    quantities: Sequence[dict[str, Any]] = (),
    crossings: NDArray[np.int64] | None = None,
) -> dict[str, Any]:
    """Content of ``report.json``; ``invariants`` and ``quantities`` are the rows of the ensemble's summaries."""
    outcome, message = ensemble_outcome(endings), ensemble_message(endings, experiment.N)
    return finite(
        {
            "kind": "ensemble",
            **_common(experiment, digest, outcome, message, seconds, quantities, crossings),
            "trajectories": len(endings),
            "store": experiment.ensemble.store if experiment.ensemble else "",
            "outcomes": {outcome.value: count for outcome, count in endings.outcomes.items()},
            "failures": [
                {"trajectory": i, **_failure(endings[i])} for i in endings.failed[:SHOWN_TRAJECTORIES].tolist()
            ],
            "counters": endings.totals,
            "invariants": list(invariants),
        }
    )


def _within_round_off(row: Mapping[str, Any]) -> str:
    """Number of trajectories whose invariant stays within round-off, of those judged."""
    return f"{row['within_round_off']} of {row['judged']}"


def ensemble_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Table of the quantiles over the trajectories, each invariant a column."""
    lines = []
    for row in rows:
        quantiles = {
            f"{measure.replace('_', ' ')}, {name}": row[measure][name]
            for measure in DEVIATIONS
            for name in (QUANTILES if measure == "max_deviation" else ("median", "max"))
        }
        lines.append({**{key: row[key] for key in ("symbol", "within_round_off", "judged")}, **quantiles})
    caption = "Quantiles over the trajectories."
    return Table("Conservation laws", lines, names=NAMES, across=True, caption=caption)


def ensemble_statements(report: Mapping[str, Any]) -> list[str]:
    """Conservation of each invariant over the trajectories, in a sentence."""
    lines = []
    for row in report["invariants"]:
        middle, most = (two_digits(row["max_deviation"][name]) for name in ("median", "max"))
        within = f"{row['within_round_off']} of {counted(row['judged'], 'trajectory')} within round-off"
        lines.append(f"{row['symbol']}: {within}; largest deviation: median {middle}, maximum {most}")
    return lines


def brief_ensemble_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Summary of an ensemble as a terminal shows it without ``--verbose``."""
    lines = [
        {
            "symbol": row["symbol"],
            "within round-off": _within_round_off(row),
            "max deviation, median": row["max_deviation"]["median"],
            "max deviation, max": row["max_deviation"]["max"],
        }
        for row in rows
    ]
    caption, right = "Quantiles over the trajectories; -v prints all values.", list(lines[0])[1:]
    return Table("", lines, names=NAMES, right=right, caption=caption)
