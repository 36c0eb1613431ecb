"""The tops of the catalogue: their fields, integrals and HK maps, exactly, and the steps generated for them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import pytest

from topcli.config.load import load_experiment
from topcli.contracts import Top
from topcli.field.integrals import hk_image, rate_of_change
from topcli.field.polynomial import Polynomial, decimal, field_of
from topcli.runs.simulate import simulate
from topcli.schemes.registry import find_scheme
from topcli.testing import check_scheme
from topcli.tops import CATALOGUE, TOPS

by_form = pytest.mark.parametrize("form", CATALOGUE)
START = (0.7, -0.4, 1.1, 0.6, -0.48, 0.64)
STEP = Fraction(1, 7)


def constants(top: Top) -> tuple[Fraction, ...]:
    return tuple(map(decimal, top.constants()))


def variables(d: int) -> tuple[Polynomial, ...]:
    return tuple(map(Polynomial.variable, range(d)))


def start(top: Top) -> tuple[float, ...]:
    return START[: len(top.components)]


# the equations of motion


def cross(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def so3(y: Sequence[Any], H: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    """Lie-Poisson bracket of so(3) with the gradient H: m' = m x H_m."""
    return cross(y, H)


def e3(y: Sequence[Any], H: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    """Lie-Poisson bracket of e(3): m' = m x H_m + p x H_p, p' = p x H_m."""
    sums = zip(cross(y[:3], H[:3]), cross(y[3:], H[3:]), strict=True)
    return [*(a + b for a, b in sums), *cross(y[3:], H[:3])]


def su2(y: Sequence[Any], H: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    """Two spins: a' = H_a x a, b' = H_b x b."""
    return [*cross(H[:3], y[:3]), *cross(H[3:], y[3:])]


def canonical(y: Sequence[Any], H: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    return [H[1], -H[0]]


def so4(y: Sequence[Any], H: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    """M' = [M, H_M] with antisymmetric matrices of dimension four."""
    pairs = list(itertools.combinations(range(4), 2))
    M, W = ([[0] * 4 for _ in range(4)] for _ in "MW")
    for (i, j), m, w in zip(pairs, y, H, strict=True):
        M[i][j], M[j][i], W[i][j], W[j][i] = m, -m, w, -w
    return [sum((M[i][k] * W[k][j] - W[i][k] * M[k][j] for k in range(4)), start=0) for i, j in pairs]


def body(y: Sequence[Any], H: Sequence[Any], p: Sequence[Any]) -> list[Any]:
    """The same for m = J omega + k e3 and gamma; the constants are J and k."""
    m = [p[0] * y[0], p[1] * y[1], p[2] * y[2] + p[3]]
    rates = e3([*m, *y[3:]], [H[0] / p[0], H[1] / p[1], H[2] / p[2], *H[3:]], p)
    return [rates[0] / p[0], rates[1] / p[1], rates[2] / p[2], *rates[3:]]


def moments_and_rotor(top: Top) -> list[Fraction]:
    """J and k of the bodies, by the conditions of their names."""
    p = {name: decimal(value) for name, value in top.model_dump().items()}
    match top.kind:
        case "lagrange-gyrostat":
            return [p["A"], p["A"], p["C"], p["k"]]
        case "kowalevski-gyrostat":
            return [Fraction(2), Fraction(2), Fraction(1), p["k"]]
        case "goryachev-chaplygin":
            return [Fraction(4), Fraction(4), Fraction(1), Fraction(0)]
        case "hess-appelrot":  # A (B - C) x0² = C (A - B) z0²
            A, C, x, z = p["A"], p["C"], p["x0"] ** 2, p["z0"] ** 2
            return [A, A * C * (x + z) / (A * x + C * z), C, Fraction(0)]
    return []


Bracket = Callable[[Sequence[Any], Sequence[Any], Sequence[Any]], list[Any]]
BRACKETS: dict[str, Bracket] = {
    "volterra": so3,
    "lagrange-gyrostat": body,
    "kowalevski-gyrostat": body,
    "goryachev-chaplygin": body,
    "hess-appelrot": body,
    "clebsch": e3,
    "kirchhoff": e3,
    "gaudin": su2,
    "weierstrass": canonical,
    "so4": so4,
}


@pytest.mark.parametrize("form", BRACKETS)
def test_the_field_is_that_of_the_energy(form: str) -> None:
    """By the Poisson bracket of the top, exactly."""
    top = TOPS[form].new()
    y = variables(len(top.components))
    p = constants(top)
    energy = top.integrals[top.energy](y, p)
    expected = BRACKETS[form](y, [energy.derivative(i) for i in range(len(y))], moments_and_rotor(top) or p)
    assert list(field_of(top)) == expected


def test_coupled_euler_tops_lose_an_integral_without_their_condition() -> None:
    top = TOPS["coupled-euler"]
    assert [one.name for one in top(alpha5=12.0).invariants()] == ["h12", "h45", "coupling"]
    assert [*top(alpha5=12.0).integrals_of("hk", 0.1)] == ["modified_h12", "modified_h45"]
    assert len(top(alpha1=0.1, alpha2=-6.0, alpha5=0.3, alpha6=-2.0).invariants()) == 4  # as decimals


def test_fields_without_a_bracket() -> None:
    """Suslov's with the multiplier of its constraint, omega3 = 0; the products of coupled Euler tops."""
    assert set(CATALOGUE) - set(BRACKETS) == {"suslov", "coupled-euler"}
    top = TOPS["suslov"].new()
    w1, w2 = variables(2)
    I1, I2, I13, I23 = constants(top)
    m3 = I13 * w1 + I23 * w2  # J omega; (J omega)' = J omega x omega + multiplier e3
    torque = cross([I1 * w1, I2 * w2, m3], [w1, w2, Polynomial({})])
    assert [rate * moment for rate, moment in zip(field_of(top), (I1, I2), strict=True)] == torque[:2]
    x = variables(5)
    products = [(1, 2), (2, 0), (0, 1), (4, 2), (2, 3)]
    alpha = constants(TOPS["coupled-euler"].new())
    rates = [a * x[i] * x[j] for a, (i, j) in zip((*alpha[:3], *alpha[4:]), products, strict=True)]
    rates[2] += alpha[3] * x[3] * x[4]
    assert list(field_of(TOPS["coupled-euler"].new())) == rates


# the HK map


def kahan(top: Top, y: Sequence[Fraction], h: Fraction) -> list[Fraction]:
    """Kahan's step in rational numbers."""
    image = hk_image(field_of(top), y, h)
    assert image
    return image


def midpoint(top: Top, y: Sequence[Fraction], h: Fraction) -> list[Fraction]:
    """The explicit midpoint rule in rational numbers."""
    field = field_of(top)
    half = [old + h / 2 * rate.value(y) for old, rate in zip(y, field, strict=True)]
    return [old + h * rate.value(half) for old, rate in zip(y, field, strict=True)]


@by_form
def test_integrals_of_the_hk_map_are_exact(form: str) -> None:
    """In rational numbers; at h = 0 they are integrals of the motion. Another map of the second order changes them."""
    top = TOPS[form].new()
    y, p = [decimal(x) for x in start(top)], constants(top)
    for name, one in top.integrals_of("hk", STEP).items():
        assert one(kahan(top, y, STEP), p) == one(y, p), name
        assert one(midpoint(top, y, STEP), p) != one(y, p), name
    for name, one in top.integrals_of("hk", Fraction(0)).items():
        plain = Polynomial.of(one(variables(len(y)), p))
        assert plain.degree > 0
        assert rate_of_change(field_of(top), plain) == {}, name


@pytest.mark.slow
@by_form
def test_declared_traits_of_hk_hold(form: str) -> None:
    assert [trait for trait in check_scheme("hk", form) if not trait.holds] == []


# integrals of motions on a level


@pytest.mark.slow
@pytest.mark.parametrize(("form", "name"), [("goryachev-chaplygin", "chaplygin"), ("hess-appelrot", "hess")])
def test_integrals_on_a_level_are_judged_only_there(form: str, name: str) -> None:
    """Both sides of the tolerance of 20 ulp: the gentle scenes start on the level, up to round-off."""
    found = {}
    for off in (0.0, 1e-15, 1e-13):
        scene = load_experiment(f"{form.replace('-', '_')}_gentle", ["N=500"]).resolved()
        omega = scene["initial"]["omega"]
        scene["initial"]["omega"] = [omega[0], omega[1], omega[2] * (1.0 + off)]
        found[off] = simulate(scene).invariants().loc[name, ["verdict", "reason"]]
    assert found[0.0].verdict in ("exact", "undecided")  # judged, by a short run
    assert found[1e-15].verdict == found[0.0].verdict
    assert found[1e-13].verdict == "unjudged"
    assert found[1e-13].reason.startswith("conserved only where")


def test_an_invariant_hyperplane_is_kept_by_every_scheme_that_keeps_linear_integrals() -> None:
    """In exact arithmetic; a step that begins beside it changes F."""
    top = TOPS["hess-appelrot"].new()
    on = [Fraction(1, 4), Fraction(3, 10), Fraction(-3, 8), Fraction(3, 5), Fraction(0), Fraction(4, 5)]
    beside = [on[0] + Fraction(1, 100), *on[1:]]
    p = constants(top)
    hess = top.integrals["hess"]
    for step in (kahan, midpoint):
        assert hess(step(top, on, STEP), p) == hess(on, p) == 0
        assert hess(step(top, beside, STEP), p) != hess(beside, p)
    assert all("hess" in find_scheme(name, "hess-appelrot").conserves for name in ("rk2", "rk4", "midpoint"))
    assert "chaplygin" not in find_scheme("midpoint", "goryachev-chaplygin").conserves
