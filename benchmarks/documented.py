"""Numbers on the Kowalevski top that the documentation states, measured: medians and quartiles over starts.

    python benchmarks/documented.py            # all
    python benchmarks/documented.py lost ratio compensated

- ``lost``: the step at which HK with h = 1 leaves the energy surface, from starts that differ by 1e-13;
- ``ratio``: the errors of HK and of splitting over that of backlund at the same step;
- ``compensated``: deviations of the integrals after 1e6 steps of backlund, plain over compensated.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from topcli.analysis.leaving import step_of_leaving
from topcli.analysis.reference import reference_states
from topcli.contracts import Array, Floats
from topcli.engine.run import Run
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski

TOP = Kowalevski()
GENERIC = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
"""The state of ``kowalevski_generic_backlund``, the scene of the figure ``torus-points``."""


def random_states(count: int, seed: int) -> list[Floats]:
    """States with a random direction of gamma and omega of size 1."""
    random = np.random.default_rng(seed)
    gamma = random.normal(size=(count, 3))
    gamma /= np.linalg.norm(gamma, axis=1, keepdims=True)
    return [tuple(map(float, y)) for y in np.hstack([random.normal(size=(count, 3)), gamma])]


def states_of(name: str, y0: Floats, h: float, N: int, every: int, **options: Any) -> tuple[Any, Array]:
    """Step numbers and states of a run."""
    scheme = find_scheme(name, "kowalevski")
    recorded = Run(TOP, scheme.build(TOP, scheme.options(**options)), y0, h, N, every).collect()
    return recorded.n, recorded.states


def deviation(states: Array) -> float:
    """Largest deviation of an integral relative to the size of its terms."""
    off = []
    for invariant in TOP.invariants():
        values = invariant.value(states)
        off.append(float(np.abs(values - values[0]).max() / invariant.scale(states).max()))
    return max(off)


def show(what: str, values: Sequence[float]) -> None:
    """Print the extremes, the quartiles and the number of values."""
    low, first, middle, third, high = np.quantile(values, [0.0, 0.25, 0.5, 0.75, 1.0])
    print(
        f"{what:<44} median {middle:.4g}, quartiles {first:.4g} to {third:.4g}, {low:.4g} to {high:.4g}; {len(values)}"
    )


def lost(starts: int = 40) -> None:
    """Steps of HK with h = 1 until it leaves its energy surface."""
    random, steps = np.random.default_rng(1), []
    for start in range(starts):
        y = tuple(v + 1e-13 * float(off) for v, off in zip(GENERIC, random.normal(size=6) * (start > 0), strict=True))
        n, states = states_of("hk", y, 1.0, 1_000_000, 1)
        left = step_of_leaving(TOP, n, states)
        steps.append(len(n) if left is None else left)
    print(f"hk, h = 1, unperturbed: lost at step {steps[0]}")
    show("hk, h = 1, lost at step", steps[1:])


def ratio(count: int = 60, t: float = 10.0) -> None:
    """Largest errors up to t of HK and splitting relative to that of backlund."""
    for h in (0.1, 0.05, 0.025):
        N, found = round(t / h), {"hk": [], "splitting": []}
        every = round(0.5 / h)
        for y in random_states(count, 2):
            expected = reference_states(TOP, y, np.arange(0.5, t + 0.25, 0.5))
            error = {
                name: float(np.linalg.norm(states_of(name, y, h, N, every)[1][1:] - expected, axis=1).max())
                for name in ("backlund", *found)
            }
            for name, values in found.items():
                values.append(error[name] / error["backlund"])
        for name, values in found.items():
            show(f"h = {h}: error of {name} over that of backlund", values)


def compensated(count: int = 20, N: int = 1_000_000) -> None:
    """Deviations of the integrals, plain over compensated."""
    for h in (0.01, 0.1, 0.5):
        gains = []
        for y in random_states(count, 3):
            plain, better = (
                deviation(states_of("backlund", y, h, N, 1000, compensated=value)[1]) for value in (False, True)
            )
            gains.append(plain / better)
        show(f"h = {h}, {N} steps: plain over compensated", gains)


MEASUREMENTS: dict[str, Callable[[], None]] = {"lost": lost, "ratio": ratio, "compensated": compensated}

if __name__ == "__main__":
    for chosen in sys.argv[1:] or MEASUREMENTS:
        MEASUREMENTS[chosen]()
