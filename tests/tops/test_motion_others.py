"""Polhodes, nutations and tops without a closed form: class, periods and mean rates against quadrature and orbits."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

from cases import MOTIONS
from topcli.analysis.motion import Motion
from topcli.analysis.motion.of_top import motion_of
from topcli.analysis.reference import reference_states
from topcli.cli.running import motion as shown_motion
from topcli.contracts import Top
from topcli.errors import UsageError
from topcli.tops import TOPS
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial


def of(top: Top, *y: float) -> Motion:
    return motion_of(top, tuple(map(float, y)))


def returns(top: Top, y, time: float, columns=slice(None)) -> float:
    """Largest difference of the state after ``time``."""
    later = reference_states(top, list(map(float, y)), np.array([time]))[0]
    return float(np.abs(later - y)[columns].max())


MOMENTS = (3.0, 2.0, 1.2)


@pytest.mark.parametrize(
    ("omega", "kind"), [((1.0, 0.2, 0.5), "polhode about A"), ((0.3, 0.2, -1.0), "polhode about C")]
)
def test_polhodes_close_after_their_period(omega: tuple[float, float, float], kind: str) -> None:
    A, B, C = MOMENTS
    top = Euler(A=A, B=B, C=C)
    found = of(top, *omega)
    assert found.kind == kind
    assert returns(top, omega, found["period"]) < 1e-12
    assert returns(top, omega, 0.5 * found["period"]) > 0.1
    square = sum((a * b) ** 2 for a, b in zip(MOMENTS, omega, strict=True))
    twice = sum(a * b * b for a, b in zip(MOMENTS, omega, strict=True))
    assert found["separatrix.distance"] == pytest.approx(square / twice - B, rel=1e-12)
    assert (found["separatrix.distance"] > 0.0) == (kind == "polhode about A")


@pytest.mark.parametrize("omega", [(1.0, 0.2, 0.5), (0.3, 0.2, -1.0)])
def test_precession_about_the_momentum(omega: tuple[float, float, float]) -> None:
    """After a period of omega a direction of space normal to m has turned in the body, about m, modulo whole turns."""
    found = of(Euler(A=MOMENTS[0], B=MOMENTS[1], C=MOMENTS[2]), *omega)
    T, m = found["period"], np.multiply(MOMENTS, omega)
    start = np.cross(m, omega) / np.linalg.norm(np.cross(m, omega))
    fixed = EulerGamma(A=MOMENTS[0], B=MOMENTS[1], C=MOMENTS[2])
    end = reference_states(fixed, [*omega, *start], np.array([T]))[0, 3:]
    angle = math.atan2(np.cross(end, start) @ m / np.linalg.norm(m), end @ start)
    turned = found["frequency.precession"] * T
    assert turned > 0.5
    assert abs((turned - angle / (2.0 * math.pi) + 0.5) % 1.0 - 0.5) < 1e-9


def test_separatrix_of_the_euler_top() -> None:
    """For A, B, C = 6, 4, 3: m² = 4 m.omega if 12 a² = 3 c²."""
    top = Euler(A=6.0, B=4.0, C=3.0)
    found = of(top, 0.5, 0.25, 1.0)
    assert (found.kind, found["period"]) == ("separatrix", math.inf)
    near = of(top, 0.5, 0.25, 1.0 + 2**-30)
    assert near.kind == "polhode about C"
    assert near["period"] > 10.0
    assert of(top, 0.5, 0.25, 1.0 - 2**-30).kind == "polhode about A"


def test_symmetric_free_top() -> None:
    found = of(Euler(A=2.0, B=2.0, C=1.0), 0.7, -0.4, 1.3)
    assert found["frequency"] == pytest.approx(0.5 * 1.3 / (2 * math.pi))
    m = math.sqrt(4 * 0.49 + 4 * 0.16 + 1.69)
    assert found["frequency.precession"] == pytest.approx(m / 2.0 / (2 * math.pi))  # |m|/A
    assert "separatrix.distance" not in found


LAGRANGE = {
    "waves": (Lagrange(A=1.0, C=0.5, mu=1.0), (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)),
    "loops": (Lagrange(A=1.0, C=0.5, mu=1.0), (0.2, -1.1, 4.0, 0.6, 0.48, 0.64)),
    "below": (Lagrange(A=2.0, C=0.7, mu=-1.5), (0.3, 0.4, 2.0, -0.6, 0.0, 0.8)),
    "inertial": (LagrangeInertial(), (0.3, -0.5, 1.2, 0.6, 0.0, 0.8)),
    "long axis": (LagrangeInertial(), (0.3, -0.5, 1.2, 1.2, 0.0, 1.6)),
    "no gravity": (Lagrange(A=1.0, C=0.5, mu=0.0), (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)),
}


def by_quadrature(top: Top, y) -> tuple[float, float]:
    """Period and turns of the axis in a period, from the textbook's integrals."""
    if isinstance(top, Lagrange):
        size = math.sqrt(sum(v * v for v in y[3:]))
        A, spin, nu = top.A, top.C * y[2] / top.A, top.mu * size / top.A
        along = (y[0] * y[3] + y[1] * y[4] + top.C / A * y[2] * y[5]) / size
        e = 0.5 * (y[0] ** 2 + y[1] ** 2) + nu * y[5] / size
    else:
        nu = math.sqrt(sum(v * v for v in y[3:]))
        spin = sum(a * b for a, b in zip(y[:3], y[3:], strict=True)) / nu
        along = y[2]
        e = 0.5 * (sum(v * v for v in y[:3]) - spin**2) + y[5]
    c = y[5] / (math.sqrt(sum(v * v for v in y[3:])))
    with mpmath.workdps(30):
        q = [2 * e - along**2, 2 * along * spin - 2 * nu, -2 * e - spin**2, 2 * nu]
        while not q[-1]:
            q.pop()
        roots = [mpmath.re(z) for z in mpmath.polyroots(q, asc=True, extraprec=100) if abs(mpmath.im(z)) < 1e-15]
        low, high = max(z for z in roots if z <= c + 1e-12), min(z for z in roots if z > c + 1e-12)

        def integral(density):
            # cos(theta) = middle + half sin(phi) removes the roots at both ends
            middle, half = (low + high) / 2, (high - low) / 2
            others = [
                z for z in mpmath.polyroots(q, asc=True, extraprec=100) if min(abs(z - low), abs(z - high)) > 1e-15
            ]

            def f(phi):
                u = middle + half * mpmath.sin(phi)
                rest = abs(q[-1])
                for z in others:
                    rest *= abs(u - z)
                return density(u) / mpmath.sqrt(rest)

            return 2 * mpmath.quad(f, [-mpmath.pi / 2, 0, mpmath.pi / 2])

        period = integral(lambda u: 1)
        turns = integral(lambda u: (along - spin * u) / (1 - u * u)) / (2 * mpmath.pi)
        return float(period), float(turns)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAGRANGE)
