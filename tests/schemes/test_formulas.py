"""The typeset formula of each scheme, evaluated here in other words: in doubles and, where it can be, in fractions.

A formula is a residual that the states before and after a step leave. States are padded to six components.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from conformance import ExactStep, Subject, plain_step, subjects
from conftest import random_states
from declared import BODIES, SCHEMES, TRIALS, Heavy
from split_motions import axes, closed, kicked, moser_veselov, poisson_defect
from stepping import gradients, states_of
from topcli.contracts import Top
from topcli.engine.drive import orbit
from topcli.engine.machine import Machine
from topcli.engine.numbers import RATIONAL, Rational, prepared
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

State = np.ndarray
Residual = Callable[[Subject, State, State, Any], float]


def padded(y: Any) -> State:
    return np.append(np.asarray(y), [0] * (6 - len(y)))


def rate(top: Top, y: State) -> State:
    return padded(np.array(type(top).field(tuple(y[: len(top.components)]), top.constants())))


def body(top: Top) -> tuple[State, State]:
    """Moments of inertia and weight times centre of gravity."""
    equations = top.euler_poisson()
    return np.array(equations.moments), np.array(equations.gravity)


def largest(*residuals: Any) -> float:
    return float(max(abs(one) for residual in residuals for one in np.ravel(residual)))


def rotation_of_xi(top: Top, y: State, z: State, h: float) -> complex:
    """xi' - exp(-i h mean omega3) xi with xi = (omega1 + i omega2)² - c (gamma1 + i gamma2)."""
    (c,) = top.constants()
    xi = complex(y[0], y[1]) ** 2 - c * complex(y[3], y[4])
    return complex(z[0], z[1]) ** 2 - np.exp(-0.5j * h * (y[2] + z[2])) * xi - c * complex(z[3], z[4])


def bohlin(subject: Subject, y: State, z: State, h: float) -> float:
    (c,) = subject.top.constants()
    return largest(z[2] - y[2] + 0.5 * h * c * (y[4] + z[4]), rotation_of_xi(subject.top, y, z, h))


def turned(y: State, z: State, omega: State, h: float) -> State:
    """Residual of gamma' - gamma = h mean gamma x omega."""
    return z[3:] - y[3:] - 0.5 * h * np.cross(y[3:] + z[3:], omega)


def hirota_kimura(subject: Subject, y: State, z: State, h: float) -> float:
    J, r = body(subject.top)
    w, g, v, n = y[:3], y[3:], z[:3], z[3:]
    spun = J * (v - w) / h - 0.5 * (np.cross(J * w, v) + np.cross(J * v, w)) - 0.5 * np.cross(g + n, r)
    return largest(spun, (n - g) / h - 0.5 * (np.cross(g, v) + np.cross(n, w)))


def kahan(subject: Subject, y: State, z: State, h: float) -> float:
    top = subject.top
    return largest((z - y) / h - 2 * rate(top, (y + z) / 2) + rate(top, y) / 2 + rate(top, z) / 2)


def rotated_m(part: float) -> Residual:
    """m' - m = h mean m x omega, and gamma likewise, for omega at this part of the step."""

    def residual(subject: Subject, y: State, z: State, h: float) -> float:
        J, _ = body(subject.top)
        omega = y[:3] + part * (z[:3] - y[:3])
        return largest(J * (z[:3] - y[:3]) - 0.5 * h * np.cross(J * (y[:3] + z[:3]), omega), turned(y, z, omega, h))

    return residual


def midpoint(subject: Subject, y: State, z: State, h: float) -> float:
    return largest(z - y - h * rate(subject.top, 0.5 * (y + z)))


def rk2(subject: Subject, y: State, z: State, h: float) -> float:
    return largest(z - y - h * rate(subject.top, y + 0.5 * h * rate(subject.top, y)))


def rk4(subject: Subject, y: State, z: State, h: float) -> float:
    k1 = rate(subject.top, y)
    k2 = rate(subject.top, y + 0.5 * h * k1)
    k3 = rate(subject.top, y + 0.5 * h * k2)
    k4 = rate(subject.top, y + h * k3)
    return largest(6 * (z - y) - h * (k1 + 2 * k2 + 2 * k3 + k4))


def splitting(subject: Subject, y: State, z: State, h: float) -> float:
    top = subject.top
    A, B, _ = top.euler_poisson().moments
    free = closed if A == B else axes
    return largest(padded(kicked(top, y[: len(top.components)], h, free)) - z)


def dmv(subject: Subject, y: State, z: State, h: float) -> float:
    return largest(padded(kicked(subject.top, y[: len(subject.top.components)], h, moser_veselov)) - z)


