"""Points of two maps with a long step and the torus of the motion: the data of the figure ``torus-points``."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from topcli.analysis.leaving import step_of_leaving
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.engine.fingerprint import fingerprint
from topcli.engine.loop import Run
from topcli.runs.identity import method_fingerprint
from topcli.studies.entries import under_scheme

SCENE = "kowalevski_generic_backlund"
POINTS = 1_000_000
SCHEMES = ("backlund", "hk")
FLOW = "taylor"
FLOW_STEP, FLOW_STEPS = 0.02, 500_000
SEEN = (0, 1, 5)
"""Components of the state that are seen: omega1, omega2, gamma3, in which the torus does not meet itself."""
CUT, SECTION = 0, (1, 4)
"""The section is at omega1 = 0; omega2 and gamma2 are shown."""
THICKNESS = 0.01
"""Largest ``abs(omega1)`` of a point of a map on the section."""


def _experiment(scheme: str) -> Experiment:
    return under_scheme(load_experiment(SCENE), scheme, None)


def orbit(experiment: Experiment, steps: int, h: float) -> Array:
    """States (m, d) after up to ``steps`` steps of ``h``, without those after the energy surface is left."""
    recorded = Run(experiment.top, experiment.method(), experiment.y0, h, steps).collect()
    left = step_of_leaving(experiment.top, recorded.n, recorded.states)
    return recorded.states[:left]


def crossings(states: Array, rates: Array, h: float) -> Array:
    """States (m, d) of a motion where omega1 = 0, from samples ``h`` apart and their rates of change, both (n, d).

    Between two samples the motion is Hermite's cubic; its zero is found by bisection.
    """
    before = np.flatnonzero(np.signbit(states[:-1, CUT]) != np.signbit(states[1:, CUT]))
    a, b = states[before], states[before + 1]
    p, q = h * rates[before], h * rates[before + 1]

    def at(s: Array) -> Array:
        s = s[:, None]
        return a + s * (p + s * ((3.0 * (b - a) - 2.0 * p - q) + s * (2.0 * (a - b) + p + q)))

    low, high = np.zeros(len(before)), np.ones(len(before))
    for _ in range(50):
        middle = 0.5 * (low + high)
        same = np.signbit(at(middle)[:, CUT]) == np.signbit(a[:, CUT])
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return at(0.5 * (low + high))


def torus_columns() -> Mapping[str, Array]:
    """Columns of the figure.

    ``<scheme>:x``, ``:y`` and ``:z`` are the points as they are seen, ``<scheme>:u`` and ``:v`` those on the section,
    and ``flow:u`` and ``flow:v`` the motion on the section.
    """
    columns: dict[str, Array] = {}
    for name in SCHEMES:
        experiment = _experiment(name)
        states = orbit(experiment, POINTS - 1, experiment.h)
        near = states[np.abs(states[:, CUT]) < THICKNESS]
        columns |= {f"{name}:{axis}": states[:, i].astype(np.float32) for axis, i in zip("xyz", SEEN, strict=True)}
        columns |= {f"{name}:{axis}": near[:, i].astype(np.float32) for axis, i in zip("uv", SECTION, strict=True)}
    experiment = _experiment(FLOW)
    states = orbit(experiment, FLOW_STEPS, FLOW_STEP)
    p = experiment.top.constants()
    rates = np.array(type(experiment.top).field(tuple(states.T), p)).T  # the field is arithmetic: it takes arrays
    on_cut = crossings(states, rates, FLOW_STEP)
    columns |= {f"flow:{axis}": on_cut[:, i].astype(np.float32) for axis, i in zip("uv", SECTION, strict=True)}
    return columns


def torus_code() -> str:
    """Digest of everything that the columns depend on; equal digests mean equal columns."""
    made = [_experiment(name) for name in (*SCHEMES, FLOW)]
    digests = [method_fingerprint(one.method()) + one.digest for one in made]
    settings = [POINTS, FLOW_STEP, FLOW_STEPS, SEEN, CUT, SECTION, THICKNESS]
    return fingerprint(orbit, crossings, compiled=False) + "".join(digests) + repr(settings)
