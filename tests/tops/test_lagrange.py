"""The Lagrange top: steps and modified integrals against exact fractions, closed forms, the two frames, the scenes."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import mpmath as mp
import numpy as np
import pytest

import twins
from conftest import GEN, random_states
from lagrange_forms import nutation_bs, nutation_hk, to_body, to_inertial, units
from steppers import rk2
from topcli.analysis.reference import reference_states
from topcli.arithmetic.elliptic import landen
from topcli.config.load import load_experiment
from topcli.contracts import Invariant, Method, Top
from topcli.engine.loop import Run
from topcli.errors import RunError, UsageError
from topcli.runs.simulate import simulate
from topcli.schemes.lagrange.exact import body_states, inertial_states
from topcli.schemes.lagrange.hk_bs import bs_step, hk_corrections, hk_lagrange
from topcli.schemes.registry import find_scheme
from topcli.tops.lagrange import Lagrange, LagrangeInertial

EPS = float(np.finfo(float).eps)
INERTIAL = LagrangeInertial()


def random_tops(count: int, seed: int) -> list[Lagrange]:
    random = np.random.default_rng(seed)
    return [
        Lagrange(
            A=random.uniform(0.5, 2.0), C=random.uniform(0.3, 2.0), mu=random.choice([-1, 1]) * random.uniform(0.1, 2)
        )
        for _ in range(count)
    ]


def fractions(seed: int, count: int) -> list[Fraction]:
    random = np.random.default_rng(seed)
    return [Fraction(int(random.integers(-20, 21)), int(random.integers(1, 10))) for _ in range(count)]


def positive(seed: int, count: int) -> list[Fraction]:
    return [abs(x) + Fraction(1, 7) for x in fractions(seed, count)]


def iterated(method: Method, top: Top, y0: Any, h: float, N: int, every: int = 1) -> np.ndarray:
    return Run(top, method, y0, h, N, every).collect().states


def steps(name: str, top: Top) -> Method:
    return find_scheme(name, top.form).build(top, find_scheme(name, top.form).options())


# ---------------------------------------------------------------- the maps, in exact arithmetic


def kahan(y: list[Fraction], h: Fraction, p: tuple[Fraction, Fraction]) -> list[Fraction]:
    """HK as Kahan's method: (I - h/2 f'(y)) (y' - y) = h f(y), the derivative by exact differences."""
    from topcli.tops.lagrange import field

    here, columns = twins.exactly(field, y, p), []
    for i in range(6):
        up, down = ([v + s * (i == j) for j, v in enumerate(y)] for s in (1, -1))
        columns.append(
            [(a - b) / 2 for a, b in zip(twins.exactly(field, up, p), twins.exactly(field, down, p), strict=True)]
        )
    matrix = [[(i == j) - h / 2 * columns[j][i] for j in range(6)] for i in range(6)]
    change = twins.solve(matrix, [h * f for f in here])
    return [a + b for a, b in zip(y, change, strict=True)]


@pytest.mark.parametrize("seed", range(8))
def test_hk_solves_its_equations_exactly(seed: int) -> None:
    y, (A, C, mu, h) = fractions(seed, 6), positive(seed + 50, 4)
    p = ((A - C) / A, mu / A)
    assert twins.exactly(hk_lagrange, y, h, p) == kahan(y, h, p)
    assert twins.exactly(hk_lagrange, y, -h, (p[0], Fraction(0))) == kahan(y, -h, (p[0], Fraction(0)))


@pytest.mark.parametrize("seed", range(8))
def test_bs_solves_its_equations_exactly(seed: int) -> None:
    y, (h,) = fractions(seed, 6), positive(seed, 1)
    m1, m2, m3, *a = y
    new = twins.exactly(bs_step, y, h, (1,))
    assert new[:3] == [m1 - h * a[1], m2 + h * a[0], m3]
    n, b, c = new[:3], new[3:], [x + z for x, z in zip(a, new[3:], strict=True)]
    turned = [n[1] * c[2] - n[2] * c[1], n[2] * c[0] - n[0] * c[2], n[0] * c[1] - n[1] * c[0]]
    assert [x - z for x, z in zip(b, a, strict=True)] == [h / 2 * x for x in turned]


def modified_exactly(y: list[Fraction], A: Fraction, C: Fraction, mu: Fraction, h: Fraction) -> list[Fraction]:
    """gamma², m.gamma and E with ``hk_corrections``, in exact arithmetic."""

    class Exactly:
        A = np.array([twins.Exact(1)])

        def constants(self) -> tuple[np.ndarray, np.ndarray]:
            return np.array([twins.Exact((A_ - C) / A_)]), np.array([twins.Exact(mu / A_)])

    A_, top = A, Exactly()
    top.A = np.array([twins.Exact(A)])
    state = np.array([[twins.Exact(v) for v in y]], dtype=object)
    found = [v[0].value for v in hk_corrections(top, np.array([twins.Exact(h)]), state)]  # pyright: ignore
    w1, w2, w3, g1, g2, g3 = y
    plain = [
        g1 * g1 + g2 * g2 + g3 * g3,
        A * (w1 * g1 + w2 * g2) + C * w3 * g3,
        (A * (w1 * w1 + w2 * w2) + C * w3 * w3) / 2 + mu * g3,
    ]
    return [a + b for a, b in zip(plain, found, strict=True)]


@pytest.mark.parametrize("seed", range(6))
def test_modified_integrals_of_hk_are_exact_without_rounding(seed: int) -> None:
    y, (A, C, mu, h) = fractions(seed, 6), positive(seed + 9, 4)
    for strength in (mu, -mu, Fraction(0)):
        p = ((A - C) / A, strength / A)
        new = twins.exactly(hk_lagrange, y, h, p)
        assert modified_exactly(new, A, C, strength, h) == modified_exactly(y, A, C, strength, h)
        assert modified_exactly(new, A, C, strength, 2 * h) != modified_exactly(y, A, C, strength, 2 * h)  # control


# ---------------------------------------------------------------- round-off over long runs


def over_bound(invariants: tuple[Invariant, ...], states: np.ndarray, N: int) -> dict[str, float]:
    """Largest deviation in units of 50 ulp times sqrt(N)."""
    found = {}
    for one in invariants:
        values = one.value(states)
        found[one.name] = float(np.abs(values - values[0]).max() / (50 * EPS * np.sqrt(N) * one.scale(states).max()))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.2, 0.05, 0.01])
