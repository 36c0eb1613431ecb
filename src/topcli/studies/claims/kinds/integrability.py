"""Signs of integrability (growth of numbers, separation of neighbours, content of a spectrum); the choice of roots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from topcli.analysis.isospectral import spectral_content
from topcli.analysis.lax import block_form, kowalevski_form
from topcli.contracts import checked_equations
from topcli.engine.precise.loop import longest
from topcli.schemes.kowalevski.bohlin import direct
from topcli.studies.claims.claim import Bound, Finding, Kind
from topcli.studies.claims.scenes import RATIONAL, Scene, exact_map, trajectory
from topcli.studies.simulate_ensemble import simulate_ensemble
from topcli.tops import TOPS

GROWTH_STEPS = 5
GENERIC = ("initial.omega=[0.7, -0.4, 1.3]", "initial.gamma=[0.6, 0.48, 0.64]")
"""State in general position, whose decimals are rational numbers."""


def digits_grow(scene: Scene) -> Finding:
    """Growth of the length of rational numbers in the last step of an orbit."""
    found = exact_map(scene)
    states = found.orbit(found.y0, found.run.h, GROWTH_STEPS)
    before, last = (longest(state) for state in states[-2:])
    least = 2.0 * (GROWTH_STEPS / (GROWTH_STEPS - 1)) ** 2
    reason = "twice the factor of quadratic growth, that of integrable maps"
    return Finding(last / before, Bound(least, reason=reason), note=f"{last} bits after {GROWTH_STEPS} steps")


NEAR = 1e-9


def neighbours_part(scene: Scene) -> Finding:
    """Decades by which two neighbouring motions part over a run."""
    experiment = scene.experiment()
    y0 = list(experiment.y0)
    y0[0] += NEAR
    vectors = {name: y0[slice(*span)] for name, span in experiment.top.vectors.items()}
    other = scene.with_sets(*(f"initial.{name}={value!r}" for name, value in vectors.items()))
    a, b = trajectory(scene), trajectory(other)
    figure = math.log10(float(np.abs(a.states[-1] - b.states[-1]).max()) / NEAR)
    reason = "neighbours on an integrable motion part in proportion to t; 100 t is allowed"
    return Finding(figure, Bound(math.log10(experiment.duration) + 2.0, reason=reason, unit="decades"))


def carries_too_little(top: str, form: str) -> Finding:
    """Number of independent integrals in the spectrum of a Lax form."""
    made: Any = TOPS[top].new()
    equations = checked_equations(made, "the ledger")
    lax = {"block": block_form, "kowalevski": kowalevski_form}[form](equations)
    content = spectral_content(lax, made.invariants(), len(made.components))
    symbols = {invariant.name: invariant.symbol for invariant in made.invariants()}
    bound = Bound(0.0, 3.0, "an integrable motion of omega and gamma needs 4 integrals", "integrals")
    return Finding(
        float(content.independent), bound, note="carries " + ", ".join(symbols[name] for name in content.carries)
    )


def wrong_roots(config: str, changes: Mapping[str, Any]) -> Finding:
    """Number of orbits on which a step takes the root farther from its prediction."""
    found = simulate_ensemble(config, **changes)
    wrong = 0
    for index in range(len(found)):
        run = found.trajectory(index)
        old, new = run.states[:-1].T, run.states[1:].T
        x, y = direct(tuple(old), run.h, run.top.constants())
        # the other root, minus this one, is nearer to the prediction where their scalar product is negative
        wrong += bool((new[0] * x + new[1] * y < 0.0).any())
    bound = Bound(0.0, 0.0, "the right root is the nearer one", f"of {len(found)} orbits")
    return Finding(float(wrong), bound)


BY_SIGN: dict[str, Any] = {
    "h": 0.05,
    "N": 2000,
    "scheme": {"name": "bohlin-a", "branch": "sign"},
    "ensemble": {
        "random": {"count": 200, "seed": 1, "gamma": "sphere", "omega": {"energy": 5.0}},
        "store": "trajectories",
    },
}
CROSSING: dict[str, Any] = {
    "ensemble": {
        "states": [{"omega": [-0.8, 1e-3 * k, 0.5], "gamma": [0.6, -0.48, -0.64]} for k in range(40)],
        "store": "trajectories",
    },
    "h": 0.2,
    "N": 2,
}
"""Orbits whose omega_1 + i omega_2 crosses the negative real axis, where the argument jumps."""
DIGITS_GROW = Kind(
    "growth of numbers",
    f"factor by which rational numbers become longer in step {GROWTH_STEPS}",
    "HK of the Euler top, an integrable map",
    lambda: digits_grow(Scene("euler_hk", RATIONAL)),
)
NEIGHBOURS = Kind(
    "neighbours part",
    "decades by which motions 1e-9 apart have parted at the end of the run",
    "the Lagrange top, integrable",
    lambda: neighbours_part(Scene("lagrange_taylor", ("N=5000",))),
)
SPECTRUM = Kind(
    "content of a spectrum",
    "number of independent integrals among the traces of powers of L",
    "the 5x5 Lax pair of the Kowalevski top",
    lambda: carries_too_little("kowalevski", "kowalevski"),
)
ROOTS = Kind(
    "choice of the root",
    "number of random orbits on which a step takes the root farther from its prediction",
    "40 states whose omega crosses the negative real axis, under the choice by sign",
    lambda: wrong_roots("kowalevski_bohlin_a", BY_SIGN | CROSSING),
)
