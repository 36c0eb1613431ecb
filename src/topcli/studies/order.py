"""``topcli order``: errors over a ladder of step sizes, observed orders of convergence, the plateau of round-off."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from topcli.analysis.order import OrderVerdict, convergence, is_consistent, judge_order
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Scheme
from topcli.engine.fingerprint import fingerprint
from topcli.errors import UnknownNameError, UsageError, nearest, quoted, shortened
from topcli.runs.identity import scheme_code
from topcli.runs.report import finite
from topcli.schemes.registry import all_schemes
from topcli.store.files import stored_study
from topcli.store.provenance import environment
from topcli.studies import SILENT, Watch
from topcli.studies.bench.contest import Problem, Rung, choose
from topcli.studies.bench.measure import Effort, Measurements, SchemeCompetitor, explore
from topcli.studies.entries import cited_parts, scheme_with
from topcli.studies.roundoff import GENERIC, SCENES
from topcli.studies.study import ConfigSource, Data, Faults, Flag, Head, Overrides, Result, SchemeNames, Study, TopName
from topcli.table import EVERY, Column, Table, two_digits

DEFAULT = ("bohlin-a", "hk", "hybrid", "rk4", "hk+kahan-li6", "hk+kahan-li8")
"""Schemes of the study that ``topcli plot order`` draws, on the generic motion of Kowalevski's top."""
DURATION = 10.0
"""Length of a run in time, unless a config gives it."""
INTERVALS = 20
"""Number of intervals between the evenly spaced times at which errors are measured."""
STEPS = 4_000_000
"""Largest number of steps of one run."""
SECONDS = 5.0
"""CPU seconds that one run may take."""
FALSE = (OrderVerdict.TOO_LOW, OrderVerdict.INCONSISTENT)
"""Verdicts on a scheme whose declared order is false."""
FILE = Path("order") / "order.json"
SCHEMA_VERSION = 2


class _Ladder(SchemeCompetitor):
    """A scheme over its ladder of step sizes up to ``most`` steps a run, or over the step sizes that are given."""

    def __init__(self, scheme: Scheme, problem: Problem, most: int, rungs: Sequence[Rung]) -> None:
        super().__init__(scheme, problem)
        self._most, self._given = most, rungs

    def is_consistent(self) -> bool:
        """True if single steps from the problem's initial state are consistent with the equations of motion."""
        method = self._scheme.build(self._problem.top, self._defaults())
        return is_consistent(self._problem.top, method, self._y0)

    def rungs(self) -> Iterator[Rung]:
        """Yield the rungs, coarse to fine."""
        for rung in self._given or super().rungs():
            if not self._given and rung.steps * self._problem.intervals > self._most:
                return
            yield rung


@dataclass(frozen=True)
class Ladders:
    """Plan of a study of orders: the ``schemes`` on a ``problem``, those left out with the reasons, the settings.

    ``sizes`` are the step sizes asked for, none for the ladder of each scheme, of at most ``steps`` steps a run.
    """

    problem: Problem
    schemes: tuple[Scheme, ...]
    left_out: tuple[tuple[str, str], ...]
    sizes: tuple[float, ...]
    steps: int

    @property
    def rungs(self) -> list[Rung]:
        """Settings of the ``sizes``, coarse to fine: the nearest steps that divide the time between comparisons."""
        interval = self.problem.interval
        counts = sorted({max(1, round(interval / size)) for size in self.sizes})
        return [Rung(interval / count, count) for count in counts]


def _default_config(names: Sequence[str], top: str | None) -> str:
    """Packaged scene of the form ``top``, or of the first one that all the schemes ``names`` fit."""
    scenes = {**SCENES, "kowalevski": GENERIC}
    if top is not None:
        if top.lower() not in scenes:
            raise UnknownNameError(f"--top: no scene for the top {quoted(top)}; {nearest(top, scenes)}")
        return scenes[top.lower()]
    bases = [name.lower().partition(":")[0].partition("+")[0] for name in names]
    fits = {base: {one.top for one in all_schemes() if one.name == base} for base in bases}
    for form, scene in scenes.items():
        if all(form in forms for forms in fits.values()):
            return scene
    for name in names:
        scheme_with(name, "kowalevski")  # names the nearest, if one is unknown, and the tops that it fits
    raise UsageError(f"no top fits all of {', '.join(names)}; name schemes of one top")


