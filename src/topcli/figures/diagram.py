"""Bifurcation diagram of the Kowalevski top: regions with their numbers of tori, critical curves, and motions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from topcli.analysis.motion.kowalevski import TORI, branches, regions
from topcli.config.load import load_experiment
from topcli.contracts import Array
from topcli.figures.figure import Columns, figure
from topcli.figures.style import labelled, legend_below, plain_text
from topcli.schemes.kowalevski.curve import Integrals

TINTS = ("#FFFFFF", "#DCE9F5", "#E3F0DC", "#F6EBD3", "#F5DDD9", "#E4DCEF")
"""Colours of no motion and of the regions I to V."""
_KINDS = {
    "separatrix": ("separatrix", {"color": "0.1", "ls": "-", "lw": 1.4}),
    "pinch": ("pinch", {"color": "#B2182B", "ls": (0, (4, 1.5)), "lw": 1.6}),
    "periodic": (r"periodic: $E-2\ell^2=-k$", {"color": "#0072B2", "ls": (0, (7, 1.5, 1.5, 1.5)), "lw": 1.8}),
    "delone": (r"Delone: $k=0$", {"color": "#009E73", "ls": "-", "lw": 2.6}),
    "bobylev-steklov": ("Bobylev, Steklov", {"color": "#0072B2", "ls": (0, (1, 1.2)), "lw": 1.4}),
}
"""Kinds of critical curves: labels and looks, in the order of the legend."""
PIXELS = (700, 500)
DASHED = 2.4
"""Length of a line in a legend, in letters, that shows all of a dash-dot pattern."""
_Place = tuple[float, float, float]
"""E, k² and 2l of a motion."""
Window = tuple[tuple[float, float], tuple[float, float]]
"""Ends of the axes of E and k²."""


def place_of_motion(state: Any, c: float) -> _Place:
    """E, k² and 2l of a state of the Kowalevski top, in units in which c |gamma| = 1."""
    of = Integrals.of(state, c)
    unit = float(of.G) ** 0.5
    return 3.0 * float(of.l1) / unit, float(of.k_sq) / unit**2, 2.0 * float(of.L) / unit**1.5


def critical_curves(two_l: float, window: Window) -> dict[str, Array]:
    """Critical curves of each kind in a window, in the order of the legend: E and k² (2, m), nan between parts."""
    gap = np.full((2, 1), np.nan)
    parts: dict[str, list[Array]] = {kind: [] for kind in _KINDS}
    for branch in branches(0.5 * two_l, 1.0, *window):
        if branch.kind in parts:
            parts[branch.kind] += [np.array([branch.E, branch.k_sq]), gap]
    return {kind: np.hstack(each) for kind, each in parts.items() if each}


def draw_diagram(axes: Any, window: Window, curves: Mapping[str, Array], place: _Place) -> None:
    """Draw regions, critical curves, and a motion as a point; the legend has the numbers of tori."""
    from matplotlib.colors import ListedColormap

    E, up = (low + (high - low) * (np.arange(n) + 0.5) / n for (low, high), n in zip(window, PIXELS, strict=True))
    codes = regions(E[None, :], up[:, None], 0.5 * place[2], 1.0)
    extent = (*window[0], *window[1])
    axes.imshow(codes, extent=extent, origin="lower", aspect="auto", cmap=ListedColormap(TINTS), vmin=-0.5, vmax=5.5)
    third = codes == list(TORI).index("III") + 1  # II becomes III without a bifurcation
    axes.contour(E, up, third, levels=[0.5], colors="0.5", linewidths=0.5, zorder=2)
    for kind, (x, y) in curves.items():
        axes.plot(x, y, label=_KINDS[kind][0], zorder=4, **_KINDS[kind][1])
    for (region, tori), tint in zip(TORI.items(), TINTS[1:], strict=True):
        label = f"{region}: {tori} {'tori' if tori > 1 else 'torus'}"
        axes.plot([], [], "s", color=tint, markersize=8.0, markeredgecolor="0.6", label=label)
    look = {"color": "0.05", "markersize": 5.0, "markeredgecolor": "white", "zorder": 6}
    axes.plot(*place[:2], "o", label="motion", **look)
    axes.grid(visible=False)
    labelled(axes, "energy $E$", "$k^2$", xlim=window[0], ylim=window[1])


WINDOWS: dict[str, Window] = {
    "kowalevski_generic_hk": ((-0.9, 4.9), (0.0, 3.0)),
    "kowalevski_torus": ((-0.9, 2.9), (0.0, 2.0)),
    "1.85": ((1.66, 2.06), (0.0, 0.1)),
    "kowalevski_hk": ((3.0, 12.5), (0.0, 20.0)),
}
"""Part of the plane that is drawn for the 2l of each scene, or for this 2l."""


def draw_bifurcation(canvas: Any, columns: Columns) -> None:
    """Draw a diagram for each window, with the scenes as points."""
    for axes, letter, (name, window) in zip(canvas.subplots(2, 2).flat, "abcd", WINDOWS.items(), strict=True):
        E, k_sq, two_l = columns[f"{name}:E, k_sq, two_l"].tolist()
        present = [kind for kind in _KINDS if f"{name}:{kind}:E" in columns]
        curves = {kind: np.array([columns[f"{name}:{kind}:{axis}"] for axis in ("E", "k_sq")]) for kind in present}
        draw_diagram(axes, window, curves, (E, k_sq, two_l))
        scene = f", {plain_text(name)}" if np.isfinite(E) else ""
        axes.set_title(rf"({letter}) $2\ell = {two_l:.6g}${scene}", loc="left")
    legend_below(canvas, 4, fontsize=9.0, handlelength=DASHED)


@figure("bifurcation", "Kowalevski top: bifurcation diagrams, and scenes as points", draw_bifurcation, (7.0, 6.2))
def bifurcation() -> Columns:
    """Place of each scene, and the critical curves ``window:kind:E`` and ``window:kind:k_sq``."""
    columns: dict[str, Array] = {}
    for name, window in WINDOWS.items():
        place = (np.nan, np.nan, 1.85)
        if name.startswith("kowalevski"):
            experiment = load_experiment(name)
            place = place_of_motion(experiment.y0, experiment.top.constants()[0])
        columns[f"{name}:E, k_sq, two_l"] = np.array(place)
        for kind, (E, k_sq) in critical_curves(place[2], window).items():
            columns |= {f"{name}:{kind}:E": E, f"{name}:{kind}:k_sq": k_sq}
    return columns
