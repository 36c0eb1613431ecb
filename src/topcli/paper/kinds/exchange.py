"""Symmetry of one printed equation under the exchange of old and new state with h -> -h, with 50 digits."""

from __future__ import annotations

from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import Gauss
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.kinds.integrability import GENERIC
from topcli.paper.scenes import DIGITS, FIFTY, ExactMap, Scene, exact_maps


def _residual(found: ExactMap, equation: str, h: Any, old: tuple[Any, ...], new: tuple[Any, ...]) -> float:
    """Largest residual of ``bohlin``, the equation for xi, or ``method-a``, that for gamma."""
    if equation == "method-a":
        return max(float(abs(x)) for x in printed.bs(h, old[3:], new[3:], old[:3]))
    functions = found.run.arithmetic.math
    chi = h / 2 * (new[2] + old[2])
    turn = Gauss(functions.cos(chi), -functions.sin(chi))
    c0 = found.run.top.constants()[0]
    left = printed.bohlin(c0, turn, old, new)
    return float(abs(left.re) + abs(left.im))


def exchanged(scene: Scene, equation: str) -> Finding:
    """Largest residual of an equation after steps of a scheme and its variants, also exchanged and with h reversed."""
    largest, maps = 0.0, exact_maps(scene)
    for found in maps:
        old = tuple(found.y0)
        new = tuple(found.step(old, found.run.h))
        with found.run.arithmetic.active():
            there = _residual(found, equation, found.run.h, old, new)
            largest = max(largest, there, _residual(found, equation, -found.run.h, new, old))
    return Finding(largest, Bound(0.0, 1000.0 * maps[0].eps, f"rounding with {DIGITS} digits"))


EXCHANGE = Kind(
    "symmetric equation",
    "residual of the equation with its states exchanged and h reversed, with 50 digits",
    "(A), the equation for gamma",
    lambda: exchanged(Scene("kowalevski_bohlin_a", (*FIFTY, "N=1", *GENERIC)), "method-a"),
)
