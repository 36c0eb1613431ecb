"""The Taylor reference against 40-digit series, closed forms, and itself."""

from __future__ import annotations

import math
from functools import cache

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from declared import Heavy
from topcli.analysis import reference
from topcli.analysis.reference import REACH, reference_states, table_of
from topcli.contracts import Floats, Top
from topcli.errors import RunError
from topcli.field.units import NaturalUnits
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski

GEN = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
PAPER = (2.0, 0.0, 0.0, math.sqrt(1 - 1e-6), 0.0, 1e-3)


HEAVY = Heavy(A=1.1, B=1.7, C=2.3, x0=0.3, y0=-0.7, z0=1.9)
FREE = Euler(A=1.1, B=1.7, C=2.3)


# ---------------------------------------------------------------- 40-digit references


def mp_orbit(top: Top, y0, times, *, dps=40, order=42, step=0.1):
    """Fixed-step, fixed-order series in mpmath, in the equations' undivided form; list of states."""
    with mp.workdps(dps):
        (A, B, C), (gx, gy, gz) = ([mp.mpf(v) for v in row] for row in _rows(top))
        y, at, found = [mp.mpf(v) for v in y0], mp.mpf(0), []
        for t in times:
            count = max(1, math.ceil(abs(float(t) - float(at)) / step))
            d = (mp.mpf(float(t)) - at) / count
            for _ in range(count):
                powers = [d**k for k in range(order + 1)]
                y = [mp.fdot(s, powers) for s in _mp_series(A, B, C, gx, gy, gz, y, order)]
            at = mp.mpf(float(t))
            found.append(y)
        return found


def _rows(top: Top):
    equations = top.euler_poisson()
    return equations.moments, equations.gravity


def _mp_series(A, B, C, gx, gy, gz, y, order):
    s = w1, w2, w3, g1, g2, g3 = [[v] for v in y]
    for j in range(order):
        r1, r2, r3 = w1[::-1], w2[::-1], w3[::-1]
        rates = (
            ((B - C) * mp.fdot(w2, r3) + gz * g2[j] - gy * g3[j]) / A,
            ((C - A) * mp.fdot(w3, r1) + gx * g3[j] - gz * g1[j]) / B,
            ((A - B) * mp.fdot(w1, r2) + gy * g1[j] - gx * g2[j]) / C,
            mp.fdot(g2, r3) - mp.fdot(g3, r2),
            mp.fdot(g3, r1) - mp.fdot(g1, r3),
            mp.fdot(g1, r2) - mp.fdot(g2, r1),
        )
        for series, rate in zip(s, rates, strict=True):
            series.append(rate / (j + 1))
    return s


SCENES = {
    "gen": (Kowalevski(), GEN, np.arange(101) * 0.1),
    "paper": (Kowalevski(), PAPER, np.arange(0, 17) * 1.25),
    "gen, other units": (Kowalevski(c0=-0.3, A=0.7), GEN, np.arange(0, 11) * 0.5),
    "heavy": (HEAVY, GEN, np.arange(0, 21) * 0.5),
    "free": (FREE, GEN[:3], np.arange(0, 11) * 1.0),
}


@cache
def oracle(name: str):
    top, y0, times = SCENES[name]
    return mp_orbit(top, (*y0, 0, 0, 0)[:6], times)


def ulps(states, true) -> float:
    """Largest error in ulps of the size (largest component) of each true state."""
    worst = 0.0
    for row, exactly in zip(states, true, strict=True):
        error = max(abs(mp.mpf(float(a)) - b) for a, b in zip(row, exactly[: len(row)], strict=True))
        worst = max(worst, float(error / math.ulp(float(max(map(abs, exactly))))))
    return worst


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_states_are_right_to_an_ulp(name):
    top, y0, times = SCENES[name]
    assert ulps(reference_states(top, y0, times), oracle(name)) <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value"), [("ORDER", 12), ("REACH", 5 * REACH), ("table_of", None)])
def test_error_of_a_poorer_integrator_is_detected(name, value, monkeypatch):
    """The check above can fail: a truncated series, too long a step, quotients rounded to doubles."""

    def rounded(field):
        table = table_of(field)
        table[3 + 2 * int(table[1]) + 3 :: 4] = 0.0
        return table

    top, y0, times = SCENES["heavy"]
    assert ulps(reference_states(top, y0, times), oracle("heavy")) <= 1.0
    monkeypatch.setattr(reference, name, value or rounded)
    assert ulps(reference_states(top, y0, times), oracle("heavy")) > 1.0


# ---------------------------------------------------------------- the kernel itself, in double-double


# ---------------------------------------------------------------- the loop over its steps


def test_requested_times_do_not_change_the_states(monkeypatch):
    times = np.arange(20001) * 1e-3
    whole = reference_states(Kowalevski(), PAPER, times)
    assert np.array_equal(reference_states(Kowalevski(), PAPER, times[::1000]), whole[::1000])
    assert np.array_equal(reference_states(Kowalevski(), PAPER, np.repeat(times[::5000], 2))[::2], whole[::5000])
    monkeypatch.setattr(reference, "BUDGET", 1)
    assert np.array_equal(reference_states(Kowalevski(), PAPER, times), whole)


