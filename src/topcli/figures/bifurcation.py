"""Bifurcation diagram of the Kowalevski top: regions and their numbers of tori, critical curves, and scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.engine.fingerprint import fingerprint
from topcli.errors import UsageError
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, Styles, caption, halo
from topcli.figures.scenes import scene_config

TINTS = ("#FFFFFF", "#DCE9F5", "#E3F0DC", "#F6EBD3", "#F5DDD9", "#E4DCEF")
"""Colours of no motion and of the regions I to V."""
NAMES = ("", "I", "II", "III", "IV", "V")
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "separatrix": ("separatrix", {"color": "0.1", "linestyle": "-", "linewidth": 1.4}),
    "pinch": ("pinch", {"color": "#B2182B", "linestyle": (0, (4, 1.5)), "linewidth": 1.6}),
    "periodic": (
        r"periodic: $E-2\ell^2=-k$",
        {"color": "#0072B2", "linestyle": (0, (7, 1.5, 1.5, 1.5)), "linewidth": 1.8},
    ),
    "delone": (r"Delone: $k=0$", {"color": "#009E73", "linestyle": "-", "linewidth": 2.6}),
    "bobylev-steklov": ("Bobylev, Steklov", {"color": "#0072B2", "linestyle": (0, (1, 1.2)), "linewidth": 1.4}),
}
"""Kinds of critical curves: labels and looks, in the order of the legend."""
PIXELS = (700, 500)
SMALL, LARGE = 0.035, 0.1
"""Radius of the largest circle in a region, relative to the panel, from which its name, and its tori, are written."""


@dataclass(frozen=True)
class Diagram:
    """Diagram in the plane of E and k² for one ``two_l``, with the motion of ``scene`` as a point.

    The columns are ``number:kind:E`` and ``number:kind:k_sq`` for the ``kinds`` of critical curves, with nan between
    their parts, and ``number:scene:E`` and ``number:scene:k_sq``. ``tori`` are the numbers of tori of the regions. By
    default the ``title`` is a letter and ``two_l``.
    """

    number: int
    two_l: float
    energies: tuple[float, float]
    k_sq: tuple[float, float]
    scene: str
    kinds: tuple[str, ...]
    tori: Mapping[str, int]
    title: str = ""

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw regions, curves and the point of the scene into ``axes``."""
        point = None
        if self.scene:
            E, k_sq = (float(data[f"{self.number}:scene:{axis}"][0]) for axis in AXES)
            point = E, k_sq
            self._mark(axes, E, k_sq)
        self._tint(axes, point)
        for kind in self.kinds:
            label, look = KINDS[kind]
            x, y = (data[f"{self.number}:{kind}:{axis}"] for axis in AXES)
            axes.plot(x, y, label=label, zorder=3 if kind == "bobylev-steklov" else 4, clip_on=False, **look)
        axes.set(xlim=self.energies, ylim=self.k_sq)
        axes.grid(False)
        caption(axes, "$E$", "$k^2$", self.title or rf"({'abcdef'[self.number]}) $2\ell = {self.two_l:.6g}$")

    def _mark(self, axes: Any, E: float, k_sq: float) -> None:
        """Draw the point of the scene and its name."""
        axes.plot([E], [k_sq], "o", color="0.05", markersize=5.0, markeredgecolor="white", zorder=6, label="_scene")
        look = {"textcoords": "offset points", "fontsize": 8, "zorder": 7, "va": "center"}
        text = axes.annotate(self.scene, (E, k_sq), xytext=(6, 0), **look)
        halo(text)

    def _tint(self, axes: Any, point: tuple[float, float] | None) -> None:
        """Tint the regions, and write their names and numbers of tori into those that are large enough."""
        from matplotlib.colors import ListedColormap

        from topcli.analysis.motion.diagram import regions

        E = _centres(*self.energies, PIXELS[0])[None, :]
        k_sq = _centres(*self.k_sq, PIXELS[1])[:, None]
        codes = regions(E, k_sq, 0.5 * self.two_l, 1.0)
        extent = (*self.energies, *self.k_sq)
        axes.imshow(
            codes, extent=extent, origin="lower", aspect="auto", cmap=ListedColormap(TINTS), vmin=-0.5, vmax=5.5
        )
        free = np.ones(codes.shape, dtype=bool)
        if point is not None:  # room for the name of the scene
            beside = point[0] - 0.05 * np.ptp(self.energies) < E
            free &= ~(beside & (np.abs(k_sq - point[1]) < 0.12 * np.ptp(self.k_sq)))
        for code, name in enumerate(NAMES[1:], 1):
            for row, column, radius in _middles(codes == code, free):
                if radius > SMALL * PIXELS[1]:
                    tori = self.tori[name]
                    label = f"{name}\n{tori} tori" if tori > 1 else f"{name}\n1 torus"
                    text = label if radius > LARGE * PIXELS[1] else name
                    at = (float(E[0, column]), float(k_sq[row, 0]))
                    axes.text(*at, text, ha="center", va="center", color="0.25", fontsize=9, zorder=5)