@pytest.mark.parametrize("name", ["hk", "bs"])
def test_integrals_of_random_tops_stay_at_round_off(name: str, h: float) -> None:
    for top, y0 in zip(random_tops(20, 7), random_states(20, 9), strict=True):
        chosen: Top = top if name == "hk" else INERTIAL
        scheme = find_scheme(name, chosen.form)
        assert scheme.modified
        exact = [one for one in chosen.invariants() if one.name in scheme.conserves]
        states = iterated(steps(name, chosen), chosen, y0, h, 100_000, 25)
        found = over_bound((*exact, *scheme.modified(chosen, h, scheme.options())), states, 100_000)
        assert len(found) == 4
        assert max(found.values()) < 1.0, (chosen, y0, found)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 0.5])
def test_modified_integrals_at_small_and_large_steps(h: float) -> None:
    scheme = find_scheme("hk", "lagrange")
    assert scheme.modified
    for top, y0 in zip(random_tops(6, 3), random_states(6, 4), strict=True):
        states = iterated(steps("hk", top), top, y0, h, 100_000, 25)
        assert max(over_bound(scheme.modified(top, h, scheme.options()), states, 100_000).values()) < 1.0


def test_round_off_control() -> None:
    """The plain integrals under HK and BS, and the modified ones under another map, fail the same measure by far."""
    top = Lagrange(C=0.7)
    scheme = find_scheme("hk", "lagrange")
    assert scheme.modified
    plain = over_bound(top.invariants()[:3], iterated(steps("hk", top), top, GEN, 0.01, 20_000), 20_000)
    assert min(plain.values()) == pytest.approx(3.71e06, rel=0.05)
    other = iterated(rk2(top), top, GEN, 0.01, 20_000)
    assert min(over_bound(scheme.modified(top, 0.01, scheme.options()), other, 20_000).values()) == pytest.approx(
        1.35e07, rel=0.05
    )
    states = iterated(steps("bs", INERTIAL), INERTIAL, GEN, 0.01, 20_000)
    assert over_bound(INERTIAL.invariants()[3:], states, 20_000)["energy"] == pytest.approx(1.89e09, rel=0.05)


