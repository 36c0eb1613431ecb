"""Reports of runs and ensembles: plain data for ``report.json``, Markdown for ``report.md``, cells for tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.quantities import FIGURES
from topcli.analysis.tally import LOST, QUANTILES, ROUND_OFF_ULPS, SIGNIFICANCE, TERMS, InvariantRow
from topcli.contracts import Ending, Method, Outcome, Sampler
from topcli.engine.run import NO_FAILURE, Endings
from topcli.table import Column, Table, markdown_table, number, ten_digits, two_digits

if TYPE_CHECKING:
    from topcli.analysis.algebraic_growth import DigitGrowth
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment
    from topcli.engine.setups import SetupTime

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
    ReportColumn("first", "first", ten_digits),
    ReportColumn("min", "min", ten_digits),
    ReportColumn("max", "max", ten_digits),
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
    summary: dict[str, Any], rows: Sequence[InvariantRow], quantities: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """Content of ``report.json``: the ``summary`` of the run, a row for each invariant, and for each quantity."""
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            **summary,
            "round_off_ulps": ROUND_OFF_ULPS,
            "significance": SIGNIFICANCE,
            "lost": LOST,
            "invariants": [row.as_dict() for row in rows],
            **({"quantities": list(quantities)} if quantities else {}),
        }
    )


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
    note = f"; {total} crossing{'s' * (total != 1)} of the section {where}"
    return note + (f"; {never} of {len(crossings)} trajectories never crossed it" if never else "")


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


def _quantities_markdown(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Section of ``report.md`` on the user's own observables; empty without them."""
    if not rows:
        return []
    formulas = [f"- {row['name']} = `{row['formula']}`" for row in rows]
    return ["## Quantities", "", *QUANTITIES.cells({"quantities": rows}).markdown(), "", *formulas, ""]


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
        *_quantities_markdown(report.get("quantities") or []),
        seconds_note(report["seconds"]),
        *(["", f"{note[0].upper()}{note[1:]}."] if (note := accuracy_note(report)) else []),
        "",
    ]
    return "\n".join(lines)


SAMPLED_STEPS = 200
"""Largest number of times at which the sensitivity of a motion is evaluated."""


class Timed(Protocol):
    """A run or an ensemble, with its times in seconds."""

    @property
    def compile_seconds(self) -> float:
        """Time to compile or load the code."""
        ...

    @property
    def cached(self) -> bool:
        """True if all code came from disk."""
        ...

    run_seconds: float
    setup: SetupTime | None


def seconds_of(run: Timed) -> dict[str, Any]:
    """Times of a run, as ``report.json`` holds them; that of the set-up only for closed forms that have one."""
    setup = run.setup
    return {
        "compile": run.compile_seconds,
        "compile_cached": run.cached,
        **({} if setup is None else {"setup": setup.seconds, "setup_cached": setup.cached}),
        "run": run.run_seconds,
    }


def seconds_note(seconds: Mapping[str, Any]) -> str:
    """Times of a run in a sentence."""
    parts = [f"Compiled or loaded in {seconds['compile']:.3g} s"]
    if "setup" in seconds:
        parts.append(f"{'loaded the set-up' if seconds['setup_cached'] else 'set up'} in {seconds['setup']:.3g} s")
    parts.append(f"ran in {seconds['run']:.3g} s")
    return f"{', '.join(parts)}."


def setup_message(experiment: EnsembleExperiment, threads: int | None = None) -> str:
    """Expected time of the set-ups of an ensemble, in one line; empty if it is below a second."""
    from topcli.engine.ensemble import default_threads
    from topcli.engine.setups import setup_estimate, setup_processes

    method = experiment.first.method()
    if not isinstance(method, Sampler) or method.setup is None:
        return ""
    count = experiment.count
    processes = setup_processes(method.setup, count, threads or default_threads())
    if processes == 0:
        return ""
    seconds = setup_estimate(method.setup, count) / processes
    where = "1 process" if processes == 1 else f"{processes} processes"
    return f"the set-up of {count} closed forms takes about {seconds:.0f} s in {where}, less if some are stored"


def accuracy_data(method: Method, experiment: Experiment, steps: int) -> dict[str, Any]:
    """Entry of ``report.json`` on the accuracy of a closed form over ``steps`` steps; none for other methods."""
    if not isinstance(method, Sampler) or method.accuracy is None:
        return {}
    n = np.unique(np.linspace(0, max(steps, 1), SAMPLED_STEPS).astype(np.int64))
    accuracy = method.accuracy(np.array(experiment.y0), experiment.h, n, experiment.top.constants())
    return {"accuracy": accuracy._asdict()}


def accuracy_note(report: Mapping[str, Any]) -> str:
    """Accuracy of a closed form, in one line; empty for other methods."""
    accuracy = report.get("accuracy")
    if not accuracy:
        return ""
    change = accuracy["sensitivity"]
    then = (
        "the sensitivity to the initial state is unknown, because a state one ulp away is not covered"
        if change is None
        else f"one ulp in the initial state, which is taken as exact, changes the states by up to {change:.0e}"
    )
    return f"round-off at most about {accuracy['round_off']:.0e} ({accuracy['reason']}); {then}"


SHOWN_TRAJECTORIES = 20
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
        *_quantities_markdown(report.get("quantities") or []),
        seconds_note(report["seconds"]),
        "",
    ]
    return "\n".join(lines)
