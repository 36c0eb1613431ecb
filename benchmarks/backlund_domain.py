"""Round-off of ``backlund`` up to and beyond its longest step: largest deviations of the integrals over 1e5 steps.

    python benchmarks/backlund_domain.py                 # within the limits that the scheme declares
    python benchmarks/backlund_domain.py --reach 7       # with REACH, 5 in the scheme, set to 7

States have a random direction of gamma and a random omega, half of them of size 1, half of 0.05 to 6. A state counts as
lost if an integral deviates by more than 50 ulp sqrt(N) of the size of its terms.
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from topcli.contracts import Floats, Outcome
from topcli.engine.run import Run
from topcli.schemes.kowalevski import backlund_parameters
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski

OPTIONS: dict[str, dict[str, Any]] = {
    "frozen": {},
    "frozen, project: 16": {"project": 16},
    "compensated": {"compensated": True},
    "recomputed": {"constants": "recomputed"},
    "exact nodes": {"nodes": "exact"},
}


def random_states(count: int, seed: int) -> np.ndarray:
    """States (count, 6); every second omega has a size between 0.05 and 6."""
    random = np.random.default_rng(seed)
    gamma = random.normal(size=(count, 3))
    omega = random.normal(size=(count, 3))
    omega[::2] *= 10.0 ** random.uniform(-1.3, 0.8, size=(len(omega[::2]), 1))
    return np.hstack([omega, gamma / np.linalg.norm(gamma, axis=1, keepdims=True)])


def deviation(y0: Floats, h: float, N: int, options: dict[str, Any]) -> float:
    """Largest deviation of an integral in ulp sqrt(N) of its terms; infinite if the run ends early."""
    top, scheme = Kowalevski(), find_scheme("backlund", "kowalevski")
    _, states, ending = Run(top, scheme.build(top, scheme.options(**options)), y0, h, N, 10).collect()
    if ending.outcome is not Outcome.COMPLETED:
        return math.inf
    off = []
    for invariant in top.invariants():
        values = invariant.value(states)
        off.append(np.abs(values - values[0]).max() / invariant.scale(states).max())
    return float(max(off)) / (2.0**-52 * math.sqrt(N))


def main() -> None:
    """Print a table of options and fractions of the longest step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=200)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--reach", type=float, default=backlund_parameters.REACH)
    given = parser.parse_args()
    declared, backlund_parameters.REACH = backlund_parameters.REACH, given.reach
    states = [tuple(map(float, y)) for y in random_states(given.states, given.seed)]
    scheme = find_scheme("backlund", "kowalevski")
    print(
        f"{given.states} states, {given.steps} steps, h sqrt(2E + 2k) <= {given.reach:g} ({declared:g} in the scheme)"
    )
    print(f"{'':<22}{'h/longest':>10}{'median':>9}{'3/4':>9}{'largest':>10}{'lost':>6}")
    for name, options in OPTIONS.items():
        if name == "exact nodes" and given.reach != declared:
            continue
        assert scheme.longest_step is not None
        longest = [scheme.longest_step(Kowalevski(), y, scheme.options(**options)) for y in states]
        for fraction in (0.5, 0.8, 0.9, 1.0):
            off = [
                deviation(y, fraction * most * (1.0 - 1e-12), given.steps, options)
                for y, most in zip(states, longest, strict=True)
            ]
            lost = sum(value > 50.0 for value in off)
            middle, upper = np.quantile(off, [0.5, 0.75])
            print(f"{name:<22}{fraction:>10}{middle:>9.2g}{upper:>9.2g}{max(off):>10.2g}{lost:>6}", flush=True)


if __name__ == "__main__":
    main()