AXES = ("E", "k_sq")


def _centres(low: float, high: float, count: int) -> np.ndarray:
    return low + (high - low) * (np.arange(count) + 0.5) / count


def _middles(mask: np.ndarray, free: np.ndarray) -> list[tuple[int, int, float]]:
    """Row and column of the ``free`` point of each connected part of the mask that is furthest from the edges.

    The third number is its distance from them.
    """
    from scipy.ndimage import distance_transform_edt, label

    parts: Any
    parts, count = label(mask)  # type: ignore[misc]
    middles = []
    for part in range(1, count + 1):
        distance: Any = distance_transform_edt(np.pad((parts == part) & free, 1))
        row, column = np.unravel_index(int(np.argmax(distance)), distance.shape)
        middles.append((int(row) - 1, int(column) - 1, float(distance[row, column])))
    return middles


@dataclass(frozen=True)
class Window:
    """Part of the plane that is drawn for the 2l of ``scene``, or for ``two_l`` if there is none."""

    energies: tuple[float, float]
    k_sq: tuple[float, float]
    scene: str = ""
    two_l: float = 0.0


def load_bifurcation(windows: Sequence[Window], layout: Grid, request: Request) -> Loaded:
    """Load a panel for each window. Raises UsageError for a scene of another top."""
    from topcli.analysis.motion.diagram import branches, regions
    from topcli.config.load import load_experiment
    from topcli.schemes.kowalevski.closed_form.curve import integrals

    panels, data = [], {}
    for number, window in enumerate(windows):
        two_l, name = window.two_l, ""
        if window.scene:
            experiment = load_experiment(scene_config(window.scene, request.configs))
            name = experiment.name
            if experiment.top.kind != "kowalevski":
                raise UsageError(f"bifurcation: {name} is of the top {experiment.top.kind}, not kowalevski")
            of = integrals(experiment.y0, experiment.top.constants()[0])
            two_l = 2.0 * float(of.L)
            data |= curve_columns(number, {"scene": np.array([[3.0 * float(of.l1)], [float(of.k_sq)]])})
        curves = critical_curves(two_l, window.energies, window.k_sq)
        data |= curve_columns(number, curves)
        panels.append(Diagram(number, two_l, window.energies, window.k_sq, name, tuple(curves), numbers_of_tori()))
    code = fingerprint(regions, branches, _middles, compiled=False)
    source = {"panels": [repr(panel) for panel in panels], "code": code}
    return Loaded(tuple(panels), lambda: data, source, layout)


def curve_columns(number: int, curves: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of curves (2, m) of the panel ``number``."""
    return {f"{number}:{kind}:{axis}": curve[i] for kind, curve in curves.items() for i, axis in enumerate(AXES)}


def numbers_of_tori() -> dict[str, int]:
    """Number of tori in each region."""
    from topcli.analysis.motion.diagram import REGIONS

    return {name: region.tori for name, region in REGIONS.items()}


def critical_curves(two_l: float, energies: tuple[float, float], k_sq: tuple[float, float]) -> dict[str, np.ndarray]:
    """Critical curves of each kind in a window, in the order of the legend: E and k² (2, m), nan between parts."""
    from topcli.analysis.motion.diagram import branches

    parts: dict[str, list[np.ndarray]] = {kind: [] for kind in KINDS}
    for branch in branches(0.5 * two_l, 1.0, energies, k_sq):
        if branch.kind in parts:
            parts[branch.kind] += [np.array([branch.E, branch.k_sq]), np.full((2, 1), np.nan)]
    return {kind: np.hstack(some) for kind, some in parts.items() if some}
