"""Results of studies that take minutes, made up in their typical magnitudes: enough to lay out the figures of them."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from drawn_artists import drawn
from topcli.figures import period
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Loaded, Request
from topcli.figures.growth import SCHEMES

ORDERS = {"bohlin-a": 1, "bohlin-b": 1, "bohlin-c": 1, "rk4": 4, "hk+kahan-li6": 6, "hk+kahan-li8": 8}


def size(scheme: str, h: float) -> float:
    """An error of the scheme's order down to a plateau; each scheme has its own factor."""
    exact = scheme in ("taylor", "exact", "dop853")
    factor = 1.0 + zlib.crc32(scheme.encode()) % 1009 / 60.0
    return max(0.0 if exact else factor * h ** ORDERS.get(scheme, 2), 1e-15 * factor)


TIMES = 0.1 * 2.0 ** np.arange(20)


def energies(scene: str, scheme: str) -> np.ndarray:
    """Energy errors that differ between schemes and scenes."""
    return len(scene) * size(scheme, 0.05) * TIMES**0.1


def _energies(patch: pytest.MonkeyPatch, folder: Path) -> None:
    data = {f"t:{scene}": TIMES for scene in SCHEMES}
    data |= {f"{scene}:{name}": energies(scene, name) for scene, names in SCHEMES.items() for name in names}
    patch.setattr("topcli.figures.growth.energy_columns", lambda: data)


PEERS = ("scipy dop853", "scipy dop853 numba", "heyoka", "heyoka high-accuracy", "diffrax Dopri8", "diffrax Tsit5")
SET_UP = "backlund:nodes=exact"
LONGEST = "dmv:moments=preprocessed,order=10"
OURS = (SET_UP, "taylor", "rk4", "hk+kahan-li6", "hk+kahan-li8", LONGEST, "splitting+kahan-li8")
TITLES = ("Kowalevski top, generic", "Kowalevski top, near the homoclinic orbit", "Euler top", "Lagrange top")


def benched(name: str) -> list[tuple[float, float]]:
    """Errors and seconds of a competitor, the more accurate the later."""
    i = (*OURS, *PEERS).index(name)
    errors = [10.0 ** (-k - 0.1 * i) for k in range(1, 12)]
    return [(error, (1.0 + i) * 1e-6 * error**-0.1) for error in errors]


def _benches(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Results of which each competitor has two points that are not drawn: too inaccurate, and beaten in both."""

    def points(name: str) -> list[dict[str, Any]]:
        rest = {"value": 0.1, "drift": 0.0, "quartiles": [1.0, 2.0], "invariants": {}}
        found = [*benched(name), (3.0, 1e-9), (0.2, 1.0)]
        return [{"error": e, "seconds": seconds, "final_error": e / 7.0, **rest} for e, seconds in found]

    competitors = [
        {"name": name, "kind": "peer" if name in PEERS else "topcli", "parameter": "h", "points": points(name)}
        | {"setup_seconds": 5e-3 if name == SET_UP else 0.0}
        for name in (*OURS, *PEERS)
    ]
    run = SimpleNamespace(manifest=dict.fromkeys(("name", "digest", "code", "ended"), ""))
    reports = [{"name": title, "title": title, "competitors": competitors} for title in TITLES]
    patch.setattr("topcli.figures.comparison.stored_benches", lambda out: [(run, one) for one in reports])


def spacings(name: str, sizes: np.ndarray) -> np.ndarray:
    """Times between swings for step ``sizes``, other ones for each scheme."""
    slope = 1.4 if name == "bohlin-a" else 0.1 + 0.001 * len(name)
    return 28.17 - slope * np.log(sizes / sizes[0])


def _period(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Motions that swing at 14 and 42; spacings that fall with ln h from those of the law."""
    t, sizes = np.linspace(0.0, 50.0, 1001), 10.0 ** np.arange(-7.0, 0.0)

    def columns(on_progress: object) -> dict[str, np.ndarray]:
        data = {"t": t, "swings": np.array([14.0, 42.0, np.nan])}  # of the same length in the file
        motions = (period.motion_column(name, h) for name, h in period.SHOWN)
        data |= {name: 1.0 - (2.0 - 0.01 * i) / np.cosh((t - 14.0) % 28.0) for i, name in enumerate(motions)}
        for name in (scheme.name for scheme in period.SCHEMES):
            data |= {f"h:{name}": sizes, f"spacing:{name}": spacings(name, sizes)}
        return data

    patch.setattr("topcli.figures.period.period_columns", columns)


PREPARE: dict[str, Callable[[pytest.MonkeyPatch, Path], None]] = {
    "period": _period,
    "long-energy": _energies,
    "work-precision": _benches,
}
"""How the results of figures are made up. Figures without an entry are made from their own results."""


def loaded_named(name: str, results: Path, patch: pytest.MonkeyPatch) -> Loaded:
    """What a figure of the catalogue loads; results that take minutes are made up."""
    if name in PREPARE:
        PREPARE[name](patch, results)
    return FIGURES[name].load(Request(results))


def figure_named(name: str, results: Path, patch: pytest.MonkeyPatch) -> Figure:
    """The figure of what it loads."""
    return drawn(loaded_named(name, results, patch))