def hat(v: State) -> State:
    """Matrix of w -> v x w."""
    return np.cross(v, np.eye(3)).T


def bohlin_b(subject: Subject, y: State, z: State, h: float) -> float:
    def chart(s: State) -> complex:
        return complex(s[3], s[4]) / (1.0 + s[5])

    w, old = complex(y[0], y[1]), chart(y)
    moved = chart(z) - old - 0.5j * h * (w - 2.0 * y[2] * old - w.conjugate() * old**2)
    return largest(moved, bohlin(subject, y, z, h))


def bohlin_c(subject: Subject, y: State, z: State, h: float) -> float:
    return largest(z[3:] - expm(-h * hat(y[:3])) @ y[3:], bohlin(subject, y, z, h))


def hk(top: Top, y: State, h: float) -> State:
    """State after a step of HK, whose own formula is tried here too."""
    scheme = find_scheme("hk", top.form)
    return plain_step(Subject(scheme, top, scheme.options()), y, h)


def hybrid(subject: Subject, y: State, z: State, h: float) -> float:
    predicted = hk(subject.top, y, h)
    turn = turned(y, z, 0.5 * (y[:3] + predicted[:3]), h)
    return largest(turn, z[2] - predicted[2], rotation_of_xi(subject.top, y, z, h))


def bs_lagrange(subject: Subject, y: State, z: State, h: float) -> float:
    up = np.array([0, 0, 1])
    return largest(z[:3] - y[:3] - h * np.cross(up, y[3:]), z[3:] - y[3:] - 0.5 * h * np.cross(z[:3], y[3:] + z[3:]))


FORMULAS: dict[str, Residual] = {
    "hk": hirota_kimura,
    "hk lagrange/inertial": kahan,
    "midpoint": midpoint,
    "bs": rotated_m(0.0),
    "bs lagrange/inertial": bs_lagrange,
    "bs-implicit": rotated_m(1.0),
    "rk2": rk2,
    "rk4": rk4,
    "splitting": splitting,
    "dmv": dmv,
    "bohlin-a": lambda subject, y, z, h: largest(turned(y, z, y[:3], h), bohlin(subject, y, z, h)),
    "bohlin-b": bohlin_b,
    "bohlin-c": bohlin_c,
    "hybrid": hybrid,
    "hybrid-sym": lambda subject, y, z, h: largest(turned(y, z, 0.5 * (y[:3] + z[:3]), h), bohlin(subject, y, z, h)),
}
ELSEWHERE = {"backlund", "exact", "hk-exact", "taylor", "dop853"}
"""Schemes compared with the motion or with an iterated map by tests of their own."""
SUBJECTS = [
    subject
    for scheme in SCHEMES
    if scheme.name not in ELSEWHERE
    for subject in subjects(scheme, TRIALS[scheme.top][:2])
]


def formula_of(subject: Subject) -> Residual:
    return FORMULAS.get(f"{subject.scheme.name} {subject.scheme.top}") or FORMULAS[subject.scheme.name]


@pytest.mark.slow
@pytest.mark.parametrize("subject", SUBJECTS, ids=str)
def test_a_step_satisfies_its_formula(subject: Subject) -> None:
    """Residuals are typically 1e-16 to 2e-15, those of solvers 1e-14; a state off by 1e-6 does not satisfy it."""
    residual, d = formula_of(subject), len(subject.top.components)
    steps = (0.1, -0.03, 2.5) if subject.scheme.name == "splitting" else (0.1, -0.03)
    for y in map(padded, random_states(3, seed=3)[:, :d]):
        y[5] = abs(y[5])  # the paper's chart
        for h in steps:
            z = plain_step(subject, y, h)
            assert residual(subject, y, z, h) < (2e-13 if h < 1.0 else 1e-12)
            assert residual(subject, y, z + padded([1e-6] * d), h) > 1e-8


RATIONAL_FORMULAS = [one for one in SUBJECTS if one.scheme.name in ("hk", "bs", "rk2", "rk4") and "{" not in str(one)]


@pytest.mark.parametrize("subject", RATIONAL_FORMULAS, ids=str)
@pytest.mark.parametrize("h", [Fraction(1, 20), Fraction(-2, 7)])
def test_a_rational_step_satisfies_its_formula_exactly(subject: Subject, h: Fraction) -> None:
    """No rounding: hk is Kahan's method, with equality; read with omega and gamma of another step it is not."""
    top, d = subject.top, len(subject.top.components)
    parameters = {name: Fraction(str(value)) for name, value in top.model_dump().items() if isinstance(value, float)}
    y0 = tuple(map(Fraction, ("3/2", "2/5", "-7/10", "2/7", "3/7", "6/7")))[:d]
    made = prepared(subject.scheme, top, subject.options, RATIONAL, (h, parameters, y0), 10_000)
    machine = Machine(made.top, subject.method, made.loop)
    old, new, newer = map(padded, orbit(made.top, machine, made.y0, made.h, 2).states)
    exact = Subject(subject.scheme, made.top, subject.options)
    assert formula_of(subject)(exact, old, new, made.h) == 0
    assert formula_of(subject)(exact, old, newer, made.h) > 1e-3


