"""Checks of declared properties; each check is also applied to a control that is known to fail it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.conformance import (
    completed,
    deviation,
    differing_lanes,
    is_vector_of,
    moving,
    rate_along,
    reversal_defect,
    states_near,
    working_states,
)
from topcli.config.files import is_config
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Invariant, Method, Sampler, Scheme, Stepper, Top
from topcli.errors import SchemeCodeError, UsageError, quoted
from topcli.field import integrals as field_integrals
from topcli.field.polynomial import NotPolynomialError, field_of
from topcli.runs.report import finite
from topcli.schemes.own_tops import forms, top_origin
from topcli.schemes.plugins import load_plugin_file, users_error
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.bench.contest import Problem
from topcli.studies.entries import scheme_with
from topcli.studies.order import FALSE
from topcli.studies.order_ladders import INTERVALS, Ladders, order_study
from topcli.studies.stress.trials import generic_case
from topcli.studies.study import LADDER_STEPS
from topcli.tops import TOPS

HOLDS, FALSE_DECLARATION, UNDECIDED, NOT_CLAIMED, NOT_TRIED = "holds", "false", "undecided", "not claimed", "not tried"
DURATION = 4.0
"""Length of the runs that show the order."""
SIZES = (0.2, 0.1, 0.05)
"""Step sizes of one step there and back."""
REVERSED = 1e-13
"""Largest component missed by one step there and back, relative to the state; schemes of topcli miss 1e-14."""
STEPS, FEW = 5000, 400
"""Steps of the runs that show invariants; in the interpreter fewer."""
LONG = 0.05
"""Step size of these runs."""
DRIFT = 1e-9
"""Relative drift of the states that the control of exact invariants must see."""
RATE = 1e-7
"""Rate of change of an integral on random states that differences may leave, relative to its gradient and the field."""
CONTROL = "rk2"
"""Scheme that is not self-adjoint and of order 2; the control of the order declares 3."""


@dataclass(frozen=True)
class Found:
    """Measured values of a check and of its control, or the reason why there are none."""

    measured: float | None
    allowed: float | None
    control: float | None = None
    why: str = ""
    holds: bool | None = None
    caught: bool | None = None

    def verdict(self, claimed: bool) -> str:
        """Verdict on a declaration that is ``claimed``."""
        if self.measured is None:
            return NOT_TRIED
        if not claimed:
            return NOT_CLAIMED
        holds, caught = self.holds, self.caught
        if self.allowed is not None:
            holds = bool(self.measured <= self.allowed) if holds is None else holds
            caught = bool(self.control is not None and not self.control <= self.allowed) if caught is None else caught
        if holds is None or caught is False:
            return UNDECIDED
        return HOLDS if holds else FALSE_DECLARATION


@dataclass(frozen=True)
class Subject:
    """A scheme on the motion of an experiment."""

    scheme: Scheme
    experiment: Experiment

    @property
    def top(self) -> Top:
        """Top of the experiment."""
        return self.experiment.top

    @property
    def options(self) -> Any:
        """Options of the experiment if it has the scheme, or the defaults."""
        same = self.experiment.scheme.name == self.scheme.name
        return self.experiment.options if same else self.scheme.options()

    def method(self) -> Method:
        """The scheme made ready."""
        return self.scheme.build(self.top, self.options)

    def rk2(self) -> Stepper:
        """The method of the controls."""
        method = find_scheme(CONTROL, self.top.form).build(self.top, find_scheme(CONTROL, self.top.form).options())
        assert isinstance(method, Stepper)
        return method


def order(subject: Subject) -> Found:
    """Observed order, and that of a method of order 2 which declares 3."""
    scheme, experiment = subject.scheme, subject.experiment
    if scheme.adaptive or scheme.order is None:
        return Found(None, None, why="has no order in h")
    false = replace(find_scheme(CONTROL, subject.top.form), name="control", order=3)
    problem = Problem("check", subject.top.title, experiment, DURATION, INTERVALS)
    rows = order_study(Ladders(problem, (scheme, false), (), (), LADDER_STEPS // 20))["schemes"]
    row, control = rows
    if row["broken"]:
        raise SchemeCodeError(row["broken"])
    if row["order"] is None:
        return Found(None, None, why=row["why"] or row["ended"])
    declared, found = subject.scheme.order_for(subject.options), row["verdict"] in FALSE
    holds = False if found else (True if row["verdict"] == "as declared" else None)
    above = row["order"] - declared if holds else 0.0
    why = row["why"] or (f"the observed order {row['order']:.2f} is above the declared order" if above > 0.1 else "")
    return Found(row["order"], None, control["order"], why, holds, control["verdict"] in FALSE)


def self_adjoint(subject: Subject) -> Found:
    """Largest component missed by one step there and one back."""
    method, states = subject.method(), states_near(subject.experiment.y0, 4 if is_slow(subject) else 12)
    allowed = REVERSED * max(1.0, float(np.abs(states).max()))
    defects = [reversal_defect(subject.top, method, h, states) for h in SIZES]
    control = max(reversal_defect(subject.top, subject.rk2(), h, states) for h in SIZES)
    tried = [defect for defect in defects if math.isfinite(defect)]
    if not tried:
        return Found(None, None, why="its steps fail")
    return Found(max(tried), allowed, control)


def is_slow(subject: Subject) -> bool:
    """True if the method runs in the interpreter."""
    method = subject.method()
    return isinstance(method, Stepper) and method.plain


def _kept(subject: Subject, invariants: Sequence[Invariant]) -> Found:
    """Deviation of invariants along a run, and along the same states with a small drift."""
    if not invariants:
        return Found(None, None, why="")
    N = FEW if is_slow(subject) else STEPS
    states = completed(subject.top, subject.method(), subject.experiment.y0, LONG, N)
    if states is None:
        return Found(None, None, why=f"its run of {N} steps of {LONG:g} does not complete")
    rates = DRIFT * np.cos(1.0 + np.arange(states.shape[1]))  # unequal, else a hyperplane through 0 would be kept
    drifting = states * (1.0 + np.linspace(0.0, 1.0, len(states))[:, None] * rates)
    return Found(deviation(states, invariants, N), 1.0, deviation(drifting, invariants, N))


def exact_invariants(subject: Subject) -> Found:
    """Deviation of the invariants that the scheme conserves."""
    return _kept(subject, [one for one in subject.top.invariants() if one.name in subject.scheme.conserves])


def modified_invariants(subject: Subject) -> Found:
    """Deviation of the integrals of the scheme itself."""
    scheme = subject.scheme
    return _kept(subject, scheme.modified(subject.top, LONG, subject.options) if scheme.modified else ())


def machine_code(subject: Subject) -> Found:
    """Slots in which machine code differs from plain Python, and from the plain steps of another method."""
    method = subject.method()
    if not isinstance(method, Stepper) or method.plain:
        return Found(None, None, why="is not compiled from Python")
    y0 = subject.experiment.y0
    plain, compiled, _ = working_states(subject.top, method, y0, 0.02, 100)
    other, _, _ = working_states(subject.top, subject.rk2(), y0, 0.0201, 100)
    d = len(y0)
    return Found(_differing(plain, compiled), 0.0, _differing(other[:d], compiled[:d]))


def _differing(one: Sequence[float], other: Sequence[float]) -> float:
    """Number of places with different bits."""
    return float(sum(a.hex() != b.hex() for a, b in zip(one, other, strict=True)))


def lanes(subject: Subject) -> Found:
    """Trajectories of an ensemble that differ from single runs, and from runs that start one ulp aside."""
    method, count, N = subject.method(), 3 if is_slow(subject) else 9, 20 if is_slow(subject) else 100
    states = states_near(subject.experiment.y0, count)
    aside = np.nextafter(states, np.inf)
    differing = differing_lanes(subject.top, method, states, states, 0.02, N)
    return Found(float(differing), 0.0, float(differing_lanes(subject.top, method, aside, states, 0.02, N)))


def counters(subject: Subject) -> Found:
    """Counters that are not finite and not below zero after a run; the control counts nan."""
    method = subject.method()
    if isinstance(method, Sampler) or not method.counters:
        return Found(None, None, why="")
    if not isinstance(method, Stepper) or method.plain:
        return Found(None, None, why="is not compiled from Python")
    last = working_states(subject.top, method, subject.experiment.y0, 0.02, 100)[1][-len(method.counters) :]

    def wrong(values: Sequence[float]) -> float:
        return float(sum(not (math.isfinite(value) and value >= 0.0) for value in values))

    return Found(wrong(last), 0.0, wrong([*last[1:], math.nan]))


SCHEME_CHECKS: Mapping[str, tuple[Callable[[Subject], Found], Callable[[Scheme], str]]] = {
    "order": (order, lambda scheme: str(scheme.order) if scheme.order else ""),
    "self-adjoint": (self_adjoint, lambda scheme: "yes" if scheme.self_adjoint else ""),
    "exact invariants": (exact_invariants, lambda scheme: ", ".join(scheme.conserves)),
    "modified invariants": (modified_invariants, lambda scheme: "yes" if scheme.modified else ""),
    "machine code is the step": (machine_code, lambda scheme: "yes"),
    "batch equals single": (lanes, lambda scheme: "yes"),
    "counters are finite": (counters, lambda scheme: "yes"),
}
"""Check of each trait, and what a scheme declares of it; empty if nothing."""


def field_returns(top: Top, states: Array) -> Found:
    """States at which the field does not return a finite number for each component; the control lacks the last."""
    p, rates = top.constants(), []
    for y in states:
        rates.append(top.field(tuple(y.tolist()), p))
    wrong = [sum(not is_vector_of(rate, top) for rate in each) for each in (rates, [rate[:-1] for rate in rates])]
    return Found(float(wrong[0]), 0.0, float(wrong[1]))


def _with_square(invariant: Invariant, k: int) -> Callable[[Array], Array]:
    """The invariant plus the square of a component that moves: no integral."""
    return lambda y: invariant.value(y) + y[:, k] ** 2


def exact_rate(top: Top, invariant: Invariant, k: int) -> Found:
    """Terms of the exact rate of change of an integral along the field."""
    try:
        field, invariants = field_of(top), top.invariants()
        terms = [
            len(field_integrals.exact_rate(field, invariants, one))
            for one in (invariant, replace(invariant, value=_with_square(invariant, k)))
        ]
    except NotPolynomialError as error:
        return Found(None, None, why=f"no polynomial: {error}")
    return Found(float(terms[0]), 0.0, float(terms[1]))


def random_rate(top: Top, invariant: Invariant, states: Array, k: int) -> Found:
    """Rate of change of an integral on random states, by differences."""
    if invariant.on:
        return Found(
            None, None, why=f"holds only on {', '.join(f'{name} = {x:g}' for name, x in invariant.on.items())}"
        )
    return Found(rate_along(top, invariant.value, states), RATE, rate_along(top, _with_square(invariant, k), states))


def _row(subject: str, check: str, declared: str, measured: Callable[[], Found]) -> dict[str, Any]:
    """Row of a check; what a user's code raises is its reason."""
    broken = None
    try:
        with np.errstate(all="ignore"):
            found = measured()
    except Exception as error:
        known = error if isinstance(error, UsageError) else users_error(error)
        if known is None:
            raise
        broken = str(known) if isinstance(known, SchemeCodeError) else None
        found = Found(None, None, why=str(known))
    verdict = found.verdict(bool(declared))
    return {
        "subject": subject,
        "check": check,
        "declared": declared or None,
        "measured": found.measured,
        "allowed": found.allowed,
        "control": found.control,
        "verdict": verdict,
        "why": found.why,
        "broken": broken,
    }


