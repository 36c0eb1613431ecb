"""``topcli stress``: schemes in hard cases of their tops, and failures compared with the limits that they declare.

A trial is one scheme in one case. It has one of these outcomes. *held*: the scheme does what it declares. *degraded*:
the scheme keeps its declared properties but loses accuracy. *broke*: the scheme blew up, did not converge, refused the
case, moved far from the exact motion, or lost a declared property. *not tried*: the case asks for a property that the
scheme does not declare, or it would take too long in the interpreter.

A new case is an entry of ``CASES``; its check is a function from a ``Trial`` to a ``Finding``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.order import observed_order
from topcli.analysis.reference import reference_states
from topcli.analysis.swings import minima_times
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Floats, Invariant, Outcome, Scheme, Stepper, Top
from topcli.engine.drive import Orbit, orbit
from topcli.engine.machine import machine_of
from topcli.errors import (
    ExitCode,
    RunError,
    StepTooLongError,
    UnknownNameError,
    counted,
    nearest,
    quoted,
    shortened,
)
from topcli.field.polynomial import field_of
from topcli.plugins import reason_of, users_error
from topcli.runs.references import REFERENCES, Reference
from topcli.schemes.registry import schemes_of
from topcli.studies import SILENT, Watch
from topcli.studies.entries import code_failures, entry_named, schemes_called
from topcli.studies.report import Report, Table
from topcli.testing import GENERIC, deviation
from topcli.tops import BUILT_IN, CATALOGUE, TOPS, forms, gentle_scene
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

HELD, NOT_TRIED, DEGRADED, BROKE = "held", "not tried", "degraded", "broke"
_EPS = float(np.finfo(float).eps)
INTERPRETED_STEPS = 400
"""Approximate number of steps of a scheme that runs in the interpreter, which takes longer ones instead."""


class Finding(NamedTuple):
    """Outcome of a trial, the reason in a short phrase with numbers, and the step at which the scheme failed."""

    outcome: str
    why: str
    step: int | None = None


class Trial:
    """One scheme in one case: the argument of a check."""

    def __init__(self, experiment: Experiment) -> None:
        self.experiment, self.top, self.y0 = experiment, experiment.top, experiment.y0
        self.scheme, self.order = experiment.scheme, experiment.scheme.order_for(experiment.options)
        self._machine = machine_of(self.top, self.scheme, experiment.options)
        self.plain = isinstance(self._machine.method, Stepper) and self._machine.method.plain
        factor = max(1, experiment.N // INTERPRETED_STEPS) if self.plain else 1
        self.h, self.N = experiment.h * factor, max(1, experiment.N // factor)

    def run(self, h: float | None = None, N: int | None = None, every: int = 1, y0: Floats | None = None) -> Orbit:
        """Orbit of the case; arguments replace its step size, number of steps or initial state."""
        with np.errstate(all="ignore"):
            start, invariants = y0 or self.y0, self.top.invariants()
            return orbit(self.top, self._machine, start, h or self.h, N or self.N, every, invariants)

    def reference(self, h: float, n: NDArray[np.int64]) -> Array:
        """States (m, d) of the exact motion at the times h n (m,)."""
        return REFERENCES.states(Reference(self.top), np.array(self.y0), h, n)

    def claimed(self, h: float) -> list[Invariant]:
        """Invariants that the scheme declares to conserve to round-off at step size ``h``."""
        conserved = [invariant for invariant in self.top.invariants() if invariant.name in self.scheme.conserves]
        modified = self.scheme.modified(self.top, h, self.experiment.options) if self.scheme.modified else ()
        return [*conserved, *modified]

    def fault(self, run: Orbit, h: float) -> Finding | None:
        """Finding on a run with step size ``h`` that did not complete or lost a claimed invariant; None otherwise."""
        ending, last = run.ending, int(run.n[-1])
        if ending.outcome is not Outcome.COMPLETED:
            step = ending.left if ending.outcome is Outcome.LEFT_MOTION else ending.step
            return Finding(BROKE, ending.message, step)
        for invariant in self.claimed(h):
            with np.errstate(all="ignore"):
                off = deviation(run.states, invariant, max(last, 1))
            if 1.0 < off < math.inf:  # terms beyond the range of a double cannot be judged
                return Finding(BROKE, f"{invariant.symbol} is off by {off:.1e} times what round-off explains", last)
        return None


Check = Callable[[Trial], Finding]
LEFT_ERROR = 0.5
"""Error relative to the state's size from which on the scheme has left the motion."""
ORDER_LOST = 0.35
"""Allowed shortfall of the observed order from the declared one."""
ADAPTIVE_ERROR, EXACT_ERROR = 1e-6, 1e-10
"""Largest errors, relative to the state, of a scheme that chooses its own steps, and of a closed form."""
RIGHT, ROUGH = 0.01, 0.1
"""Largest relative errors of a time for the outcomes held and degraded."""