def test_nutation_and_precession_by_quadrature(name: str) -> None:
    top, y = LAGRANGE[name]
    period, turns = by_quadrature(top, y)
    found = of(top, *y)
    assert found["period.nutation"] == pytest.approx(period, rel=1e-10)
    assert found["frequency.precession"] == pytest.approx(turns / period, rel=1e-9)
    assert found["frequency.nutation"] * found["period.nutation"] == pytest.approx(1.0)


@pytest.mark.parametrize(("spin", "stable"), [(3.999, False), (4.0, True), (4.001, True)])
def test_threshold_of_the_sleeping_top(spin: float, stable: bool) -> None:
    """(C omega3)² = 4 A mu at omega3 = 4 for A, C, mu = 1, 1/2, 1."""
    found = of(Lagrange(A=1.0, C=0.5, mu=1.0), 0.0, 0.0, spin, 0.0, 0.0, 1.0)
    assert found.kind == "sleeping"
    assert found.title.endswith(" stable") == stable
    if spin > 4.0:
        frequency = math.sqrt((0.5 * spin) ** 2 - 4.0) / (2 * math.pi)
        assert found["frequency.nutation"] == pytest.approx(frequency, rel=1e-12)


SPECIAL = MOTIONS["named motions"].strip().split("\n")


@pytest.mark.slow
@pytest.mark.parametrize("motion", SPECIAL)
def test_special_motions_are_named(motion: str) -> None:
    """By their kind, or by the beginning of their title."""
    where, _, named = motion.partition(": ")
    top, _, state = where.partition(" at ")
    form, *parameters = top.split()
    made = TOPS[form](**{key: float(value) for key, value in (one.split("=") for one in parameters)})
    found = of(made, *map(float, state.split()))
    assert found.kind == named or found.title.startswith(named)


def test_regular_precession_of_the_lagrange_top() -> None:
    top = Lagrange(A=1.0, C=0.5, mu=1.0)
    # |gamma| = 5, cos = 3/5, phi' = 5/2: ba phi' - phi'² cos = nu with ba = 7/2, nu = 5
    steady = of(top, 2.0, 0.0, 7.0, 4.0, 0.0, 3.0)
    assert steady.kind == "regular precession"
    assert steady["frequency.precession"] == pytest.approx(2.5 / (2 * math.pi), rel=1e-14)
    # close to it the small nutations have the frequency that it reports
    nearby = of(top, 2.0 + 1e-6, 0.0, 7.0, 4.0, 0.0, 3.0)
    assert nearby["frequency.nutation"] == pytest.approx(steady["frequency.nutation"], rel=1e-5)


def test_states_whose_integrals_overflow_are_refused() -> None:
    for top, y in (
        (Kowalevski(), (1e71, 0.0, 0.0, 0.6, 0.0, 0.8)),
        (Lagrange(mu=1e80), (1.0, 0.0, 1.0, 0.6, 0.0, 0.8)),
    ):
        with pytest.raises(UsageError, match="too large"):
            of(top, *y)
    assert math.isfinite(of(Kowalevski(), 1e69, 2e69, 1e69, 0.6, 0.0, 0.8)["k_sq"])


def test_an_axis_that_does_not_go_round_the_vertical_has_no_precession() -> None:
    """Without gravity it circles about m, here beside the vertical; its mean rate is zero, not a rounding error."""
    assert shown_motion("lagrange_hk", ["top.mu=0"])["frequency.precession"] == 0.0
