"""Example of a scheme in a separate package: Bohlin's method, with gamma advanced by the Bobenko-Suris (BS) scheme."""

from __future__ import annotations

import math

import topcli
from topcli.arithmetic.fused import fma
from topcli.contracts import Floats, Stepper


def rotated(a1: float, a2: float, a3: float, g1: float, g2: float, g3: float) -> tuple[float, float, float]:
    """Return the rotated vector g' that solves g' - g = (g' + g) x a."""
    b1 = fma(g2, a3, -(g3 * a2))
    b2 = fma(g3, a1, -(g1 * a3))
    b3 = fma(g1, a2, -(g2 * a1))
    r = 2.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3))
    return (
        fma(r, b1 + fma(b2, a3, -(b3 * a2)), g1),
        fma(r, b2 + fma(b3, a1, -(b1 * a3)), g2),
        fma(r, b3 + fma(b1, a2, -(b2 * a1)), g3),
    )


def sinc_cosc(t: float) -> tuple[float, float]:
    """Return sin(x)/x and (1 - cos(x))/x**2 for t = x**2; for small x, by the polynomials of the library fdlibm."""
    if t <= 0.6168502750680849:
        u = t * t
        low = fma(t, 8.33333333332248946124e-03, -1.66666666666666324348e-01)
        mid = fma(t, 2.75573137070700676789e-06, -1.98412698298579493134e-04)
        high = fma(t, 1.58969099521155010221e-10, -2.50507602534068634195e-08)
        sinc = fma(t * u, fma(u, high, mid), fma(t, low, 1.0))
        low = fma(t, 1.38888888888741095749e-03, -4.16666666666666019037e-02)
        mid = fma(t, 2.75573143513906633035e-07, -2.48015872894767294178e-05)
        high = fma(t, 1.13596475577881948265e-11, -2.08757232129817482790e-09)
        return sinc, fma(t * u, fma(u, high, mid), fma(t, low, 0.5))
    x = math.sqrt(t)
    half = math.sin(0.5 * x)
    return math.sin(x) / x, 2.0 * half * half / t


def nearest_root(x: float, y: float, p1: float, p2: float) -> tuple[float, float]:
    """Return the square root of 2 (x + i y) that is nearest to p1 + i p2."""
    m = math.sqrt(x * x + y * y) + abs(x)
    ratio = y / (m + 1e-290)
    t = math.sqrt(m)
    if x >= 0.0:
        if fma(m, p1, y * p2) < 0.0:
            t = -t
        return (t, ratio * t)
    if fma(m, p2, y * p1) < 0.0:
        t = -t
    return (ratio * t, t)


def step(s: Floats, h: float, p: Floats) -> Floats:
    """Return the state after one step of Bohlin's method with Method A."""
    w1, w2, w3, g1, g2, g3 = s
    c = 0.5 * p[0]
    d = 0.5 * h
    f = h * c
    n1, n2, n3 = rotated(d * w1, d * w2, d * w3, g1, g2, g3)
    # x + i y is half of xi; a step rotates it by the angle -chi
    x = 0.5 * ((w1 - w2) * (w1 + w2)) - c * g1
    y = w1 * w2 - c * g2
    chi = fma(-(d * f), n2, fma(-(d * f), g2, h * w3))
    t = chi * chi
    sinc, cosc = sinc_cosc(t)
    q1 = w1 + d * (w3 * w2)
    q2 = w2 - d * (w3 * w1 - p[0] * g3)
    v1, v2 = nearest_root(
        fma(sinc, chi * y, fma(-cosc, t * x, fma(c, n1, x))),
        fma(-sinc, chi * x, fma(-cosc, t * y, fma(c, n2, y))),
        q1,
        q2,
    )
    return (v1, v2, fma(-f, n2 + g2, w3), n1, n2, n3)


@topcli.scheme(
    "example-bohlin-a",
    top="kowalevski",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
)
def build(top: object, options: object) -> Stepper:
    """Bohlin A from a separate package.

    The scheme advances gamma by a Cayley rotation and omega by Bohlin's method, on the branch nearest to a prediction.

    Source
    ------
    Sogo, Discrete Spinning Tops, section 3.2.2

    Equations
    ---------
    (A), Kxi, direct
    """
    return Stepper(step, 6)