def keeps_order(trial: Trial) -> Finding:
    """Check that the error falls with the declared order when the step is halved twice."""
    worst: list[float] = []
    for factor in (1,) if trial.scheme.adaptive or trial.order is None else (1, 2, 4):
        h = trial.h / factor
        run = trial.run(h, trial.N * factor, max(1, trial.N // 50) * factor)
        if fault := trial.fault(run, h):
            return fault
        expected = trial.reference(h, run.n)
        with np.errstate(all="ignore"):
            errors = np.abs(run.states - expected).max(axis=1) / (float(np.abs(expected).max()) or 1.0)
        worst.append(float(errors.max()))
        if not worst[-1] < LEFT_ERROR:
            at = int(np.argmax(~(errors < LEFT_ERROR)))
            why = f"left the exact motion: error {errors[at]:.1g} times its size at t = {h * run.n[at]:.3g}"
            return Finding(BROKE, why, int(run.n[at]))
    last = worst[-1]
    if len(worst) == 1:
        allowed = EXACT_ERROR if trial.order is None else ADAPTIVE_ERROR
        return Finding(HELD if last <= allowed else DEGRADED, f"error {last:.1e}")
    # errors at the level of round-off show no order
    floor = 64.0 * _EPS * math.sqrt(4.0 * trial.N)
    order = observed_order([4.0, 2.0, 1.0], worst, floor)
    if order is None or trial.order is None:
        return Finding(HELD, f"error {last:.1e}: round-off")
    why = f"order {order:.2f}, error {worst[0]:.1e}"
    if order >= trial.order - ORDER_LOST or last <= floor:
        return Finding(HELD, why)
    return Finding(DEGRADED, f"{why}; the declared order is {trial.order}")


def swings(trial: Trial, due: float, spacing: bool = False) -> Finding:
    """Check that the first deep minimum of the top's swinging component is at the time ``due``.

    With ``spacing``, that the second minimum follows the first by ``due``.
    """
    run = trial.run()
    if fault := trial.fault(run, trial.h):
        return fault
    values = run.states[:, trial.top.components.index(trial.top.swing)]
    times = minima_times(trial.h * run.n, values) if np.ptp(values) > 0.5 else np.empty(0)
    times = np.diff(times) if spacing else times
    if not len(times):
        return Finding(BROKE, f"no {'second ' * spacing}swing; due at {due:.4f}", round(due / trial.h))
    time, off = float(times[0]), abs(float(times[0]) - due) / due
    why = f"swings {'after' if spacing else 'at'} t = {time:.4f}"
    if off <= RIGHT:
        return Finding(HELD, f"{why}, relative error {off:.0e}")
    why += f", not {due:.4f} ({100 * off:.0f}% off)"
    return Finding(DEGRADED, why) if off <= ROUGH else Finding(BROKE, why, round(min(time, due) / trial.h))


def stays_bounded(trial: Trial) -> Finding:
    """Check that the state stays bounded with a step far too long for accuracy.

    The energy bounds the exact motion's omega. Held: within twice the largest value of the exact motion over ten of its
    time scales; degraded: within a hundred times; broke: beyond.
    """
    h, N = trial.experiment.h, 50 if trial.plain else trial.N
    run = trial.run(h, N)
    if fault := trial.fault(run, h):
        return fault
    scale = 1.0 / max(1e-3, float(np.abs(np.array(trial.y0)).max()))
    size = float(np.abs(trial.reference(0.1 * scale, np.arange(101))).max())
    sizes = np.abs(run.states).max(axis=1) / size
    largest = float(sizes.max())
    if largest <= 2.0:
        return Finding(HELD, f"stays within {largest:.2g} times the motion's size")
    at = int(run.n[np.argmax(sizes > 2.0)])
    why = f"grows to {largest:.1e} times the motion's size, beyond 2 at step {at}"
    return Finding(DEGRADED if largest <= 100.0 else BROKE, why, at)


def returns(trial: Trial) -> Finding:
    """Check that N steps forward and N back miss the start only by the growth of round-off.

    On a regular motion independent rounding errors change the integrals by sqrt(N) ulp, and with them the rates of the
    phases: after N steps the phases are off by ulp h N^(3/2), and after the way back by a few times that.
    """
    if trial.plain:
        return Finding(NOT_TRIED, "runs in the interpreter")
    there = trial.run(every=trial.N)
    complete = there.ending.outcome is Outcome.COMPLETED
    back = trial.run(h=-trial.h, every=trial.N, y0=tuple(there.states[-1].tolist())) if complete else there
    if back.ending.outcome is not Outcome.COMPLETED:
        return Finding(BROKE, back.ending.message, back.ending.step)
    y0 = np.array(trial.y0)
    missed = float(np.abs(back.states[-1] - y0).max()) / float(np.abs(y0).max())
    bound = 4.0 * _EPS * (math.sqrt(trial.N) + abs(trial.h) * trial.N**1.5)
    why = f"misses the start by {missed:.1e} (round-off: {bound:.1e})"
    if missed <= bound:
        return Finding(HELD, why)
    if trial.scheme.self_adjoint:
        return Finding(BROKE, f"declared self-adjoint, but {why}", 2 * trial.N)
    return Finding(DEGRADED, f"{why}; not self-adjoint")


@dataclass(frozen=True)
class Case:
    """Hard case: a ``question``, and the run by which ``check`` answers it.

    The ``state`` may be a function, which is called when a scheme is tried. Without ``h``, the step is the shortest one
    with which HK's linear system is singular.
    """

    question: str
    top: Top
    state: Floats | Callable[[], Floats]
    h: float | None = 0.02
    N: int = 200
    check: Check = keeps_order

    def experiment(self, text: str) -> Experiment:
        """The case under a scheme, such as ``hybrid`` or ``hybrid:branch=sign``. Raises UsageError."""
        state = self.state() if callable(self.state) else self.state
        h = singular_step(self.top, tuple(state)) if self.h is None else self.h
        start = {"top": self.top.section(), "initial": self.top.initial_section(state)}
        scheme = text.partition(":")[0]
        base = load_experiment({"name": "stress", **start, "scheme": scheme, "h": h, "N": self.N})
        return base if scheme == text else entry_named(base, text)


def singular_step(top: Top, state: Floats) -> float:
    """Least h > 0 at which HK's linear system, 1 - h/2 f', is singular at ``state``: 2 over an eigenvalue.

    Raises ValueError if there is none up to h = 60.
    """
    every = range(len(state))
    jacobian = [[float(rate.derivative(j).value(state)) for j in every] for rate in field_of(top)]
    steps = [2.0 / x.real for x in np.linalg.eigvals(jacobian) if x.imag == 0.0 and x.real > 2.0 / 60.0]
    if not steps:
        raise ValueError(f"{top!r}: HK's linear system is not singular at {state} up to h = 60")
    return min(steps)


def swing_time(eps: float) -> float:
    """Time of the first swing of the Kowalevski top from gamma3 = eps near the relative equilibrium at omega1 = 2.

    sqrt 2 ln(8 sqrt 7/eps), to leading order in eps, for A = B = 2, C = 1, c0 = 1.
    """
    return math.sqrt(2.0) * math.log(8.0 * math.sqrt(7.0) / eps)


def near_homoclinic(eps: float, N: int, due: float, spacing: bool = False) -> Case:
    """Case of the Kowalevski top at gamma3 = eps near the relative equilibrium at omega1 = 2."""
    question = f"near the upright rotation, gamma3 = {eps:g}: is the {'second' if spacing else 'first'} swing in time?"
    state = (2.0, 0.0, 0.0, math.sqrt(1.0 - eps * eps), 0.0, eps)
    return Case(question, TOP, state, 1e-3, N, partial(swings, due=due, spacing=spacing))


def passing(place: str, state: Floats) -> Case:
    """Case of the Kowalevski top that reaches ``state`` at t = 1, on a step."""
    start = cache(lambda: tuple(reference_states(TOP, state, np.array([-1.0]))[0].tolist()))
    return Case(f"{place}: is the order kept?", TOP, start, N=100)


TOP, LAGRANGE, OMEGA, GAMMA = Kowalevski(), Lagrange(), GENERIC[:3], GENERIC[3:]

SPINNING = (0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
CROSSING = (-0.8, 0.0, 0.5, 0.6, -0.48, -0.64)
DELONE = (0.9, 0.3, 1.0, 0.72, 0.54, math.sqrt(1.0 - 0.72**2 - 0.54**2))
REGULAR_STATES = {"heavy": (0.05, -0.04, 0.06, -0.70, -0.42, -0.577581)}
"""States of motions that are not chaotic, of tops whose generic motion is."""
SLEEPING = (0.0, 0.0, 2.0 * math.sqrt(LAGRANGE.A * LAGRANGE.mu) / LAGRANGE.C, math.sin(1e-6), 0.0, math.cos(1e-6))
"""State of the Lagrange top with C omega3 = 2 sqrt(A mu), the limit of stability."""
CASES: dict[str, dict[str, Case]] = {
    "kowalevski": {
        **{
            f"homoclinic-1e-{k}": near_homoclinic(10.0**-k, round((due + 6.0) / 1e-3), due)
            for k, due in ((k, swing_time(10.0**-k)) for k in (3, 6, 9))
        },
        "homoclinic-spacing": near_homoclinic(1e-3, 50_000, 2.0 * swing_time(1e-3), spacing=True),
        "pole": passing("gamma passes (0, 0, -1), the pole of its stereographic coordinate", (*OMEGA, 0.0, 0.0, -1.0)),
        "branch-point": passing("omega1 + i omega2 passes 0, where Bohlin's root is singular", (0.0, 0.0, 1.3, *GAMMA)),
        "real-axis": passing("omega1 + i omega2 crosses the real axis, where branch=sign errs", CROSSING),
        "rest-on-axis": Case("omega = 0, gamma = (0, 0, 1): is the order kept?", TOP, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)),
        "delone": Case("k = 0 (Delone's motion), where k² has no gradient: is the order kept?", TOP, DELONE),
        "delone-sleeping": Case("k = 0, gamma = omega = (0, 0, 1): is the order kept?", TOP, SPINNING),
        "strong-gravity": Case("c0 = 1e6, h = 2e-5: is the order kept?", Kowalevski(c0=1e6), GENERIC, 2e-5),
    },
    "lagrange": {
        "sleeping-threshold": Case("upright, at the limit of stability: is the order kept?", LAGRANGE, SLEEPING, N=1000)
    },
}
"""Cases of single tops by form and name, besides ``general_cases``."""


def has_own_cases(top: Top) -> bool:
    """True for the tops of the paper, which have cases of their own besides those of every top."""
    return top.form in BUILT_IN and top.form not in CATALOGUE


def general_cases(top: Top, state: Floats, regular: Floats) -> dict[str, Case]:
    """Cases of any top from a ``state``, the long one from one whose motion is ``regular``."""
    there = "1e5 steps forward and 1e5 back: is the initial state missed by round-off only?"
    cases = {
        "backwards": Case("h < 0: is the order the same as for h > 0?", top, state, -0.02),
        "one-step": Case("t = 0.1 in 1, 2 and 4 steps: does the error fall with the order?", top, state, 0.1, 1),
        "there-and-back": Case(there, top, regular, 0.02, 100_000, returns),
    }
    if has_own_cases(top):
        d, fast, huge = len(state), (3.0, -2.0, 6.0, *GAMMA), (*(1e150 * w for w in OMEGA), *GAMMA)
        bounded = "h = 1, about one turn per step: does the state stay bounded?"
        cases["resonance"] = Case(bounded, top, fast[:d], 1.0, 2000, stays_bounded)
        cases["huge"] = Case("omega of size 1e150, h of 1e-152: is the order kept?", top, huge[:d], 2e-152)
    if has_own_cases(top) and top.form != "lagrange/inertial":  # there the determinant cannot vanish
        singular = "h at which HK's first linear system is singular: does the state stay bounded?"
        cases["singular-step"] = Case(singular, top, state, None, 50, stays_bounded)
    return cases


def cases_of(form: str) -> dict[str, Case]:
    """Cases of a form of a top by name; those of a top of the catalogue begin in the state of its scene."""
    if form in CATALOGUE:
        scene = load_experiment(gentle_scene(form))
        top, state = scene.top, scene.y0
    else:
        top = TOPS[form].new()
        state = (GENERIC * len(top.components))[: len(top.components)]
    return {**CASES.get(form, {}), **general_cases(top, state, REGULAR_STATES.get(form, state))}


def forms_with_cases() -> list[str]:
    """Forms of tops that have cases of their own."""
    return [form for form in TOPS if form in CASES or has_own_cases(TOPS[form].new())]


OK, LIMIT, CODE_FAILED = "ok", "declared limit", "code failed"
UNEXPLAINED, OUTLIVED = "breaks without a declared limit", "holds in a case declared as its limit"


def verdict_of(scheme: Scheme, case: str, outcome: str) -> str:
    """Verdict on an outcome, given the limits that the scheme declares.

    A composed scheme has the limits of its base but need not reach them.
    """
    declared = case in scheme.limits
    if outcome == BROKE:
        return LIMIT if declared else UNEXPLAINED
    return OUTLIVED if declared and "+" not in scheme.name else OK


def row_of_trial(scheme: Scheme, text: str, name: str, case: Case) -> dict[str, Any]:
    """Row of the trial of a scheme, with the settings in its ``text``, in a case."""
    finding = Finding(BROKE, "", 0)
    failures: list[str] = []
    with code_failures(failures, text), np.errstate(all="ignore"):
        try:
            finding = case.check(Trial(case.experiment(text)))
        except (StepTooLongError, RunError) as error:
            finding = Finding(BROKE, f"refused: {str(error).splitlines()[0]}", 0)
        except (ArithmeticError, ValueError) as error:
            # the interpreter may raise where machine code returns inf or nan
            finding = Finding(BROKE, f"failed: {users_error(error) or reason_of(error)}", 0)
    verdict = CODE_FAILED if failures else verdict_of(scheme, name, finding.outcome)
    row = {"scheme": text, "top": scheme.top, "case": name, "outcome": finding.outcome, "step": finding.step}
    return {**row, "verdict": verdict, "why": failures[0].partition(": ")[2] if failures else finding.why}


def _chosen(names: Sequence[str], cases_named: Sequence[str], top: str | None) -> list[tuple[Scheme, str, str, Case]]:
    """Trials of the schemes and cases called so; of all if none is named. Raises UsageError for unknown names."""
    fits = [form.form for form in forms(top)] if top else sorted(TOPS)
    schemes = [(scheme, scheme.name) for form in fits for scheme in schemes_of(form)]
    if names:
        texts = dict.fromkeys(map(str.lower, names))
        schemes = [(scheme, text) for text in texts for scheme in schemes_called(text.partition(":")[0], fits)]
    cases = {form: cases_of(form) for form in dict.fromkeys(scheme.top for scheme, _ in schemes)}
    if top is None:  # tops without their own cases are tried if they are the only ones
        cases = {form: cases[form] for form in forms_with_cases() if form in cases} or cases
    names_of_cases = dict.fromkeys(name for of in cases.values() for name in of)
    order = [name.lower() for name in cases_named] or list(names_of_cases)
    for name in order:
        if name not in names_of_cases:
            where = top or "the tops of these schemes"
            raise UnknownNameError(f"unknown case {quoted(name)} of {where}; {nearest(name, names_of_cases)}")
    pairs = [(scheme, text, name) for scheme, text in schemes for name in order]
    return [(*pair, cases[pair[0].top][pair[2]]) for pair in pairs if pair[2] in cases.get(pair[0].top, ())]


SHOWN_TRIALS = 40
"""Largest number of trials that a terminal lists; of more, it lists those that did not hold."""


def stress(
    *schemes: str,
    case: Sequence[str] = (),
    top: str | None = None,
    watch: Watch = SILENT,
) -> Report:
    """Test schemes in hard cases and find what breaks.

    Hard cases are, for example, motions near singularities, extreme parameters and extreme step sizes. For a list of
    them, use topcli list cases. A scheme may declare cases that it must fail, its limits. The command exits with code 4
    if a scheme fails any other case, or passes one of its limits.

    Parameters
    ----------
    *schemes : str
        Names of schemes, with options if needed, as in bohlin-a:branch=sign; by default all.
    case : sequence of str, optional
        Try only these hard cases. ``topcli list cases`` shows them.
    top : str, optional
        Name of a top; only its schemes and cases are tried.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        The main table has a row for each trial (a scheme in a case): its outcome, the step of a failure, and a verdict
        that compares the outcome with the limits of the scheme.

    Raises
    ------
    UsageError
        If a scheme, an option, a case or a top is unknown.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.stress("hk", "backlund", case=["delone", "pole"])
    >>> report.answer
    '4 trials: 4 held; none contradicts what the schemes declare'
    >>> report.table["outcome"].tolist()
    ['held', 'held', 'held', 'held']
    """
    trials = _chosen(schemes, case, top)
    watch.begin("stress", unit="trials")
    rows: list[dict[str, Any]] = []
    for trial in trials:
        rows.append(row_of_trial(*trial))
        watch(len(rows), len(trials))
    return report_of(rows)


def report_of(rows: Sequence[Mapping[str, Any]]) -> Report:
    """Report on trials; it exits with 4 if one contradicts a declaration."""
    outcomes, verdicts = ([row[key] for row in rows] for key in ("outcome", "verdict"))
    wrong = [row for row in rows if row["verdict"] in (UNEXPLAINED, OUTLIVED)]
    counts = ", ".join(f"{outcomes.count(outcome)} {outcome}" for outcome in dict.fromkeys(outcomes))
    limits = f"; {verdicts.count(LIMIT)} at declared limits" if LIMIT in verdicts else ""
    contradict = f"{len(wrong)} contradict" if len(wrong) > 1 else f"{len(wrong) or 'none'} contradicts"
    answer = f"{counted(len(rows), 'trial')}: {counts}{limits}; {contradict} what the schemes declare"
    errors = [f"{row['scheme']} ({row['top']}): {row['why']}" for row in rows if row["verdict"] == CODE_FAILED]
    errors += [f"{row['scheme']} ({row['top']}), case {row['case']}: {row['verdict']}: {row['why']}" for row in wrong]
    code = ExitCode.VIOLATED if wrong else ExitCode.SUCCESS
    if failed := verdicts.count(CODE_FAILED):
        code = ExitCode.PARTLY_FAILED if failed < len(rows) else ExitCode.WRONG_USAGE
    formats = {"top": TOPS.called, "verdict": lambda verdict: "" if verdict == OK else verdict, "why": shortened}
    tables = [Table("Trials", rows, formats, len(rows) > SHOWN_TRIALS or ("step",))]
    if len(rows) > SHOWN_TRIALS:
        lost = [row for row in rows if row["outcome"] != HELD]
        tables.append(Table("Trials that did not hold", lost, formats, ("step",)))
    columns = {key: np.array([row[key] for row in rows]) for key in ("scheme", "top", "case", "outcome")}
    title = "schemes in the hard cases of their tops"
    errors = list(dict.fromkeys(errors))
    return Report("stress", title, answer, tables, (), errors, code, {}, columns, partial(_draw, columns))


def _draw(columns: Mapping[str, Any], axes: Any, looks: Callable[..., Any]) -> None:
    """Draw the outcomes, schemes down and cases across, of the schemes and cases of which not all held, if any."""
    names = np.array([f"{s}, {TOPS.called(t)}" for s, t in zip(columns["scheme"], columns["top"], strict=True)])
    lost = columns["outcome"] != HELD
    lost = lost if lost.any() else ~lost
    schemes, cases = (list(dict.fromkeys(values[lost].tolist())) for values in (names, columns["case"]))
    drawn = np.isin(names, schemes) & np.isin(columns["case"], cases)
    marks = {HELD: (".", "0.6"), NOT_TRIED: ("_", "0.6"), DEGRADED: ("o", "C1"), BROKE: ("X", "C3")}
    for outcome, (marker, colour) in marks.items():
        here = drawn & (columns["outcome"] == outcome)
        x, y = map(cases.index, columns["case"][here]), map(schemes.index, names[here])
        axes.plot(list(x), list(y), marker, color=colour, markersize=4, label=outcome)
    axes.set_xticks(range(len(cases)), cases, rotation=90)
    axes.set_yticks(range(len(schemes)), schemes)
    axes.set_ylim(len(schemes) - 0.5, -0.5)
    axes.figure.set_size_inches(5.0, 1.5 + 0.15 * len(schemes))
