"""Signs of integrability (growth of numbers, separation of neighbours, content of a spectrum)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from topcli.analysis.isospectral import spectral_content
from topcli.analysis.lax import block_form, kowalevski_form
from topcli.contracts import checked_equations
from topcli.engine.precise.loop import longest
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.scenes import RATIONAL, Scene, exact_map, trajectory
from topcli.runs.simulate_ensemble import simulate_ensemble
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
    """Number of independent integrals in the spectrum of a Lax form, and in its block traces if it has blocks."""
    made: Any = TOPS[top].new()
    equations = checked_equations(made, "the ledger")
    lax = {"block": block_form, "kowalevski": kowalevski_form}[form](equations)
    symbols = {invariant.name: invariant.symbol for invariant in made.invariants()}
    notes, contents = [], []
    for traced in dict.fromkeys((replace(lax, blocks=1), lax)):
        contents.append(spectral_content(traced, made.invariants(), len(made.components)))
        notes.append(f"{traced.traced}: {', '.join(symbols[name] for name in contents[-1].carries)}")
    bound = Bound(0.0, 3.0, "an integrable motion of omega and gamma needs 4 integrals", "integrals")
    return Finding(float(contents[-1].independent), bound, note="; ".join(notes))


PARTING_STEPS = 2000
PAIRS = 32


def map_parts_neighbours(scheme: Any, h: float) -> Finding:
    """Largest number of decades by which neighbours part under a map, over random orbits that both complete."""
    draws = np.random.default_rng(1)
    states = []
    for _ in range(PAIRS):
        omega, gamma = draws.normal(scale=1.5, size=3), draws.normal(size=3)
        for shift in (0.0, NEAR):
            near = omega + np.array([shift, 0.0, 0.0])
            states.append({"omega": near.tolist(), "gamma": (gamma / np.linalg.norm(gamma)).tolist()})
    found = simulate_ensemble(
        "kowalevski_hk",
        scheme=scheme,
        h=h,
        N=PARTING_STEPS,
        ensemble={"states": states, "store": "trajectories"},
    )
    decades = []
    for index in range(PAIRS):
        a, b = found.trajectory(2 * index), found.trajectory(2 * index + 1)
        if len(a) == len(b) == PARTING_STEPS + 1:
            decades.append(math.log10(float(np.abs(a.states[-1] - b.states[-1]).max()) / NEAR))
    least = math.log10(PARTING_STEPS) + 2.0
    reason = "neighbours under an integrable map part in proportion to the steps n; 100 n is allowed"
    note = f"more than the bound on {sum(value > least for value in decades)} of {len(decades)} orbits"
    return Finding(max(decades), Bound(least, reason=reason, unit="decades"), note=note)


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
    "number of independent integrals among the traces of powers of L and of their blocks",
    "the 5x5 Lax pair of the Kowalevski top",
    lambda: carries_too_little("kowalevski", "kowalevski"),
)
MAP_PARTS = Kind(
    "neighbours part under a map",
    f"largest number of decades by which orbits 1e-9 apart have parted after {PARTING_STEPS} steps, over {PAIRS} pairs",
    "the integrable map backlund, h = 0.4",
    lambda: map_parts_neighbours("backlund", 0.4),
)