def test_corrections_are_of_second_order() -> None:
    top = Lagrange(A=1.3, C=0.7, mu=0.9)
    large, small = (np.array(hk_corrections(top, h, np.array([GEN])))[:, 0] for h in (2e-2, 1e-2))
    assert large / small == pytest.approx([4.0, 4.0, 4.0], rel=1e-3)


# ---------------------------------------------------------------- closed forms


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.2, 0.05, 0.01, -0.05])
def test_nutation_of_the_maps_in_closed_form(h: float) -> None:
    n = np.arange(1001)
    for top, y0 in zip(random_tops(20, 1), random_states(20, 2), strict=True):
        bs = iterated(steps("bs", INERTIAL), INERTIAL, y0, h, 1000)[:, 5]
        assert np.abs(nutation_bs(y0, h, n) - bs).max() < 1e-12
        hk = iterated(steps("hk", top), top, y0, h, 1000)[:, 5]
        assert np.abs(nutation_hk(top, y0, h, n) - hk).max() < 2e-12  # the doubles' share of it: see below
    assert (
        np.abs(nutation_bs(GEN, 1.001 * h, n) - iterated(steps("bs", INERTIAL), INERTIAL, GEN, h, 1000)[:, 5]).max()
        > 1e-6
    )


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.2, 0.01])
def test_nutation_of_the_maps_iterated_in_40_digits(h: float) -> None:
    """Without the round-off of the iteration the closed forms agree with the maps much better."""
    with mp.workdps(40):
        for top, y0 in zip(random_tops(4, 1), random_states(4, 2), strict=True):
            inertial = body = tuple(map(mp.mpf, map(float, y0)))
            A, C, mu = map(mp.mpf, (top.A, top.C, top.mu))
            for _ in range(300):
                inertial = bs_step(inertial, mp.mpf(h), (1,))  # pyright: ignore
                body = hk_lagrange(body, mp.mpf(h), ((A - C) / A, mu / A))  # pyright: ignore
            n = np.array([300])
            assert abs(nutation_bs(y0, h, n)[0] - inertial[5]) < 2e-15
            assert abs(nutation_hk(top, y0, h, n)[0] - body[5]) < 2e-15


@pytest.mark.slow
def test_closed_form_against_the_reference() -> None:
    times = np.arange(0, 2001, 50)
    for top, y0 in zip(random_tops(25, 5), random_states(25, 6), strict=True):
        for h in (0.02, -0.05):
            inertial = inertial_states(y0, h, times, INERTIAL.constants())
            assert np.abs(inertial - reference_states(INERTIAL, y0, times * h)).max() < 1e-12
            body = body_states(y0, h, times, top.constants())
            assert np.abs(body - reference_states(top, y0, times * h)).max() < 1e-12


@pytest.mark.parametrize(
    "y0",
    [
        (0.0, 0.0, 0.0, 0.6, 0.0, 0.8),  # a plane pendulum let go
        (0.0, 0.3, 0.0, 0.6, 0.0, 0.8),  # pushed
        (0.0, 3.0, 0.0, 0.6, 0.0, 0.8),  # going over the top
        (0.0, 0.0, 2.5, 0.0, 0.0, 1.0),  # asleep
        (1e-5, 0.0, 1.9, 0.0, 0.0, 1.0),  # waking
        (0.0, 0.0, 0.5, 1e-10, 0.0, 1.0),  # falling from next to the vertical
        (0.0, 0.0, 0.0, 0.0, 0.0, -1.0),  # hanging at rest
        (3.0, 4.0, 0.0, 0.0, 0.0, 1.0),  # thrown off the vertical
        (0.0, 0.0, 20.0, 0.6, 0.0, 0.8),  # fast
        (0.4, 0.7, 1.3, 0.6, 0.8, 0.0),  # level
        (0.0, 0.0, 1.99, 0.1, 0.0, 0.99498743710662),  # close to a sleeping top's separatrix
    ],
)
@pytest.mark.parametrize("mu", [1.0, 0.0, -1.3])
def test_closed_form_on_special_motions(y0: tuple[float, ...], mu: float) -> None:
    top, n = Lagrange(C=1.0, mu=mu), np.arange(0, 1001, 10)
    assert (
        np.abs(body_states(np.array(y0), 0.02, n, top.constants()) - reference_states(top, y0, n * 0.02)).max() < 2e-13
    )