def _require_sizes(sizes: Sequence[float], interval: float) -> None:
    for size in sizes:
        if not (math.isfinite(size) and 0.0 < size <= interval * (1.0 + 1e-12)):
            raise UsageError(f"--h {size:g}: must be positive and at most {interval:g}, the time between comparisons")


def ladders(
    names: Sequence[str],
    *,
    top: str | None = None,
    config: str | Path | Mapping[str, Any] | None = None,
    sets: Sequence[str] = (),
    sizes: Sequence[float] = (),
    duration: float | None = None,
    steps: int = STEPS,
) -> Ladders:
    """Choose problem and schemes of a study; without ``names`` all schemes of fixed steps, or the default ones.

    Parameters
    ----------
    names : sequence of str
        Schemes. Without names, ``top`` and ``config`` they are those of ``DEFAULT``.
    top : str, optional
        Form of a top, whose packaged scene is run.
    config : str, Path or mapping, optional
        Config, scene or content of a config that gives the top, the initial state and, by N*h, the duration.
    sets : sequence of str
        Overrides of the config.
    sizes : sequence of float
        Step sizes; by default the ladder of each scheme.
    duration : float, optional
        Length of a run in time.
    steps : int
        Largest number of steps of a run on a ladder.

    Raises
    ------
    UsageError
        For an unknown or unfit scheme or top, a step size out of range, or if no scheme remains.
    """
    if top is not None and config is not None:
        raise UsageError("--top and --config both choose the scene; give one of them")
    wanted = names or (DEFAULT if top is None and config is None else ())
    experiment = load_experiment(_default_config(wanted, top) if config is None else config, sets)
    own = experiment.duration if config is not None else DURATION
    length = own if duration is None else duration
    if not (math.isfinite(length) and length > 0.0):
        raise UsageError(f"the duration {length:g} must be positive; give another with --duration")
    problem = Problem(experiment.name, experiment.top.title, experiment, length, INTERVALS)
    _require_sizes(sizes, problem.interval)
    for name in wanted:
        scheme_with(name, problem.top.form)
    found = choose(problem, wanted)
    adaptive = [(one.name, "its steps follow a tolerance, not h") for one in found.schemes if one.adaptive]
    exact = [(one.name, "is a closed form: its error does not depend on h") for one in found.exact]
    exact += [(one.name, "has no error that depends on h") for one in found.schemes if not (one.order or one.adaptive)]
    schemes = tuple(one for one in found.schemes if one.order is not None and not one.adaptive)
    left_out = (*found.left_out, *adaptive, *exact)
    if not schemes:
        raise UsageError(f"no scheme with an order to observe: {'; '.join(': '.join(one) for one in left_out)}")
    return Ladders(problem, schemes, left_out if names else (), tuple(sizes), steps)


def _row(ladder: _Ladder, measured: Measurements, size: float) -> dict[str, Any]:
    """Errors of one scheme as plain data, with the observed order, the verdict on the declared one, and the plateau.

    ``size`` is the largest distance of the motion from its start.
    """
    sizes = [rung.rung.value for rung in measured.rungs]
    errors = [rung.error for rung in measured.rungs]
    found = convergence(sizes, errors)
    verdict, why = None, ""
    if ladder.order is not None and not measured.broken:
        verdict, why = judge_order(ladder.order, found, size, ladder.is_consistent)
    return {
        "scheme": ladder.name,
        "declared_order": ladder.order,
        "order": found.order,
        "verdict": verdict,
        "why": why,
        "fitted": list(found.fitted),
        "plateau": found.plateau,
        "onset": found.onset,
        "ended": measured.ended,
        "broken": measured.broken or None,
        "failed": [{"h": value, "reason": reason} for value, reason in measured.failed],
        "points": [{"h": rung.rung.value, "error": rung.error, "end_error": rung.end_error} for rung in measured.rungs],
    }