def test_backward_is_forward_with_the_spin_reversed():
    times = np.linspace(0.0, 30.0, 50)
    mirror = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
    backward = reference_states(HEAVY, GEN, -times)
    forward = reference_states(HEAVY, tuple(mirror * GEN), times)
    assert np.array_equal(backward, forward * mirror)
    assert not np.array_equal(backward[-1], reference_states(HEAVY, GEN, times)[-1])


@pytest.mark.slow
@given(st.integers(-500, 500), st.integers(-400, 400))
def test_scaling_by_powers_of_two_is_exact(k, m):
    """omega 2^k, gamma 2^m, c0 2^(2k-m), t 2^-k is the same motion, bit for bit, at the ends of the range too."""
    unit = np.repeat((k, m), 3)
    times = np.linspace(0.0, 2.0, 5)
    plain = reference_states(Kowalevski(), GEN, times)
    if abs(2 * k - m) < 900:
        top = Kowalevski(c0=math.ldexp(1.0, 2 * k - m))
        scaled = reference_states(top, tuple(np.ldexp(GEN, unit)), np.ldexp(times, -k))
        assert np.array_equal(scaled, np.ldexp(plain, unit))


def test_extreme_states_are_followed_or_refused():
    fast = tuple(np.array(GEN) * [1e150, 1e150, 1e150, 1, 1, 1])
    states = reference_states(Kowalevski(), fast, np.linspace(0, 1e-149, 11))
    assert np.allclose((states[:, 3:] ** 2).sum(axis=1), 1.0, rtol=9e-16, atol=0)
    assert np.abs(states[-1, 3:] - states[0, 3:]).max() > 0.1
    slow = (5e-324, 0.0, 0.0, 0.6, 0.48, 0.64)
    assert np.array_equal(reference_states(Kowalevski(c0=0.0), slow, np.array([0.0, 1e9])), [slow, slow])
    rest = reference_states(Kowalevski(), (0.0,) * 6, np.array([0.0, 1.0, 1e3]))
    assert not rest.any()
    equilibrium = (2.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    assert np.array_equal(reference_states(Kowalevski(), equilibrium, np.array([1e3])), [equilibrium])


@pytest.mark.parametrize("times", [[0.0, 2.0, 1.0], [-1.0, 1.0], [-2.0, -1.0], [0.0, math.nan]])
def test_times_that_do_not_lead_away_from_zero_are_refused(times):
    with pytest.raises(ValueError, match="must lead away from zero"):
        reference_states(Kowalevski(), GEN, np.array(times))


def test_unreachable_accuracy_is_reported(monkeypatch):
    monkeypatch.setattr(NaturalUnits, "at", lambda self, y: (self.field, 0, [0] * len(y)))
    with pytest.raises(RunError, match=r"beyond t = 0: it is not finite"):
        reference_states(Kowalevski(), (1e150, *GEN[1:]), np.array([1e-150]))


# ---------------------------------------------------------------- fields of any degree

MIX = np.array([[1, 2, 0, -1, 0], [0, 1, 1, 0, 2], [0, 0, 1, 3, 0], [0, 0, 0, 1, 1], [0, 0, 0, 0, 1]])
UNMIX = np.linalg.inv(MIX).round().astype(int)
assert (np.eye(5) == MIX @ UNMIX).all()


def solved(y: Floats) -> tuple:
    """Duffing's oscillator q'' = -q - q^3, Riccati's equation, one of degree six, and a clock."""
    q, p, r, s, _ = y
    return (p, -q - q**3, 1 + r * r, s**6 / 5, 1)


def mixed_field(z: Floats, p: Floats) -> tuple:
    """The same in other coordinates, z = MIX y."""
    y = tuple(sum(int(c) * x for c, x in zip(row, z, strict=True)) for row in UNMIX)
    return tuple(sum(int(c) * x for c, x in zip(row, solved(y), strict=True)) for row in MIX)


class Mixed(Top):
    """Five known motions, mixed; degree six."""

    kind = "mixed"
    components = ("a", "b", "c", "d", "e")
    field = staticmethod(mixed_field)


def mixed_motion(t: float) -> list:
    """Closed forms; Duffing's is cn with omega^2 = 1 + q0^2 and m = q0^2/(2 omega^2), here from q0 = 1."""
    t = mp.mpf(t)
    w, m = mp.sqrt(2), mp.mpf(1) / 4
    cn, sn, dn = (mp.ellipfun(name, w * t, m=m) for name in ("cn", "sn", "dn"))
    y = (cn, -w * sn * dn, mp.tan(t), (1 - t) ** (-mp.mpf(1) / 5), t)
    return [mp.fsum(int(c) * x for c, x in zip(row, y, strict=True)) for row in MIX]


def test_a_field_of_degree_six_is_solved_to_an_ulp() -> None:
    times = np.array([0.0, 0.25, 0.5, 0.9, 0.984375])
    with mp.workdps(40):
        true = [mixed_motion(t) for t in times]
        assert ulps(reference_states(Mixed(), [float(x) for x in true[0]], times), true) <= 1.0
        assert ulps(reference_states(Mixed(), [float(x) for x in true[0]], times + 1e-15), true) > 1.0
    with pytest.raises(RunError, match=r"cannot be followed beyond t = 1: its step"):
        reference_states(Mixed(), [float(x) for x in true[0]], np.array([1.5]))