def test_almost_planar_motion_is_refused() -> None:
    with pytest.raises(RunError, match="planar"):
        inertial_states(np.array((0, 0, 1e-6, 0.6, 0, 0.8)), 0.1, np.arange(3), (1.0,))


@pytest.mark.parametrize("kc2", [1.0, 0.7, 1e-3, 1e-12])
def test_jacobi_functions(kc2: float) -> None:
    with mp.workdps(30):
        quarter = float(mp.ellipk(1 - mp.mpf(kc2)))
        u = np.linspace(-2 * quarter, 2 * quarter, 23)
        for mine, name in zip(landen(u, kc2), ("sn", "cn", "dn"), strict=True):
            true = [float(mp.ellipfun(name, mp.mpf(x), m=1 - mp.mpf(kc2))) for x in u]
            assert mine == pytest.approx(true, abs=3e-15 * max(1.0, quarter))


# ---------------------------------------------------------------- the two frames


def test_frames_convert_there_and_back() -> None:
    for top, states in ((t, random_states(30, 8)) for t in random_tops(5, 2) if t.mu > 0.0):
        states = np.vstack([states, [0.1, 0.2, 0.3, 0.0, 0.0, 1.0], [0.1, 0.2, 0.3, 0.0, 0.0, -1.0]])
        precession = np.linspace(-3.0, 3.0, len(states))
        inertial, spin = to_inertial(top, states, precession)
        back, angle = to_body(top, inertial, spin)
        assert np.abs(back - states).max() < 1e-14
        assert np.abs(np.exp(1j * angle[:-2]) - np.exp(1j * precession[:-2])).max() < 1e-14
        # with a vertical axis both angles turn about it: the same way if it is upright, against each other if it hangs
        assert spin[-2:].tolist() == [precession[-2], -precession[-1]]
        momentum, _ = units(top)
        values = {i.name: i.value(states) for i in top.invariants()}
        there = {i.name: i.value(inertial) for i in INERTIAL.invariants()}
        assert there["m_p"] * momentum == pytest.approx(values["m_gamma"], abs=1e-14)
        assert there["m_a"] * momentum == pytest.approx(values["m_axis"], abs=1e-14)
        spin_energy = 0.5 * top.C * states[:, 2] ** 2
        energy = (values["energy"] - spin_energy) / top.mu + 0.5 * there["m_a"] ** 2
        assert there["energy"] == pytest.approx(energy, abs=1e-13)


def test_the_same_motion_in_both_frames() -> None:
    """The frame-independent component u agrees at all times, exactly and under both schemes to their order."""
    top, n = Lagrange(A=1.3, C=0.9, mu=0.7), np.arange(0, 1001, 20)
    start = to_inertial(top, np.array([GEN]), np.zeros(1))[0][0]
    h, (_, time) = 0.01, units(top)
    body = reference_states(top, GEN, n * h)
    assert np.abs(inertial_states(start, h / time, n, (1.0,))[:, 5] - body[:, 5]).max() < 1e-13
    hk = iterated(steps("hk", top), top, GEN, h, 1000, 20)[:, 5]
    bs = iterated(steps("bs", INERTIAL), INERTIAL, start, h / time, 1000, 20)[:, 5]
    assert np.abs(hk - body[:, 5]).max() == pytest.approx(2.26e-4, rel=0.02)
    assert np.abs(bs - body[:, 5]).max() == pytest.approx(1.39e-2, rel=0.02)
    other = to_inertial(top, np.array([GEN]), np.zeros(1))[0][0] * (1, 1, 1.01, 1, 1, 1)  # control
    assert np.abs(inertial_states(other, h / time, n, (1.0,))[:, 5] - body[:, 5]).max() == pytest.approx(
        0.0117, rel=0.05
    )


def test_the_attitude_is_that_of_the_motion() -> None:
    """Inertial states with the spin carried along reproduce the body frame's state after any time."""
    top = Lagrange(A=1.0, C=0.6, mu=1.0)
    n = np.array([0, 137, 900])
    start = np.array([GEN])
    inertial, _ = to_inertial(top, start, np.array([0.4]))
    moved = inertial_states(inertial[0], 0.01, n, (1.0,))
    body = body_states(start[0], 0.01, n, top.constants())
    angle = np.arctan2(moved[:, 3], -moved[:, 4])
    assert np.abs(to_inertial(top, body, angle)[0] - moved).max() < 1e-13


