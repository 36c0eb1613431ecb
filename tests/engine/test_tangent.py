"""Tangent maps: those that the compiler derives from a step, those that are generated, and the growth of vectors."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest

from split_motions import bracket_matrix
from steppers import built
from topcli.arithmetic.fused import fma
from topcli.contracts import Method, Stepper, Top
from topcli.engine.duals import IN_PLACE, RULES, dual, slope_of, value_of
from topcli.engine.ensemble import EnsembleRun
from topcli.engine.loop import interpreted, loop_of, state_after
from topcli.engine.native import native
from topcli.engine.part_steps import part_steps_of
from topcli.engine.run import Run
from topcli.engine.tangent import TangentRun, obstacle, tangent_code
from topcli.errors import SchemeCodeError, UsageError
from topcli.field.expression import FUNCTIONS, in_arithmetic
from topcli.field.implicit import KahanStep, KahanTangent, generated
from topcli.field.polynomial import NotPolynomialError, decimal, field_of
from topcli.field.straight_line import function_of
from topcli.schemes.compose import obstacle as not_composable
from topcli.schemes.registry import find_scheme, schemes_of
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
    run.advance(1, steps, renormalise=False)
    return run.states, run.vectors


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
]


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
    run = code.run(H, y, v)
    run.advance(4, 5)
    other = code_of("midpoint", form, 8).run(H / 100, y, v)
    other.advance(40, 50)
    assert run.growth == pytest.approx(other.growth, abs=1e-5)
    assert np.linalg.norm(run.vectors, axis=1) == pytest.approx(1.0)


def test_one_orbit_and_several_side_by_side_are_the_same() -> None:
    y, v = states_of("clebsch", 8), states_of("clebsch", 8, seed=6)
    side_by_side = TangentRun(code_of("hk", "clebsch", 8), H, y, v)
    side_by_side.advance(20, 16)
    for i in range(8):
        alone = TangentRun(code_of("hk", "clebsch"), H, y[i : i + 1], v[i : i + 1])
        alone.advance(20, 16)
        assert np.array_equal(alone.states[0], side_by_side.states[i])
        assert alone.growth[0] == pytest.approx(side_by_side.growth[i], rel=1e-12)


def test_growth_is_that_of_the_vector() -> None:
    """The logarithms of renormalised vectors add up to that of one that is not."""
    code, y, v = code_of("hk", "heavy"), states_of("heavy", 1), states_of("heavy", 1, seed=6)
    run = TangentRun(code, H, y, v)
    run.advance(10, 16)
    _, free = image(code, y, v, H, 160)
    assert run.growth[0] == pytest.approx(math.log(np.linalg.norm(free)), rel=1e-12)
    assert np.linalg.norm(run.vectors) == pytest.approx(1.0)


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
            run.advance(6, 5)
            fails = [step > 0 for step in failed[i : i + lanes]]
            for values in (run.states, run.vectors, run.growth):
                assert np.isnan(values.reshape(lanes, -1)).all(axis=1).tolist() == fails
                assert np.isnan(values.reshape(lanes, -1)).any(axis=1).tolist() == fails
            run.advance(1, 1)
            assert np.isnan(run.growth)[fails].all()
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
    assert Run(top, method, y[0], H, 3).collect().ending.step == 1


def test_a_part_of_a_step_that_does_not_converge_is_nan() -> None:
    top = TOPS["kowalevski"].new()
    method, h, count = built("dmv", top), 6.0, 200
    y, theta = states_of("kowalevski", count), np.linspace(0.0, 1.0, count)
    found = part_steps_of(method, top, h)(y, np.zeros(count, dtype=np.int64), y, theta)
    loop, p = interpreted(method, 6, 1), np.array(top.constants())
    ends = [state_after(loop, y[i], p, theta[i] * h) for i in range(count)]
    failed = [end is None for end in ends]
    assert 10 < sum(failed) < 190
    assert np.isnan(found).any(axis=1).tolist() == np.isnan(found).all(axis=1).tolist() == failed
    assert all(np.array_equal(end, row) for end, row in zip(ends, found, strict=True) if end is not None)


@pytest.mark.parametrize(("name", "bound"), [("splitting", 1e-13), ("backlund", 1e-12), ("hk", None), ("rk4", None)])
def test_canonical_steps_have_a_poisson_tangent_map(name: str, bound: float | None) -> None:
    """J P J^T = P at the image, to round-off; hk and rk4, which are not canonical, are the control."""
    top = TOPS["kowalevski"].new()
    y, scale = states_of("kowalevski", 1)[0] * 0.5, np.array([2.0, 2.0, 1.0, 1.0, 1.0, 1.0])
    states, vectors = image(code_of(name, "kowalevski", 8), np.repeat(y[None], 6, 0), np.diag(1.0 / scale), H)
    jacobian = (scale * vectors).T
    defect = np.abs(jacobian @ bracket_matrix(top, y) @ jacobian.T - bracket_matrix(top, states[0])).max()
    assert defect < bound if bound else defect > 1e-9


def rule_cases() -> list[object]:
    return [function for function in RULES if function not in IN_PLACE]


@pytest.mark.parametrize("function", rule_cases(), ids=lambda f: f.__name__)
def test_rules_of_dual_numbers(function) -> None:
    """Each against mpmath, for all combinations of dual numbers and plain ones."""
    count = RULES[function][0]
    a, b, da, db = -0.3, 0.7, 0.4, -1.1
    if count == 1:
        a = -a

        def drive(work, out):
            s = function(dual(work[0], work[2]))
            out[0] = value_of(s)
            out[1] = slope_of(s)
            return 0
    else:

        def drive(work, out):
            x, y = dual(work[0], work[2]), dual(work[1], work[3])
            s, t, u = function(x, y), function(work[0], y), function(x, work[1])
            out[0] = value_of(s)
            out[1] = slope_of(s)
            out[2] = slope_of(t)
            out[3] = slope_of(u)
            return 0

    out = np.zeros(4)
    native(drive, "pp", duals=True)(np.array([a, b, da, db]), out)
    names = {"neg": lambda x: -x, "pos": lambda x: x, "abs": abs, "fabs": abs, "copysign": lambda x, y: abs(x)}
    names |= {
        "add": lambda x, y: x + y,
        "sub": lambda x, y: x - y,
        "mul": lambda x, y: x * y,
        "truediv": lambda x, y: x / y,
    }
    names |= {"min": min, "max": max}
    exact = names.get(function.__name__) or getattr(mpmath, function.__name__)

    def slope(one: float, other: float) -> float:
        if count == 1:
            return float(mpmath.diff(lambda t: exact(a + t * one), 0))
        return float(mpmath.diff(lambda t: exact(a + t * one, b + t * other), 0))

    arguments = (a, b)[:count]
    assert out[0] == function(*arguments)
    assert out[1] == pytest.approx(slope(da, db), rel=1e-14)
    if count == 2:
        assert out[2:] == pytest.approx([slope(0.0, db), slope(da, 0.0)], rel=1e-14)


def test_every_function_of_a_formula_is_differentiated() -> None:
    assert {abs if name == "abs" else getattr(math, name) for name in FUNCTIONS} <= RULES.keys()


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
        "run": lambda: Run(top, RAISING, y[-1], h, 3).collect(),
        "ensemble": lambda: list(EnsembleRun(top, RAISING, y, h, 3, on_piece=lambda piece: None)),
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


def every_step() -> list[tuple[str, str]]:
    """Top and scheme, composed if it can be: for every top one in turn, one of each kind of each module."""
    found, covered = [("euler", "midpoint+yoshida4")], set()
    for k, form in enumerate(TOPS):
        top, names = TOPS[form].new(), []
        for scheme in schemes_of(form):
            composed = scheme if not_composable(scheme) else find_scheme(f"{scheme.name}+yoshida4", form)
            method = composed.build(top, composed.options())
            if not obstacle(method):
                names.append(composed.name)
                kind = scheme.build.__module__, getattr(method, "iterative", False)
                found += [] if kind in covered else [(form, composed.name)]
                covered.add(kind)
        found.append((form, names[k % len(names)]))
    return sorted(set(found))


@pytest.mark.slow
@pytest.mark.parametrize(("form", "name"), every_step())
def test_the_tangent_map_of_every_step_is_that_of_central_differences(form: str, name: str) -> None:
    """A composition contains its base scheme. Differences of the interpreted steps are off by 1e-9 at worst."""
    top, nudge = TOPS[form].new(), 1e-5
    method, p = built(name, top), np.array(top.constants())
    y, v = 0.5 * states_of(form, 1), states_of(form, 1, seed=6)
    states, vectors = image(code_of(name, form), y, v, H, 2)
    reached, up, down = (moved(method, p, y[0] + s * nudge * v[0], H, 2) for s in (0, 1, -1))
    assert np.abs((up - down) / (2 * nudge) - vectors[0]).max() < 1e-7 * np.abs(vectors).max()
    assert np.abs(states[0] - reached).max() < 1e-14