def order_study(what: Ladders, on_progress: Callable[[int, int], None] = lambda done, total: None) -> dict[str, Any]:
    """Run each scheme over its step sizes and measure its errors; plain data, ready for JSON.

    Errors are the largest Euclidean norms of the difference of states from the Taylor reference in double-double
    arithmetic at the common times. Raises RunError if the reference cannot follow the motion.
    """
    problem = what.problem
    reference = reference_states(problem.top, problem.experiment.y0, problem.times)
    size = float(np.linalg.norm(reference - reference[0], axis=1).max())
    rows = []
    for i, scheme in enumerate(what.schemes):
        ladder = _Ladder(scheme, problem, what.steps, what.rungs)
        rows.append(_row(ladder, explore(ladder, problem, reference, Effort(SECONDS)), size))
        on_progress(i + 1, len(what.schemes))
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            "name": problem.name,
            "top": problem.top.title,
            "config": problem.experiment.resolved(),
            "duration": problem.duration,
            "intervals": problem.intervals,
            "schemes": rows,
            "left_out": [{"scheme": name, "reason": reason} for name, reason in what.left_out],
            "environment": environment(),
        }
    )


def order_source(what: Ladders) -> str:
    """Digest of everything that the results of a study depend on."""
    experiment: Experiment = what.problem.experiment
    codes = [scheme_code(scheme, what.problem.top) for scheme in what.schemes]
    code = fingerprint(
        order_study, _row, convergence, judge_order, is_consistent, explore, reference_states, compiled=False
    )
    settings = [what.problem.duration, what.problem.intervals, what.sizes, what.steps, SECONDS]
    text = json.dumps([experiment.digest, [scheme.name for scheme in what.schemes], codes, code, settings])
    return hashlib.sha256(text.encode()).hexdigest()


def stored_order(out: Path) -> dict[str, Any] | None:
    """Return the default study stored in ``out``; None if there is none. Raises RunError if it is damaged."""
    return stored_study(out / FILE, SCHEMA_VERSION, "topcli order")


def _sizes(texts: Sequence[str]) -> list[float]:
    """Step sizes of the options ``--h``. Raises UsageError."""
    try:
        return [float(text) for text in texts]
    except ValueError:
        given = [part.strip() for text in texts for part in text.split(",")]
        right = " ".join(f"--h {part}" for part in given)
        known = all(re.fullmatch(r"[-+.\deE]+", part) for part in given)
        raise UsageError(
            f"--h {quoted(','.join(texts))}: must be one number; "
            + (f"repeat the option for several: {shortened(right)}" if known else "for example --h 0.1 --h 0.05")
        ) from None


def measure(
    *schemes: SchemeNames,
    top: TopName = None,
    config: ConfigSource = None,
    overrides: Overrides = (),
    sizes: Annotated[Sequence[float], Flag("--h", "H", read=_sizes, default="a ladder")] = (),
    duration: Annotated[float | None, Flag("--duration", "T", default="10, or N*h")] = None,
    steps: Annotated[int, Flag("--steps", "N", least=1)] = STEPS,
    watch: Watch = SILENT,
) -> Result:
    """Measure errors over h, observed orders and round-off.

    Errors are the largest over the run against a reference in double-double arithmetic. The order is fitted at the
    smallest steps above the plateau of round-off. Exits with status 4 if it is below the declared order, and with 3 if
    the code of some of the schemes fails.

    Parameters
    ----------
    *schemes : str
        Names of schemes; all by default. Without ``top`` and ``config``, six by default.
    top : str, optional
        Run the packaged scene of this top.
    config : path, str or mapping, optional
        Run this config or scene for its N*h. It gives the top, the initial state and the duration.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    sizes : sequence of float, optional
        Use this step size; repeat for several. By default a ladder for each scheme; dimensionless.
    duration : float, optional
        Run for the time T.
    steps : int, optional
        Take at most N steps in a run of a ladder.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Errors are the largest Euclidean norms of the difference of states from a Taylor reference in double-double
        arithmetic at common times. ``table`` has a row for each scheme, ``errors`` one for each step size.

    Raises
    ------
    UsageError
        For an unknown or unfit scheme or top, or a step size out of range.
    RunError
        If the reference cannot follow the motion.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.order("hk", "rk4", config="euler_hk", duration=2, sizes=[0.1, 0.05, 0.025])
    >>> report.table["order"].round(1).to_dict()
    {'hk': 2.0, 'rk4': 4.0}
    >>> report.errors.shape
    (3, 2)
    """
    plan = ladders(schemes, top=top, config=config, sets=overrides, sizes=sizes, duration=duration, steps=steps)
    file = FILE if plan == ladders(()) else None
    watch.begin("order", plan.problem.experiment, file=file)
    used = [rung.value for rung in plan.rungs]
    for size in plan.sizes:
        near = min(used, key=lambda value: abs(value - size))
        if abs(near - size) > 1e-9 * size:
            watch.message(f"h = {size:g} becomes {near:.6g}, which divides the time between comparisons")
    return Result(order_study(plan, watch), source=lambda: order_source(plan), file=file)


