"""A scheme for topcli in a package of its own: Bohlin's method with gamma by the BS scheme, from plain functions."""

from __future__ import annotations

import math

import topcli
from topcli.contracts import Floats, Stepper
from topcli.kernels.fused import fma


def turned(a1: float, a2: float, a3: float, g1: float, g2: float, g3: float) -> tuple[float, float, float]:
    """Solve g' - g = (g' + g) x a for g'."""
    b1 = fma(g2, a3, -(g3 * a2))
    b2 = fma(g3, a1, -(g1 * a3))
    b3 = fma(g1, a2, -(g2 * a1))
    r = 2.0 / (fma(a1, a1, 1.0) + fma(a2, a2, a3 * a3))
    return (
        g1 + r * (b1 + fma(b2, a3, -(b3 * a2))),
        g2 + r * (b2 + fma(b3, a1, -(b1 * a3))),
        g3 + r * (b3 + fma(b1, a2, -(b2 * a1))),
    )


def rotation(chi: float) -> tuple[float, float]:
    """sin(chi) and 1 - cos(chi), by fdlibm's polynomials for a small angle."""
    t = chi * chi
    if t <= 0.6168502750680849:
        u = t * t
        low = -1.66666666666666324348e-01 + t * 8.33333333332248946124e-03
        mid = -1.98412698298579493134e-04 + t * 2.75573137070700676789e-06
        high = -2.50507602534068634195e-08 + t * 1.58969099521155010221e-10
        sine = chi * (1.0 + t * (low + u * (mid + u * high)))
        low = 4.16666666666666019037e-02 - t * 1.38888888888741095749e-03
        mid = 2.48015872894767294178e-05 - t * 2.75573143513906633035e-07
        high = 2.08757232129817482790e-09 - t * 1.13596475577881948265e-11
        return (sine, t * (0.5 - t * (low + u * (mid + u * high))))
    x = math.sqrt(t)
    half = math.sin(0.5 * x)
    return (chi * (math.sin(x) / x), t * (2.0 * half * half / t))


def nearest_root(x: float, y: float, p1: float, p2: float) -> tuple[float, float]:
    """The square root of x + i y nearest to p1 + i p2."""
    m = 0.5 * (math.sqrt(x * x + y * y) + abs(x))
    b = 0.5 * y
    ratio = b / (m + 1e-290)
    t = math.sqrt(m)
    if x >= 0.0:
        if m * p1 + b * p2 < 0.0:
            t = -t
        return (t, ratio * t)
    if b * p1 + m * p2 < 0.0:
        t = -t
    return (ratio * t, t)


def step(s: Floats, h: float, p: Floats) -> Floats:
    """One step of Bohlin's method with Method A."""
    w1, w2, w3, g1, g2, g3 = s
    c = p[0]
    d = 0.5 * h
    n1, n2, n3 = turned(d * w1, d * w2, d * w3, g1, g2, g3)
    v3 = w3 - (d * c) * (n2 + g2)
    x = (w1 - w2) * (w1 + w2) - c * g1
    y = 2.0 * w1 * w2 - c * g2
    sine, versine = rotation(d * (v3 + w3))
    dx = sine * y - versine * x
    dy = -(sine * x + versine * y)
    q1 = w1 + d * (w3 * w2)
    q2 = w2 - d * (w3 * w1 - c * g3)
    v1, v2 = nearest_root((x + dx) + c * n1, (y + dy) + c * n2, q1, q2)
    return (v1, v2, v3, n1, n2, n3)


@topcli.scheme(
    "example-bohlin-a",
    top="kowalevski",
    title="Bohlin A from a package of its own",
    order=1,
    explicit=True,
    self_adjoint=False,
    conserves=("gamma_sq", "k_sq"),
    citation="Sogo, Discrete Spinning Tops, section 3.2.2",
    equations="(A), Kxi, direct",
)
def build(top: object, options: object) -> Stepper:
    """Gamma by Cayley's rotation, omega by Bohlin's method, on the branch nearest to the prediction."""
    return Stepper(step, 6)
