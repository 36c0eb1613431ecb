"""A self-adjoint scheme of the Kowalevski top written for the tests of compositions."""

from __future__ import annotations

from dataclasses import replace

from topcli.arithmetic.vectors import cayley_increment
from topcli.contracts import Floats, NoOptions, Stepper
from topcli.schemes.registry import find_scheme


def kick_turn_step(s: Floats, h: float, p: Floats) -> Floats:
    """Half of gamma's turn about a fixed omega, omega under a fixed gamma, the other half of the turn; and a count.

    Order 2, its own inverse under h -> -h; conserves gamma² and no other integral.
    """
    w1, w2, w3, g1, g2, g3, count = s
    q = 0.25 * h
    d1, d2, d3 = cayley_increment(q * w1, q * w2, q * w3, g1, g2, g3)
    g1, g2, g3 = g1 + d1, g2 + d2, g3 + d3
    w3 = w3 - (0.5 * h) * (p[0] * g2)
    a = q * w3
    f = (0.5 * h) * (p[0] * g3)
    b1, b2 = w1 + a * w2, w2 - a * w1 + f
    r = 1.0 / (1.0 + a * a)
    w1, w2 = r * (b1 + a * b2), r * (b2 - a * b1)
    w3 = w3 - (0.5 * h) * (p[0] * g2)
    d1, d2, d3 = cayley_increment(q * w1, q * w2, q * w3, g1, g2, g3)
    return (w1, w2, w3, g1 + d1, g2 + d2, g3 + d3, count + 1.0)


def enter_counted(y: Floats, h: float, p: Floats) -> Floats:
    """The physical state and a count of zero."""
    return (y[0], y[1], y[2], y[3], y[4], y[5], 0.0)


def leave_counted(s: Floats, h: float, p: Floats) -> Floats:
    """The physical state."""
    return (s[0], s[1], s[2], s[3], s[4], s[5])


KICK_TURN = Stepper(kick_turn_step, 7, enter_counted, leave_counted, ("stages",))
SPLIT = replace(
    find_scheme("hk", "kowalevski"),
    name="kick-turn",
    conserves=("gamma_sq",),
    build=lambda top, options: KICK_TURN,
    options=NoOptions,
    modified=None,
    doc="A turn between kicks.",
)
"""The scheme with this step, which is not topcli's own."""