def _best(key: str) -> Callable[[Data], float | None]:
    """Figure of the point with the smallest error of a scheme."""

    def value(row: Data) -> float | None:
        known = [point for point in row["points"] if point["error"] is not None]
        return min(known, key=lambda point: point["error"])[key] if known else None

    return value


def _errors_at(data: Data) -> list[Data]:
    """Errors by scheme at each step size: nan if one is not finite, nothing if the scheme was not run."""
    errors: dict[float, Data] = {}
    for row in data["schemes"]:
        for point in row["points"]:
            error = math.nan if point["error"] is None else point["error"]
            errors.setdefault(point["h"], {"h": point["h"]})[row["scheme"]] = error
    return [errors[h] for h in sorted(errors, reverse=True)]


def _error_columns(data: Data) -> list[Column]:
    names = [row["scheme"] for row in data["schemes"]]
    return [
        Column("h", "h", "{:.4g}".format),
        *(Column(name, lambda row, name=name: row.get(name), two_digits, name) for name in names),
    ]


def _subject(data: Data) -> str:
    return f"{data['name']}: {data['top']}, t from 0 to {data['duration']:g}"


def _span(sizes: Sequence[float]) -> str:
    return f"{two_digits(sizes[0])} to {two_digits(sizes[-1])}"


ORDERS = Table(
    "schemes",
    (
        Column("scheme", "scheme"),
        Column("order", "declared_order"),
        Column("observed", "order", "{:.2f}".format),
        Column("verdict", "verdict"),
        Column(
            "fitted over h", lambda row: row["fitted"] or None, lambda h: f"{two_digits(h[0])} to {two_digits(h[-1])}"
        ),
        Column("round-off", "plateau", two_digits),
        Column("from h", "onset", two_digits),
        Column("", "ended"),
        Column("", "broken"),
        Column("smallest error", _best("error"), two_digits, "smallest_error"),
        Column("at h", _best("h"), two_digits, "at_h"),
    ),
    heading="Observed orders",
    title=_subject,
    index="scheme",
)
ERRORS = Table(
    _errors_at,
    _error_columns,
    name="errors",
    heading="Largest error at each h",
    title="largest error at each h",
    index="h",
    numbers=EVERY,
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    broken = sum(bool(row["broken"]) for row in data["schemes"])
    return Head("Orders of convergence", _subject(data), f"{broken} failed" if broken else "measured", not broken)


def notes(data: Data) -> Iterator[str]:
    """Schemes left out, step sizes without a result, and undecided orders."""
    for left in data["left_out"]:
        yield f"{left['scheme']} is left out: {left['reason']}"
    for row in data["schemes"]:
        if row["failed"] and not row["broken"]:
            first = row["failed"][0]
            failed = f"{len(row['failed'])} of its step sizes gave no result"
            yield f"{row['scheme']}: {failed}; h = {first['h']:.2g} {first['reason']}"
        if not row["broken"] and row["verdict"] not in FALSE and row["why"] and len(row["points"]) > 2:
            yield f"{row['scheme']}: order undecided: {row['why']}"


def faults(data: Data) -> Faults:
    """Code that failed, schemes without a result, and orders that are not as declared."""
    rows = data["schemes"]
    broken = [f"{row['scheme']}: {row['broken']}" for row in rows if row["broken"]]
    false = [f"{row['scheme']}: {row['why']}" for row in rows if not row["broken"] and row["verdict"] in FALSE]
    if broken:
        return Faults(3 if len(broken) < len(rows) else 2, [*broken, *false])
    return Faults(1 if not all(row["points"] for row in rows) else 4 if false else 0, false)


ORDER = Study(
    "order",
    measure,
    head,
    (ORDERS, ERRORS),
    notes=notes,
    faults=faults,
    figure="topcli.figures.errors:loaded_order",
    draws="the errors over h into DIR/figures",
    captions=("largest error over the step size h, with observed orders",),
    parts=cited_parts,
    unit="schemes",
    file=FILE,
    known=lambda data: "duration" in data and "schemes" in data,
)