ROUNDED = [one for one in RATIONAL_FORMULAS if one.scheme.name == "hk"]


@pytest.mark.slow
@pytest.mark.parametrize("subject", ROUNDED, ids=str)
def test_hk_round_off_is_unbiased_in_every_integral(subject: Subject) -> None:
    """Means of the errors over their standard deviations; steps rounded towards zero, the control, are far off."""
    exactly, top = ExactStep(subject), subject.top
    errors: dict[bool, list[list[float]]] = {True: [], False: []}
    for y in random_states(200, seed=8)[:, : len(top.components)]:
        exact, got = exactly(y.tolist(), 0.01), plain_step(subject, padded(y), 0.01)[: len(y)]
        for biased, found in errors.items():
            rounded = (np.nextafter(got, 0.0) if biased else got).tolist()
            states = np.array([[Rational(Fraction(x)) for x in state] for state in (rounded, exact)], dtype=object)
            values = [one.value(states) for one in exactly.top.invariants()]
            found.append([float(a - b) for a, b in values])
    mean, spread = ({kind: f(found, axis=0) for kind, found in errors.items()} for f in (np.mean, np.std))
    limit = {kind: spread[kind] / np.sqrt(len(errors[kind])) for kind in errors}
    assert (abs(mean[False]) <= 4.0 * limit[False]).all()
    assert (abs(mean[True]) > 10.0 * limit[True]).any()


CANONICAL = [
    Subject(one, top, one.options())
    for one in SCHEMES
    for top in (*TRIALS[one.top][:2], *(body for body in (Heavy(A=1.3, B=1.3, C=2.0),) if body.form == one.top))
    if one.name in ("splitting", "dmv", "backlund") or (one.name, one.top) == ("bs", "lagrange/inertial")
]


def in_python(subject: Subject) -> Callable[[State, float], State]:
    return lambda y, h: plain_step(subject, padded(y), h)[: len(y)]


@pytest.mark.slow
@pytest.mark.parametrize("subject", CANONICAL, ids=str)
def test_canonical_steps_preserve_the_bracket(subject: Subject) -> None:
    """J P J^T = P at the image: typically 1e-10, the error of the difference quotients."""
    states = states_of(subject.top, 4, seed=24)
    assert max(poisson_defect(subject.top, in_python(subject), y, 0.2) for y in states) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(("name", "defect"), [("hk", 3.3e-3), ("midpoint", 2.0e-3), ("rk4", 3.3e-5)])
def test_canonical_control(name: str, defect: float) -> None:
    scheme = find_scheme(name, "heavy")
    step = in_python(Subject(scheme, Heavy(), scheme.options()))
    found = np.median([poisson_defect(Heavy(), step, y, 0.2) for y in states_of(Heavy(), 100, seed=24)])
    assert found == pytest.approx(defect, rel=0.05)


def test_every_scheme_and_top_has_a_formula() -> None:
    for one in (*SCHEMES, *TOPS.values()):
        assert one.formula.strip(), one
        assert one.formula.count("{") == one.formula.count("}")
        for part in re.split(r"\n\s*\n", one.formula.strip()):
            assert part.count(r"\bigl") + part.count(r"\Bigl") == part.count(r"\bigr") + part.count(r"\Bigr")
            assert r"\begin" not in part or r"\end" in part


@pytest.mark.parametrize("top", [top for form in BODIES for top in TRIALS[form]], ids=repr)
def test_equations_and_invariants_of_a_top(top: Top) -> None:
    """The field is that of Euler and Poisson, written with vectors, and leaves all invariants constant."""
    J, r = body(top)
    for y in map(padded, random_states(10, seed=5)[:, : len(top.components)]):
        expected = padded([*(np.cross(J * y[:3], y[:3]) + np.cross(y[3:], r)) / J, *np.cross(y[3:], y[:3])])
        if top.form == "lagrange/inertial":
            expected = np.append(np.cross([0.0, 0.0, 1.0], y[3:]), np.cross(y[:3], y[3:]))
        np.testing.assert_allclose(rate(top, y), expected, rtol=1e-14, atol=1e-14)
        D = gradients(top, y)
        assert np.abs(D.T @ expected).max() < 1e-13 * (1.0 + np.abs(D).max()) * (1.0 + np.abs(expected).max())
