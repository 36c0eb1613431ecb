"""Energy of several schemes over a long time, the figure ``integrable``.

Two scenes with the same step for all schemes. An integrable or canonical map keeps the energy, or a function near it,
over very long times; what remains is an oscillation that does not grow. A scheme that conserves the energy exactly
shows the growth of round-off instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from topcli.analysis.columns import energy_of
from topcli.config.load import load_experiment
from topcli.contracts import Array
from topcli.engine.fingerprint import fingerprint
from topcli.engine.loop import Run
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, Line, Panel
from topcli.runs.identity import method_fingerprint
from topcli.studies.entries import under_scheme

if TYPE_CHECKING:
    from topcli.config.models import Experiment

STEPS = 1 << 20
SIZES = {"kowalevski_generic_hk": 0.05, "euler_hk": 0.05}
"""Step of each scene."""
SCHEMES = {
    "kowalevski_generic_hk": ("splitting", "dmv", "hk", "midpoint4", "rk4"),
    "euler_hk": ("splitting", "dmv", "hk", "midpoint", "rk4"),
}
"""Schemes of each scene; the last one is the control, whose energy drifts."""


def _experiments() -> dict[str, Experiment]:
    """Experiment of each curve, by the name of its column."""
    return {
        f"{scene}:{name}": under_scheme(load_experiment(scene, [f"h={SIZES[scene]}"]), name, None)
        for scene, names in SCHEMES.items()
        for name in names
    }


def largest_by_octave(times: Array, values: Array) -> Array:
    """Largest of ``values`` (m,) from the start of each octave of steps to its end.

    ``times`` (m,) are numbers of steps from 1; octave k has those from 2**k to 2**(k + 1) - 1.
    """
    octaves = np.log2(times).astype(int)
    starts = np.flatnonzero(np.diff(octaves, prepend=-1))
    return np.maximum.reduceat(values, starts)


def _energy_errors(experiment: Experiment) -> Array:
    """Largest deviation of the energy in each octave, relative to the size of its terms at the start."""
    top, found, numbers = experiment.top, [], []
    energy = energy_of(top)
    assert energy is not None
    first = np.array([experiment.y0])
    start, scale = float(energy.value(first)[0]), float(energy.scale(first)[0])
    for chunk in Run(top, experiment.method(), experiment.y0, experiment.h, STEPS - 1):
        taken = chunk.n > 0
        numbers.append(chunk.n[taken].astype(float))
        found.append(np.abs(energy.value(chunk.states[taken]) - start) / scale)
    return largest_by_octave(np.concatenate(numbers), np.concatenate(found))


def energy_columns() -> Mapping[str, Array]:
    """Columns of the figure: times ``t:<scene>`` of the ends of octaves, and the energy errors of each curve."""
    ends = 2.0 ** np.arange(1, int(np.log2(STEPS)) + 1)
    columns: dict[str, Array] = {f"t:{scene}": h * ends for scene, h in SIZES.items()}
    for name, experiment in _experiments().items():
        errors = _energy_errors(experiment)
        columns[name] = np.where(errors > 0.0, errors, np.nan)  # a logarithmic axis has no zero
    return columns


def energy_code() -> str:
    """Digest of everything that the columns depend on; equal digests mean equal columns."""
    digests = [method_fingerprint(one.method()) + one.digest for one in _experiments().values()]
    return fingerprint(_energy_errors, compiled=False) + "".join(digests) + f"{STEPS}"


TITLES = {"kowalevski_generic_hk": "(a) Kowalevski top, $h = 0.05$", "euler_hk": "(b) Euler top, $h = 0.05$"}
PANELS = tuple(
    Panel(
        tuple(Line(f"{scene}:{name}", name) for name in SCHEMES[scene]),
        "energy error, relative",
        x=f"t:{scene}",
        xlog=True,
        log=True,
        title=title,
    )
    for scene, title in TITLES.items()
)


def load_long_energy(request: Request) -> Loaded:
    """Load the energy errors of the schemes, one panel for each scene."""
    return Loaded(PANELS, energy_columns, {"study": energy_code()}, Grid(figsize=(7.0, 3.2)))
