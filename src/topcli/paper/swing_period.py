"""Period of the paper's Figures 1 and 2 by order and symmetry of the scheme: the data of the figure ``period``.

The scene lies at the distance eps = 1e-3 from a homoclinic orbit, and the time between swings there is
2 sqrt 2 ln(8 sqrt 7/eps). The error of a scheme acts like a larger eps, of the size of sqrt(h) for Bohlin's method A,
which is of order 1. Whether a scheme is reversible makes no difference: RK2, RK4 and the hybrid are not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from topcli.analysis.swings import minima_times, swing_spacing
from topcli.contracts import Array

if TYPE_CHECKING:
    from topcli.config.models import Experiment

SCENE = "kowalevski_hk"
EPS = 1e-3
"""Distance of the scene from the homoclinic orbit, gamma_3(0)."""
TIME = 50.0
SAMPLING = 0.01
"""Longest time between two recorded states."""
PAPER_STEP = 1e-3


@dataclass(frozen=True)
class Scheme:
    """A scheme of the figure, its order, its symmetry, and the exponents k of the steps 10^k."""

    name: str
    order: int
    reversible: bool
    exponents: tuple[float, ...]


_USUAL = (-1.0, -1.5, -2.0, -2.5, -3.0, -3.5, -4.0)
SCHEMES = (
    Scheme("hk", 2, True, _USUAL),
    Scheme("rk2", 2, False, _USUAL),
    Scheme("rk4", 4, False, _USUAL),
    Scheme("hybrid", 2, False, _USUAL),
    Scheme("bohlin-a", 1, False, (-2.0, -2.5, -3.0, -3.5, -4.0, -4.5, -5.0, -5.5, -6.0, -7.0)),
)
EXACT = "exact"
SHOWN: tuple[tuple[str, float], ...] = (
    (EXACT, PAPER_STEP),
    *((scheme.name, PAPER_STEP) for scheme in SCHEMES),
    ("bohlin-a", 1e-5),
    ("bohlin-a", 1e-7),
)
"""Motions that are shown: scheme and step."""


def spacing_law(eps: Array) -> Array:
    """Time between swings of the motion at the distances ``eps`` (m,) from the homoclinic orbit, to leading order."""
    return 2.0 * np.sqrt(2.0) * np.log(8.0 * np.sqrt(7.0) / eps)


def motion_column(name: str, h: float) -> str:
    """Name of the column of gamma_1 under a scheme with the step ``h``."""
    return f"gamma1:{name}:{h:.0e}"


def _steps() -> list[tuple[str, int]]:
    """Every run: name of the scheme and number of steps."""
    pairs = [(scheme.name, 10.0**k) for scheme in SCHEMES for k in scheme.exponents]
    return list(dict.fromkeys((name, round(TIME / h)) for name, h in (*SHOWN, *pairs)))


def _experiment(name: str) -> Experiment:
    from topcli.config.load import load_experiment
    from topcli.studies.entries import under_scheme

    return under_scheme(load_experiment(SCENE), name)


def _gamma1(experiment: Experiment, N: int) -> tuple[Array, Array]:
    """Times and gamma_1 of a run in N steps, each (m,)."""
    from topcli.engine.loop import Run

    h = TIME / N
    run = Run(experiment.top, experiment.method(), experiment.y0, h, N, max(1, round(SAMPLING / h)))
    numbers, values = zip(*((chunk.n, chunk.states[:, 3].copy()) for chunk in run), strict=True)
    return np.concatenate(numbers) * h, np.concatenate(values)


def period_columns(on_progress: Callable[[int, int], None] = lambda done, total: None) -> Mapping[str, Array]:
    """Columns of the figure.

    ``t`` and ``gamma1:<scheme>:<h>`` of the motions shown, ``swings``, the times of the minima of the first of them,
    and for each scheme ``h:<scheme>`` and ``spacing:<scheme>``.
    """
    todo = _steps()
    total = sum(N for _, N in todo)
    done, found = 0, {}
    for name, N in todo:
        found[name, N] = _gamma1(_experiment(name), N)
        done += N
        on_progress(done, total)
    columns: dict[str, Array] = {"t": SAMPLING * np.arange(round(TIME / SAMPLING) + 1)}
    for name, h in SHOWN:
        columns[motion_column(name, h)] = np.interp(columns["t"], *found[name, round(TIME / h)])
    columns["swings"] = minima_times(*found[EXACT, round(TIME / PAPER_STEP)])
    for scheme in SCHEMES:
        runs = {N: run for (name, N), run in found.items() if name == scheme.name}
        spacings = {N: swing_spacing(*run) for N, run in sorted(runs.items())}
        columns[f"h:{scheme.name}"] = np.array([TIME / N for N in spacings])
        columns[f"spacing:{scheme.name}"] = np.array([np.nan if s is None else s for s in spacings.values()])
    return columns


def period_code() -> str:
    """Digest of everything that the columns depend on; equal digests mean equal columns."""
    from topcli.engine.fingerprint import fingerprint
    from topcli.runs.identity import method_fingerprint

    names = dict.fromkeys(name for name, _ in _steps())
    digests = [method_fingerprint(one.method()) + one.digest for one in map(_experiment, names)]
    return fingerprint(_gamma1, swing_spacing, compiled=False) + "".join(digests) + repr(_steps())
