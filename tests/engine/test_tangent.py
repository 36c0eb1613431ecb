"""Tangent maps: those that the compiler derives from a step, those that are generated, and the growth of vectors."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from itertools import product
from typing import Any

import mpmath
import numpy as np
import pytest

from steppers import built
from topcli.arithmetic.fused import fma
from topcli.contracts import Method, Stepper, Top
from topcli.engine.drive import drive as driven
from topcli.engine.drive import orbit
from topcli.engine.duals import RULES, dual, primal_of, slope_of
from topcli.engine.loops import interpreted, part_steps_of
from topcli.engine.machine import Machine
from topcli.engine.native import native
from topcli.engine.rows import Plan
from topcli.engine.tangent import TangentRun, tangent_code
from topcli.errors import SchemeCodeError, UsageError
from topcli.field.expression import FUNCTIONS
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

H = 0.1


class Pair(Top):
    """Two numbers."""

    kind = "pair"
    components = ("x", "y")
    field = staticmethod(lambda y, p: y)


def states_of(form: str, count: int = 3, seed: int = 5) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, len(TOPS[form].components)))


def code_of(name: str, form: str, lanes: int = 1, **options: object) -> Any:
    scheme, top = find_scheme(name, form), TOPS[form].new()
    return tangent_code(scheme, top, built(name, top, **options), lanes)


def image(code: Any, y: np.ndarray, v: np.ndarray, h: float, steps: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """States and vectors (m, d) after some steps."""
    run = TangentRun(code, h, y, v)
    run.advance(steps)
    return run.states, run.images


def growth(run: TangentRun) -> np.ndarray:
    return run.scales * math.log(2.0) + np.log(np.linalg.norm(run.vectors, axis=1))


def moved(method: Method, p: np.ndarray, y: np.ndarray, h: float, steps: int) -> np.ndarray:
    loop = interpreted(method, len(y), len(p))
    work, end = np.zeros(loop.width), np.empty_like(y)
    loop.enter(y, work, p, h)
    assert loop.take_steps(work, end, p, h, steps, steps, steps) == steps
    return end


CASES = [
    ("hk", "kowalevski", {}),
    ("hk", "kowalevski", {"compensated": True}),
    ("hk", "euler", {}),
    ("hk+yoshida4", "clebsch", {}),
    ("midpoint", "clebsch", {}),
    ("rk4", "clebsch", {}),
    ("hybrid", "kowalevski", {}),
    ("bs", "lagrange/inertial", {}),
    ("bs-implicit", "euler+gamma", {}),
    ("backlund", "kowalevski", {}),
    ("bohlin-a", "kowalevski", {}),
    ("dmv", "heavy", {}),
    ("splitting+yoshida4", "lagrange", {}),
    ("hk", "kowalevski", {"project": 1}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "form", "options"), CASES)
def test_images_are_those_of_central_differences(name: str, form: str, options: dict[str, object]) -> None:
    """Over five steps; the states are those of the run, bit for bit where the tangent map is that of its own step."""
    top = TOPS[form].new()
    method, p, nudge = built(name, top, **options), np.array(top.constants()), 1e-5
    assert isinstance(method, Stepper)
    y, v = 0.5 * states_of(form), states_of(form, seed=6)
    states, vectors = image(code_of(name, form, 8, **options), y, v, H, 5)
    for i in range(len(y)):
        reached = moved(method, p, y[i], H, 5)
        up, down = (moved(method, p, y[i] + s * nudge * v[i], H, 5) for s in (1, -1))
        assert np.abs((up - down) / (2 * nudge) - vectors[i]).max() < 1e-7 * np.abs(vectors[i]).max()
        own = method.tangent is None or name in ("midpoint", "hk+yoshida4")
        assert np.array_equal(states[i], reached) if own else np.abs(states[i] - reached).max() < 1e-14


def test_the_tangent_map_of_a_taylor_series_is_that_of_the_flow() -> None:
    """Against differences of the motion, and against the generated step of a small h, of order two."""
    form, v = "clebsch", states_of("clebsch", seed=6)
    y, top = 0.5 * states_of(form), TOPS[form].new()
    code, method, p, nudge = code_of("taylor", form), built("taylor", top), np.array(top.constants()), 1e-5
    states, vectors = image(code, y, v, H, 5)
    for i in range(len(y)):
        reached, up, down = (moved(method, p, y[i] + s * nudge * v[i], H, 5) for s in (0, 1, -1))
        assert np.abs((up - down) / (2 * nudge) - vectors[i]).max() < 1e-8 * np.abs(vectors[i]).max()
        assert np.abs(states[i] - reached).max() < 1e-14
    _, near = image(code_of("midpoint", form, 8), y, v, H / 100, 500)
    assert 1e-9 < np.abs(near - vectors).max() < 1e-5


def stretching(factor: Callable[[float], float]) -> Stepper:
    """Map of (number of the step, y) near the fixed point y = 1/4 that stretches vectors along y."""
    return Stepper(lambda s, h, p: (s[0] + 1.0, 0.25 + (s[1] - 0.25) * factor(s[0])), 2)


STRETCHES: list[tuple[Callable[[float], float], int, float]] = [
    (lambda n: 2.0, 5000, 5000 * math.log(2.0)),
    (lambda n: 1e200, 5000, 5000 * math.log(1e200)),
    (lambda n: 1e-200, 5000, -5000 * math.log(1e200)),
    (lambda n: 0.0, 5000, -math.inf),
    (lambda n: 1.0 if n < 400000.0 else 0.5 if n < 402000.0 else 2.0 if n < 404000.0 else 1.0, 410000, 0.0),
    (lambda n: 1.0 if n < 400000.0 else 2.0 if n < 402000.0 else 0.5 if n < 404000.0 else 1.0, 410000, 0.0),
]
"""Factors in each step, the number of steps, and the growth; the last ones leave the range of doubles in a call."""


@pytest.mark.parametrize("lanes", [1, 8])
@pytest.mark.parametrize(("factor", "steps", "expected"), STRETCHES)
@pytest.mark.slow
def test_strong_growth_neither_overflows_nor_vanishes(
    factor: Callable[[float], float], steps: int, expected: float, lanes: int
) -> None:
    code = tangent_code(find_scheme("rk4", "euler"), Pair(), stretching(factor), lanes)
    run = TangentRun(code, H, np.array([[0.0, 0.25]]), np.array([[0.0, 3.0]]))
    run.advance(steps)
    with np.errstate(divide="ignore"):
        assert growth(run)[0] - math.log(3.0) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("lanes", [1, 8])
def test_a_step_that_hides_an_infinity_has_failed(lanes: int) -> None:
    """From (0, 2): (2, inf), (inf, 1/2), (1/2, 0), which is finite; the run ends at the first step."""

    method = Stepper(lambda s, h, p: (s[1], 1.0 / s[0]), 2)
    y, top = np.array([[0.0, 2.0], [3.0, 2.0]])[:lanes], Pair()
    states, vectors = image(tangent_code(find_scheme("rk4", "euler"), top, method, lanes), y, np.ones_like(y), H, 3)
    assert np.isnan([*states[0], *vectors[0]]).all()
    assert lanes == 1 or states[1].tolist() == [0.5, 3.0]
    assert orbit(top, method, y[0], H, 3).ending.step == 1


@pytest.mark.slow
@pytest.mark.parametrize("functions", RULES, ids=lambda functions: functions[0].__name__)
def test_rules_of_dual_numbers(functions: tuple[Callable[..., Any], ...]) -> None:
    """Each against mpmath, for all combinations of dual numbers and plain ones."""
    function, count = functions[0], len(RULES[functions]) - 1
    x, dx = (0.3, 0.7, -1.3)[:count], (0.4, -1.1, 0.6)[:count]
    combinations = [one for one in product((True, False), repeat=count) if any(one)]
    arguments = [
        ", ".join(f"dual(x[{i}], dx[{i}])" if moves else f"x[{i}]" for i, moves in enumerate(one))
        for one in combinations
    ]
    calls = "".join(
        f"    s = function({text})\n    out[{2 * k}] = value_of(s)\n    out[{2 * k + 1}] = slope_of(s)\n"
        for k, text in enumerate(arguments)
    )
    scope: dict[str, Any] = {"function": function, "dual": dual, "value_of": primal_of, "slope_of": slope_of}
    exec(f"def take_steps(x, dx, out):\n{calls}    return 1", scope)
    out = np.zeros(2 * len(combinations))
    native(scope["take_steps"], "ppp", duals=True)(np.array(x), np.array(dx), out)
    exact = EXACT.get(function) or getattr(mpmath, function.__name__)
    for one, (value, slope) in zip(combinations, out.reshape(-1, 2), strict=True):
        moved = [d if moves else 0.0 for d, moves in zip(dx, one, strict=True)]
        line = lambda t, moved=moved: exact(*(a + t * d for a, d in zip(x, moved, strict=True)))  # noqa: E731
        assert value == function(*x)
        assert slope == pytest.approx(float(mpmath.diff(line, 0)), rel=1e-14)


EXACT: dict[Any, Callable[..., Any]] = {
    operator.add: operator.add,
    operator.sub: operator.sub,
    operator.mul: operator.mul,
    operator.truediv: operator.truediv,
    operator.neg: operator.neg,
    operator.pos: operator.pos,
    abs: abs,
    min: min,
    max: max,
    fma: lambda x, y, z: x * y + z,
    math.copysign: lambda x, y: -abs(x) if y < 0 else abs(x),
}


def test_every_function_of_a_formula_is_differentiated() -> None:
    known = {function for functions in RULES for function in functions}
    assert {abs if name == "abs" else getattr(math, name) for name in FUNCTIONS} <= known


def test_dual_numbers_in_branches_loops_and_powers() -> None:
    def take_steps(work, out):
        x = dual(work[0], 1.0)
        total = 0.0
        for k in range(3):
            total += fma(x, 2.0, k) * x**3 / (1 + x)
            total -= 1
        if total > x:
            total = -total
        if not math.isfinite(total) or total != total:
            total = x
        out[0] = primal_of(total)
        out[1] = slope_of(total)
        out[2] = slope_of(3.0)
        return 0

    out = np.zeros(3)
    native(take_steps, "pp", duals=True)(np.array([1.3]), out)
    value = sum((2 * 1.3 + k) * 1.3**3 / 2.3 for k in range(3)) - 3
    exact = mpmath.diff(lambda x: -sum((2 * x + k) * x**3 / (1 + x) for k in range(3)), 1.3)
    assert out == pytest.approx([-value, float(exact), 0.0], rel=1e-13)


RAISING = Stepper(lambda s, h, p: (s[int(10.0 * h)], s[1]), 2)
"""Takes a component by an index that numba checks."""


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("lanes", [1, 8])
def test_machine_code_that_raises_is_an_error(lanes: int) -> None:
    """Never arrays that it has not written: numba prints the exception and returns 0."""
    y, top, h = np.array([[0.5, 1.0], [0.5, 2.0]]), Pair(), 0.5
    calls = {
        "run": lambda: orbit(top, RAISING, y[-1], h, 3),
        "batch": lambda: driven(Plan(top, Machine(top, RAISING), np.tile(y, (2, 1)), h, 3)),
        "tangent": lambda: image(
            tangent_code(find_scheme("rk4", "euler"), top, RAISING, lanes), y[-lanes:], y[-lanes:], h
        ),
        "part": lambda: part_steps_of(RAISING, top, h)(y, np.zeros(2, dtype=np.int64), y, np.ones(2)),
    }
    for call in calls.values():
        with pytest.raises(SchemeCodeError, match="the compiled step raised the exception printed above; return nan"):
            call()


@pytest.mark.parametrize(
    ("name", "form", "words"),
    [
        ("exact", "kowalevski", "is a solution in closed form"),
        ("dop853", "heavy", "calls library functions"),
    ],
)
def test_schemes_without_a_tangent_map_are_refused_by_name(name: str, form: str, words: str) -> None:
    with pytest.raises(UsageError, match=rf"scheme '{name}' {words}.*; use a scheme"):
        code_of(name, form)