def scheme_rows(subject: Subject) -> Iterator[dict[str, Any]]:
    """A row for each check of a scheme."""
    scheme = subject.scheme
    name = TOPS.called(scheme.top)
    for check, (measure, declared) in SCHEME_CHECKS.items():
        yield _row(f"{scheme.name} ({name})", check, declared(scheme), lambda measure=measure: measure(subject))


def top_rows(experiment: Experiment) -> Iterator[dict[str, Any]]:
    """A row for the field of a top and two for each integral."""
    top, states = experiment.top, states_near(experiment.y0, 20)
    components = ", ".join(top.components)
    name = TOPS.called(top.form)
    yield _row(name, "field", components, lambda: field_returns(top, states))
    k = moving(top, tuple(states[1].tolist()))
    for one in top.invariants():
        yield _row(name, f"{one.name}: exact rate", "0", lambda one=one: exact_rate(top, one, k))
        yield _row(name, f"{one.name}: random states", "0", lambda one=one: random_rate(top, one, states[1:], k))


@dataclass(frozen=True)
class Plan:
    """Experiments whose tops are checked, and schemes with the experiments that they are checked on."""

    tops: tuple[Experiment, ...]
    subjects: tuple[Subject, ...]


def plan(
    file: str | Path | None, schemes: Sequence[str], top: str | None, config: str | Path | Mapping[str, Any] | None
) -> Plan:
    """Choose what is checked: what a ``file`` registers, a ``top``, and ``schemes`` of this top or of all that fit.

    Raises UsageError if that is nothing, and for unknown names.
    """
    origin = None if file is None else str(Path(file))
    if file is not None:
        if Path(file).suffix != ".py" and is_config(str(file)):
            hint = f"to check its top: topcli check --config {file}"
            raise UsageError(f"{quoted(str(file))} is a config, not a Python file; {hint}")
        load_plugin_file(Path(file))
    own = [each for each in all_schemes() if each.origin == origin]
    brought = [form for form in TOPS if top_origin(TOPS[form]) == origin]
    given = None if config is None else load_experiment(config)
    wanted = [form.form for form in forms(top)] if top else ([given.top.form] if given else brought)
    chosen = [each for each in own if not (top or given) or each.top in wanted]
    if schemes:
        chosen = [one for name in schemes for one in _named(name, wanted)]
    checked = wanted if top or file is not None or given else []
    if not (chosen or checked):
        what = f"plugin {file}: registers no top and no scheme" if file else "nothing to check"
        raise UsageError(f"{what}; give a file, --scheme or --top")

    def scene(form: str, name: str) -> Experiment:
        return given if given and given.top.form == form else generic_case(form).experiment(name)

    return Plan(
        tuple(scene(form, CONTROL) for form in checked),
        tuple(Subject(each, scene(each.top, each.name)) for each in chosen),
    )


def _named(name: str, wanted: Sequence[str]) -> list[Scheme]:
    """Schemes called ``name`` for the forms ``wanted``, or for all that fit. Raises UnknownNameError."""
    known = [each.top for each in all_schemes() if each.name == name.lower().partition(":")[0].partition("+")[0]]
    return [scheme_with(name, form) for form in wanted or known or ["kowalevski"]]


def check_study(chosen: Plan, on_progress: Callable[[int, int], None]) -> dict[str, Any]:
    """Check all and return plain data."""
    rows: list[dict[str, Any]] = []
    total = len(chosen.tops) + len(chosen.subjects)
    for i, experiment in enumerate(chosen.tops):
        rows += top_rows(experiment)
        on_progress(i + 1, total)
    for i, subject in enumerate(chosen.subjects):
        rows += scheme_rows(subject)
        on_progress(len(chosen.tops) + i + 1, total)
    first = chosen.subjects[0].experiment if chosen.subjects else chosen.tops[0]
    return finite(
        {
            "config": first.resolved(),
            "tops": [experiment.top.form for experiment in chosen.tops],
            "schemes": [[subject.top.form, subject.scheme.name] for subject in chosen.subjects],
            "rows": rows,
        }
    )
