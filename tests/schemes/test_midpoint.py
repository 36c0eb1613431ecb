"""The midpoint rule of fields that are not polynomials: its equation, tangent map and integrals."""

from __future__ import annotations

import random
from typing import Any

import mpmath
import numpy as np
import pytest

import topcli
from fields import random_state
from steppers import built, physical
from topcli.contracts import Outcome, Top
from topcli.field.expression import in_arithmetic
from topcli.tops import TOPS
from topcli.tops.declared import custom_class

PENDULUM = {"q": "v", "v": "-sin(q)"}
TERMS = ("sin({})", "cos({})", "tanh({})", "exp(-({})/3)", "sqrt(3 + ({})**2)", "({0})/(1 + ({0})**2)", "abs({})")
NUMBERS = mpmath.MPContext()
NUMBERS.dps = 50


def top_of(field: dict[str, str]) -> Top:
    declared = custom_class({"components": list(field), "field": field})
    TOPS.declared[declared.form] = declared
    return declared.new()


def random_formulas(d: int, seed: int) -> dict[str, str]:
    """Sums of functions of two components each; some components are constant, linear or alone."""
    draw, names = random.Random(seed), [f"x{i}" for i in range(d)]

    def term() -> str:
        a, b = draw.choice(names), draw.choice(names)
        return f"{draw.randint(1, 20) / 10}*" + draw.choice((*TERMS, "({})")).format(f"{a} - 0.5*{b}")

    return {name: " - ".join(term() for _ in range(draw.randint(0, 3))) or "0" for name in names}


def residual(top: Top, y: Any, new: Any, h: float) -> float:
    """Largest residual of y' = y + h f((y + y')/2), in 50 digits, in units of round-off of state and change."""
    field, number = in_arithmetic(top.field, NUMBERS.mpf, NUMBERS), NUMBERS.mpf
    a, b = [number(float(x)) for x in y], [number(float(x)) for x in new]
    rates = field(tuple((x + z) / 2 for x, z in zip(a, b, strict=True)), ())
    off = max(abs(z - x - h * rate) for x, z, rate in zip(a, b, rates, strict=True))
    return float(off / (max(map(abs, (*a, *b))) + abs(h)) * 2**52)


@pytest.mark.slow
@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize("d", [1, 2, 3, 5])
def test_the_step_solves_its_equation_and_returns(d: int, compensated: bool) -> None:
    """At worst 1.0 unit of round-off in 400 fields, and 4.0 after a step back."""
    for seed in range(20):
        top, y = top_of(random_formulas(d, seed)), random_state(d, seed)
        made = built("midpoint", top, compensated=compensated)
        step, p = physical(made), tuple(map(float, made.constants))
        for h in (0.01, 0.2):
            new = step(y, h, p)
            assert residual(top, y, new, h) < 10.0
            assert np.abs(np.subtract(step(new, -h, p), y)).max() < 20.0 * 2.0**-52


def config(field: dict[str, str], y: Any, h: float = 0.1, **changes: Any) -> dict[str, Any]:
    top = {"kind": "custom", "components": list(field), "field": field}
    initial = dict(zip(field, map(float, y), strict=True))
    return {"top": top, "initial": initial, "scheme": "midpoint", "h": h, "N": 1, **changes}


LOTKA_VOLTERRA = {"x": "1 - exp(y)", "y": "exp(x) - 1"}
JACOBIANS: dict[str, Any] = {
    "pendulum": (PENDULUM, lambda y: [[0.0, 1.0], [-np.cos(y[0]), 0.0]]),
    "Lotka-Volterra": (LOTKA_VOLTERRA, lambda y: [[0.0, -np.exp(y[1])], [np.exp(y[0]), 0.0]]),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "y"),
    [
        ("pendulum", (1.0, 0.5)),
        ("pendulum", (1000.0, 3.0)),
        ("pendulum", (0.0, 0.0)),
        ("Lotka-Volterra", (0.0, 0.0)),
        ("Lotka-Volterra", (0.4, -0.9)),
    ],
)
def test_the_compiled_step_and_its_tangent_map_are_exact(name: str, y: tuple[float, float]) -> None:
    """The image solves (1 - h f'/2) w = (1 + h f'/2) v at the mean, also at rest and after many revolutions."""
    h, v = 0.1, (0.3, -0.7)
    field, jacobian = JACOBIANS[name]
    step = topcli.step(config(field, y, h))
    new, image = step.tangent(np.array(y), np.array(v))
    assert np.array_equal(new, step(np.array(y)))
    assert residual(top_of(field), y, new, h) < 10.0
    slope = np.array(jacobian(0.5 * (new + y))) * (0.5 * h)
    assert image == pytest.approx(np.linalg.solve(np.eye(2) - slope, (np.eye(2) + slope) @ v), abs=1e-12)


@pytest.mark.parametrize("h", [0.5, 1.0])
def test_a_step_without_a_solution_does_not_converge(h: float) -> None:
    """x' = exp(x) from 0: u = (h/2) exp(u) has no solution for h > 2/e = 0.736."""
    run = topcli.simulate(config({"x": "exp(x)"}, (0.0,), h))
    assert run.outcome == (Outcome.COMPLETED if h < 0.7 else Outcome.NO_CONVERGENCE)