def test_inertial_form_needs_gravity_upwards() -> None:
    with pytest.raises(ValueError, match="mu > 0"):
        units(Lagrange(mu=-1.0))


# ---------------------------------------------------------------- configs


def test_unequal_moments_are_refused_and_heavy_is_offered() -> None:
    base = {"initial": {"omega": [1, 0, 0], "gamma": [0, 0, 1]}, "scheme": "hk", "h": 0.1, "N": 10}
    with pytest.raises(UsageError, match=r"B: must equal A = 1\.0 .* not 2\.0.*heavy"):
        simulate(top={"kind": "lagrange", "A": 1.0, "B": 2.0}, **base)
    assert Lagrange(A=3.0).B == 3.0
    equal = simulate(top={"kind": "lagrange", "A": 1.0, "B": 1.0}, **base)
    assert np.array_equal(equal.states, simulate(top={"kind": "lagrange", "A": 1.0}, **base).states)
    with pytest.raises(UsageError, match="greater than 0"):
        simulate(top={"kind": "lagrange", "C": -1.0}, **base)
    assert "triangle" in Lagrange(C=2.5).warnings()[0]
    assert Lagrange(C=2.0).warnings() == ()


def test_a_scheme_of_the_other_frame_is_refused() -> None:
    with pytest.raises(UsageError, match=r"'bs' does not fit top 'lagrange'.*lagrange/inertial"):
        load_experiment("lagrange_hk", ("scheme=bs",))


def precession_rates(scene: str) -> tuple[np.ndarray, np.ndarray]:
    y = simulate(scene)
    return np.diff(np.unwrap(np.arctan2(y["a2"], y["a1"]))) / y.h, y["a3"]


def test_nutation_scenes_show_the_motion_in_their_names() -> None:
    rates = {name: precession_rates(f"lagrange_{name}") for name in ("cusps", "loops", "waves")}
    for rate, height in rates.values():
        assert height.max() <= 0.6 + 1e-15
        assert len(np.flatnonzero((height[1:-1] < height[:-2]) & (height[1:-1] <= height[2:]))) == 9
        assert rate.sum() * 0.005 == pytest.approx(2 * np.pi, abs=0.01)  # once round
    rate, height = rates["cusps"]
    assert rate.min() == pytest.approx(3.4e-6, rel=0.05)
    assert height[1:][rate.argmin()] == pytest.approx(0.6, rel=0.05)  # where it is at rest it is at the top
    rate, height = rates["loops"]
    assert rate.min() < -0.3
    assert height[1:][rate < 0.0].min() > 0.523 - 0.01
    assert height[1:][rate > 0.0].max() < 0.523 + 0.01
    assert rates["waves"][0].min() == pytest.approx(0.163, rel=0.05)


def test_slow_sleeping_top_tilts_and_fast_top_nutates_slightly() -> None:
    tilt = np.degrees(np.arccos(simulate("lagrange_sleeping")["gamma3"]))
    assert tilt[0] < 0.06
    assert tilt.max() == pytest.approx(11.48, abs=0.02)
    still = np.degrees(
        np.arccos(simulate("lagrange_sleeping", initial={"omega": [0, 0, 4.05], "gamma": [1e-3, 0, "auto"]})["gamma3"])
    )
    assert still.max() < 1.0
    fast = simulate("lagrange_fast")["gamma3"]
    assert np.ptp(fast) == pytest.approx(1.805e-3, rel=0.01)


def test_the_spin_turns_against_gamma_in_the_body() -> None:
    """gamma, fixed in space, turns in the body by minus the spin: a sleeping top with a marked direction."""
    h, omega3 = 0.01, 2.0
    tilted = (0.0, 0.0, omega3, 1e-9, 0.0, 1.0)
    for mu in (0.0, -1.0):
        states = body_states(np.array(tilted), h, np.arange(0, 41, 10), Lagrange(A=1.0, C=1.0, mu=mu).constants())
        turned = np.unwrap(np.angle(states[:, 3] + 1j * states[:, 4]))
        if mu == 0.0:  # in a free spherical top gamma turns at exactly minus omega3
            assert turned == pytest.approx(-omega3 * h * np.arange(0, 41, 10), abs=1e-12)
        assert (np.diff(turned) < 0.0).all()
