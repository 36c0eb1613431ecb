"""Time loops: whatever way a step is iterated, it has the bits of the plain Python loop."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import random_states
from declared import SCHEMES
from topcli.contracts import Scheme, Stepper
from topcli.engine import loops
from topcli.engine.loops import Loop, interpreted, lanes_code, loop_of, more_parameters, part_steps_of, state_after
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

N, EVERY, FIRST, LANES = 60, 7, 3, 8
ONE_TOP = {scheme.name: scheme for scheme in SCHEMES if scheme.name != "bs" or scheme.top != "euler"}
STEPS = [*ONE_TOP.values(), find_scheme("bs", "euler"), find_scheme("hk", "heavy")]
STEPS += [find_scheme(f"{name}+suzuki4", "kowalevski") for name in ("hk", "hybrid-sym")]


def recorded(loop: Loop, y: np.ndarray, p: np.ndarray, h: float) -> tuple[bool, bytes, bytes]:
    """True if no step failed; working state and recorded rows. Of a failure of a plain step that raises, no rows."""
    work, out = np.zeros(loop.width), np.zeros(N * len(y))
    try:
        with np.errstate(all="ignore"):
            loop.enter(y, work, p, h)
            taken = loop.take_steps(work, out, p, h, N, EVERY, FIRST)
    except (ArithmeticError, ValueError):
        return False, b"", b""
    return taken == N, work.tobytes() if taken == N else str(taken).encode(), out.tobytes()


def side_by_side(method: Stepper, y: np.ndarray, p: np.ndarray, h: float) -> list[tuple[bool, bytes, bytes]]:
    """Of each lane, True if no step failed or took a rare branch; the working state and the rows."""
    work, out = np.zeros((method.width + 1, LANES)), np.zeros((LANES, N, y.shape[1]))
    enter = interpreted(method, y.shape[1], len(p)).enter
    for j in range(LANES):
        enter(y[j], start := np.zeros(method.width), p, h)
        work[:-1, j] = start
    params = np.array([*p, *more_parameters(method)])
    lanes_code(method, y.shape[1], len(p), LANES)(work, out, params, h, N, EVERY, FIRST, N * y.shape[1])
    return [(bool(np.isfinite(work[-1, j])), work[:-1, j].tobytes(), out[j].tobytes()) for j in range(LANES)]


@pytest.mark.slow
@pytest.mark.parametrize("scheme", STEPS, ids=lambda one: f"{one.name}/{one.top}")
def test_every_loop_has_the_bits_of_the_plain_loop(scheme: Scheme, monkeypatch: pytest.MonkeyPatch) -> None:
    """Single runs, lanes and parts of steps, also where steps fail."""
    top = TOPS[scheme.top]()
    method, p, d = scheme.build(top, scheme.options()), np.array(top.constants()), len(top.components)
    if not isinstance(method, Stepper) or method.plain:
        return
    y, theta = random_states(LANES + 2, 5)[2:, :d].copy(), np.linspace(0.0, 1.0, LANES)
    plain, compiled = interpreted(method, d, len(p)), loop_of(method, d, len(p))
    monkeypatch.setattr(loops, "state_after", lambda *_: pytest.fail("parts of steps are not compiled"))
    for h in (0.02, 1.7):
        for state, (usual, *lane) in zip(y, side_by_side(method, y, p, h), strict=True):
            expected, single = recorded(plain, state, p, h), recorded(compiled, state, p, h)
            assert single == expected or expected == (single[0], b"", b"") == (False, b"", b"")
            assert lane == [*single[1:]] or not usual
            assert single[0] or not usual
        parts = part_steps_of(method, top, h)(y, np.zeros(LANES, dtype=np.int64), y, theta)
        for state, part, end in zip(y, theta, parts, strict=True):
            after = state_after(plain, state, p, part * h)
            assert np.isnan(end).all() if after is None else np.array_equal(after, end)
