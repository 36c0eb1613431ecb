"""Tangent maps: those that the compiler derives from a step, those that are generated, and the growth of vectors."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from fractions import Fraction
from itertools import product
from typing import Any

import mpmath
import numpy as np
import pytest

from split_motions import bracket_matrix
from steppers import built
from topcli.arithmetic.fused import fma
from topcli.contracts import Method, Stepper, Top
from topcli.engine.collect import orbit
from topcli.engine.compile import native
from topcli.engine.drive import drive as driven
from topcli.engine.duals import RULES, dual, slope_of, value_of
from topcli.engine.loops import interpreted, loop_of, part_steps_of
from topcli.engine.machine import Machine
from topcli.engine.plan import Plan
from topcli.engine.tangent import TangentRun, tangent_code
from topcli.errors import SchemeCodeError, UsageError
from topcli.field.expression import FUNCTIONS, in_arithmetic
from topcli.field.implicit import KahanStep, KahanTangent, generated
from topcli.field.polynomial import NotPolynomialError, decimal, field_of
from topcli.field.straight_line import function_of
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

H = 0.1


class Pair(Top):
    """Two numbers."""

    kind = "pair"
    components = ("x", "y")
    field = staticmethod(lambda y, p: y)


def quadratic_forms() -> list[str]:
    found = []
    for form, declared in TOPS.items():
        try:
            degree = max(rate.degree for rate in field_of(declared.new()))
        except NotPolynomialError:
            continue
        found += [form] if degree == 2 else []
    return found


def states_of(form: str, count: int = 3, seed: int = 5) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, len(TOPS[form].components)))


def code_of(name: str, form: str, lanes: int = 1, **options: object) -> Any:
    scheme, top = find_scheme(name, form), TOPS[form].new()
    return tangent_code(scheme, top, built(name, top, **options), lanes)


def image(code: Any, y: np.ndarray, v: np.ndarray, h: float, steps: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """States and vectors (m, d) after some steps."""
    run = code.run(h, y, v)
    run.advance(steps)
    return run.states, run.images


def growth(run: TangentRun) -> np.ndarray:
    return run.scales * math.log(2.0) + np.log(np.linalg.norm(run.vectors, axis=1))


def moved(method: Method, p: np.ndarray, y: np.ndarray, h: float, steps: int) -> np.ndarray:
    loop = interpreted(method, len(y), len(p))
    work, end = np.zeros(loop.width), np.empty_like(y)
    loop.enter(y, work, p, h)
    assert loop.drive(work, end, p, h, steps, steps, steps) == steps
    return end


@pytest.mark.parametrize("form", quadratic_forms())
def test_kahans_tangent_map_is_the_derivative_of_the_step(form: str) -> None:
    """In fractions: the difference quotient is off by the square of its step, 1e-30; the state keeps its bits."""
    top = TOPS[form].new()
    field, d, first = field_of(top), len(top.components), len(top.constants())
    plain, both = generated(KahanStep, field, first), generated(KahanTangent, field, first)
    step = function_of(plain.graph, "step", plain.outputs)
    tangent = function_of(both.graph, "tangent", both.outputs)
    exact_step, exact_tangent = (in_arithmetic(function, decimal, None) for function in (step, tangent))
    p, q = ((Fraction(0),) * first + made.constants for made in (plain, both))
    y, v = (tuple(Fraction(round(1000 * x), 1000) for x in state) for state in states_of(form, 2))
    h, nudge = Fraction(1, 7), Fraction(1, 10**15)
    up, down = (exact_step(tuple(a + s * nudge * b for a, b in zip(y, v, strict=True)), h, p) for s in (1, -1))
    found = exact_tangent((*y, *v), h, q)
    assert found[:d] == exact_step(y, h, p)
    for a, b, slope in zip(up, down, found[d:], strict=True):
        assert abs(float((a - b) / (2 * nudge) - slope)) < 1e-26
    numbers = tuple(map(float, y)), tuple(map(float, v)), tuple(map(float, p)), tuple(map(float, q))
    assert tangent((*numbers[0], *numbers[1]), H, numbers[3])[:d] == step(numbers[0], H, numbers[2])


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


@pytest.mark.parametrize(("name", "form"), [("hk", "clebsch"), ("hybrid", "kowalevski")])
def test_growth_depends_neither_on_other_orbits_nor_on_the_lengths_of_calls(name: str, form: str) -> None:
    """To the last bit: vectors are scaled by powers of two."""
    y, v = states_of(form, 8), states_of(form, 8, seed=6)
    v[3] *= 1e200
    together, alone = code_of(name, form, 8).run(H, y, v), code_of(name, form)
    together.advance(2000)
    for i in range(8):
        run = alone.run(H, y[i : i + 1], v[i : i + 1])
        for steps in (1, 300, 1699):
            run.advance(steps)
        assert np.array_equal(run.states[0], together.states[i])
        assert np.array_equal(np.ldexp(run.vectors[0], run.scales[0] - together.scales[i]), together.vectors[i])


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
    run = code.run(H, np.array([[0.0, 0.25]]), np.array([[0.0, 3.0]]))
    run.advance(steps)
    with np.errstate(divide="ignore"):
        assert growth(run)[0] - math.log(3.0) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def failing_orbits(name: str, form: str, method: Method, seed: int) -> list[tuple[np.ndarray, float, list[int]]]:
    """States of eight orbits, a step so long that many fail, and of each the first of 30 steps that does; 0 if none."""
    top, random = TOPS[form].new(), np.random.default_rng(seed)
    p, orbits = np.array(top.constants()), []
    loop = loop_of(method, len(top.components), len(p))
    for _ in range(6):
        y, h = random.normal(size=(8, len(top.components))), 10.0 ** random.uniform(0.3, 1.3)
        failed = []
        for state in y:
            work, end = np.zeros(loop.width), np.zeros(len(state))
            loop.enter(state, work, p, h)
            failed.append(max(0, -loop.drive(work, end, p, h, 30, 30, 30)))
        orbits.append((y, h, failed))
    return orbits


@pytest.mark.parametrize(
    ("name", "form", "lanes"),
    [
        ("dmv", "kowalevski", 1),
        ("dmv", "kowalevski", 8),
        ("dmv", "euler", 8),
        ("midpoint", "heavy", 8),
        ("hybrid-sym", "kowalevski", 8),
    ],
)
def test_an_orbit_breaks_off_at_its_first_failed_step(name: str, form: str, lanes: int) -> None:
    """State, vector and growth are nan where a run does not converge, also if later steps do."""
    code, early = code_of(name, form, lanes), 0
    for y, h, failed in failing_orbits(name, form, built(name, TOPS[form].new()), seed=8):
        for i in range(0, len(y), lanes):
            run = code.run(h, y[i : i + lanes], np.ones((lanes, y.shape[1])))
            run.advance(30)
            fails = [step > 0 for step in failed[i : i + lanes]]
            for values in (run.states, run.vectors, run.images):
                assert np.isnan(values.reshape(lanes, -1)).all(axis=1).tolist() == fails
                assert np.isnan(values.reshape(lanes, -1)).any(axis=1).tolist() == fails
            run.advance(1)
            assert np.isnan(growth(run))[fails].all()
        early += sum(0 < step < 30 for step in failed)
    assert early >= 5  # seen: 5 of the midpoint rule, 47 and 48 of 48 of the others


@pytest.mark.parametrize("lanes", [1, 8])
def test_a_step_that_hides_an_infinity_has_failed(lanes: int) -> None:
    """From (0, 2): (2, inf), (inf, 1/2), (1/2, 0), which is finite; the run ends at the first step."""

    method = Stepper(lambda s, h, p: (s[1], 1.0 / s[0]), 2)
    y, top = np.array([[0.0, 2.0], [3.0, 2.0]])[:lanes], Pair()
    states, vectors = image(tangent_code(find_scheme("rk4", "euler"), top, method, lanes), y, np.ones_like(y), H, 3)
    assert np.isnan([*states[0], *vectors[0]]).all()
    assert lanes == 1 or states[1].tolist() == [0.5, 3.0]
    assert orbit(top, method, y[0], H, 3).ending.step == 1


@pytest.mark.parametrize(("name", "bound"), [("splitting", 1e-13), ("backlund", 1e-12), ("hk", None), ("rk4", None)])
def test_canonical_steps_have_a_poisson_tangent_map(name: str, bound: float | None) -> None:
    """J P J^T = P at the image, to round-off; hk and rk4, which are not canonical, are the control."""
    top = TOPS["kowalevski"].new()
    y, scale = states_of("kowalevski", 1)[0] * 0.5, np.array([2.0, 2.0, 1.0, 1.0, 1.0, 1.0])
    states, vectors = image(code_of(name, "kowalevski", 8), np.repeat(y[None], 6, 0), np.diag(1.0 / scale), H)
    jacobian = (scale * vectors).T
    defect = np.abs(jacobian @ bracket_matrix(top, y) @ jacobian.T - bracket_matrix(top, states[0])).max()
    assert defect < bound if bound else defect > 1e-9


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
    scope: dict[str, Any] = {"function": function, "dual": dual, "value_of": value_of, "slope_of": slope_of}
    exec(f"def drive(x, dx, out):\n{calls}    return 1", scope)
    out = np.zeros(2 * len(combinations))
    native(scope["drive"], "ppp", duals=True)(np.array(x), np.array(dx), out)
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
    def drive(work, out):
        x = dual(work[0], 1.0)
        total = 0.0
        for k in range(3):
            total += fma(x, 2.0, k) * x**3 / (1 + x)
            total -= 1
        if total > x:
            total = -total
        if not math.isfinite(total) or total != total:
            total = x
        out[0] = value_of(total)
        out[1] = slope_of(total)
        out[2] = slope_of(3.0)
        return 0

    out = np.zeros(3)
    native(drive, "pp", duals=True)(np.array([1.3]), out)
    value = sum((2 * 1.3 + k) * 1.3**3 / 2.3 for k in range(3)) - 3
    exact = mpmath.diff(lambda x: -sum((2 * x + k) * x**3 / (1 + x) for k in range(3)), 1.3)
    assert out == pytest.approx([-value, float(exact), 0.0], rel=1e-13)


@pytest.mark.parametrize("n", [-3, -1, 0, 1, 2, 5])
def test_powers_of_dual_numbers_never_raise(n: int) -> None:
    def drive(work, out):
        s = dual(work[0], 1.0) ** n
        out[0] = value_of(s)
        out[1] = slope_of(s)
        return 1

    code, out = native(drive, "pp", duals=True), np.zeros(2)
    code.checked(np.array([1.25]), out)
    assert out == pytest.approx([1.25**n, n * 1.25 ** (n - 1)], rel=1e-15)
    code.checked(np.array([0.0]), out)
    assert out.tolist() == [0.0**n, n * 0.0 ** abs(n - 1)] if n >= 0 else [math.inf, -math.inf]


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
