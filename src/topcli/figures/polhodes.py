"""The energy ellipsoid of the Euler top in the space of omega, with polhodes: curves of constant m².

The ellipsoid is shaded pixel by pixel, and every curve is cut at its outline.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from topcli.contracts import checked_equations
from topcli.errors import RunError, UsageError
from topcli.figures.picture import REFERENCE, Runs, Styles, exact_column, halo
from topcli.figures.scene3d import arrow, lit, pair_of_lines, projection

Curve = np.ndarray
"""Points (m, 3)."""
RUN = "#B2182B"
FACING = 0.1
"""Smallest cosine of the angle between the line of sight and the surface's normal at which an arrow can be read."""


@dataclass(frozen=True)
class Polhodes:
    """Ellipsoid for moments (A, B, C), all different, at the energy of the run; the run's own curve is highlighted.

    ``levels`` are the positions of the thin polhodes between the separatrix (0) and the axes (1), on either side.
    ``view`` is the azimuth and the elevation of the viewer, in degrees, with omega3 upright. ``label`` names the run's
    curve in the legend.
    """

    moments: tuple[float, float, float]
    omega: tuple[str, str, str] = ("omega1", "omega2", "omega3")
    levels: tuple[float, ...] = (0.1, 0.25, 0.42, 0.6, 0.77, 0.91)
    view: tuple[float, float] = (52.0, 24.0)
    pixels: int = 900
    exact: tuple[str, ...] = ()
    label: str = "run"

    def of_runs(self, runs: Runs) -> Polhodes:
        """Return the panel with the moments of the run's top and the exact motion; UsageError for equal moments."""
        experiment, exact = runs.of(self.omega[0]).experiment, runs.overlaid(self.omega)
        moments = checked_equations(experiment.top, "the figure polhodes").moments
        if len(set(moments)) < 3:
            given = ", ".join(f"{moment:g}" for moment in moments)
            raise UsageError(f"polhodes: {experiment.name} has the moments {given}; use three different ones")
        return replace(self, moments=moments, exact=exact if exact == self.omega else ())

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw into ``axes``. Raises RunError if the data are not on the ellipsoid of the moments."""
        moments = np.array(self.moments)
        path = np.column_stack([data[name] for name in self.omega])
        energies = path**2 @ moments
        if np.ptp(energies) > 0.05 * energies[0]:
            raise RunError(
                f"polhodes: the run does not conserve the energy of a top with the moments {self.moments}; "
                "use a run of a top with these moments"
            )
        size = np.sqrt(energies[0])
        azimuth, elevation = self.view
        camera = projection(elevation, azimuth)
        _shade(axes, moments, camera, self.pixels)
        for curve, steady in _curves(moments, self.levels):
            width, far = (1.2, 0.45) if steady else (0.6, 0.3)
            _trace(axes, curve @ camera.T, _facing(curve, moments, camera), "0.15", width, far)
            _arrow(axes, curve, moments, camera)
        if self.exact:
            exact = np.column_stack([data[name] for name in map(exact_column, self.omega)]) / size
            grey, width = (styles[REFERENCE][key] for key in ("color", "linewidth"))
            _trace(axes, exact @ camera.T, _facing(exact, moments, camera), grey, width, 0.6)
        _trace(axes, path @ camera.T / size, _facing(path, moments, camera), RUN, width=1.8, far=0.45)
        labels = _landmarks(axes, moments, camera)
        reach = 1.04 * np.sqrt(camera[:2] ** 2 @ (1.0 / moments))
        low, high = np.minimum(-reach, labels.min(axis=0) - 0.06), np.maximum(reach, labels.max(axis=0) + 0.06)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_axis_off()
        self._legend(axes)

    def _legend(self, axes: Any) -> None:
        """Explain lines and dots below the ellipsoid."""
        from matplotlib.lines import Line2D

        dot: dict[str, Any] = {"color": "none", "marker": "o", "markeredgecolor": "0.1"}
        entries = {
            self.label: Line2D([], [], color=RUN, linestyle="-", linewidth=1.8),
            "separatrix": Line2D([], [], color="0.15", linestyle="-", linewidth=1.2),
            "stable rotation": Line2D([], [], markerfacecolor="0.1", **dot),
            "unstable": Line2D([], [], markerfacecolor="white", **dot),
        }
        axes.legend(entries.values(), entries, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=len(entries))


def _shade(axes: Any, moments: np.ndarray, camera: np.ndarray, pixels: int) -> None:
    """Draw the ellipsoid x.Ix = 1, tinted by m²/2E: blue towards the largest moment, ochre towards the smallest."""
    reach = 1.02 * np.sqrt(camera[:2] ** 2 @ (1.0 / moments)).max()
    x, y = np.meshgrid(*(np.linspace(-reach, reach, pixels),) * 2)
    base = x[..., None] * camera[0] + y[..., None] * camera[1]
    a, b, c = camera[2] ** 2 @ moments, (base * moments) @ camera[2], (base**2) @ moments - 1.0
    inside = b * b - a * c
    depth = (-b + np.sqrt(np.maximum(inside, 0.0))) / a
    point = base + depth[..., None] * camera[2]
    normal = point * moments
    size = np.linalg.norm(normal, axis=-1)
    normal /= size[..., None]
    small, middle, large = np.sort(moments)
    level = np.where(size**2 > middle, (size**2 - middle) / (large - middle), (size**2 - middle) / (middle - small))
    level = np.clip(level, -1.0, 1.0)[..., None]
    white, blue, ochre = (np.array(rgb) for rgb in ((0.985, 0.975, 0.955), (0.44, 0.63, 0.80), (0.93, 0.72, 0.42)))
    colour = white + np.where(level > 0.0, level * (blue - white), -level * (ochre - white))
    image = lit(colour, normal, np.array([-0.45, 0.55, 0.75]) @ camera, camera[2], (0.70, 0.31), (0.07, 24))
    slope = np.maximum((normal @ camera[2]), 0.0)
    edge = np.clip(slope * pixels / 60.0, 0.0, 1.0)  # the outline fades within some pixels
    image = np.dstack([image, np.where(inside > 0.0, edge, 0.0)])
    outline = np.linalg.cholesky((camera[:2] / moments) @ camera[:2].T)
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(*(outline @ [np.cos(turn), np.sin(turn)]), color="0.35", linestyle="-", linewidth=0.6, zorder=3.5)
    axes.imshow(image, extent=(-reach, reach, -reach, reach), origin="lower", interpolation="bicubic", zorder=1)


def _curves(moments: np.ndarray, levels: tuple[float, ...]) -> list[tuple[Curve, bool]]:
    """Polhodes on x.Ix = 1, each once around in the sense of the motion; True for the separatrix.

    About the axis i the curve of m² = q is I_j (I_j - I_i) x_j² + I_k (I_k - I_i) x_k² = q - I_i.
    """
    small, middle, large = (int(i) for i in np.argsort(moments))
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    found: list[tuple[Curve, bool]] = []
    for i in (small, large):
        j, k = (i + 1) % 3, (i + 2) % 3
        for level in (0.0, *levels):
            # squared, so that the curves are evenly spaced
            rest = (moments[middle] - moments[i]) * (1.0 - level) ** 2
            for side in (1.0, -1.0):
                x = np.empty((len(angle), 3))
                x[:, j] = np.cos(angle) * np.sqrt(rest / (moments[j] * (moments[j] - moments[i])))
                x[:, k] = np.sin(angle) * np.sqrt(rest / (moments[k] * (moments[k] - moments[i])))
                others = moments[j] * x[:, j] ** 2 + moments[k] * x[:, k] ** 2
                x[:, i] = side * np.sqrt(np.maximum(1.0 - others, 0.0) / moments[i])
                # the motion: x_j' = (I_k - I_i)/I_j x_k x_i
                forwards = -side * (moments[k] - moments[i]) > 0.0
                found.append((x if forwards else x[::-1], level == 0.0))
    return found


def _facing(curve: Curve, moments: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """Cosines (m,) of the angles between the line of sight and the normals of the ellipsoid at points of a curve."""
    return (curve * moments) @ camera[2] / np.linalg.norm(curve * moments, axis=1)


def _trace(axes: Any, seen_curve: Curve, facing: np.ndarray, color: str, width: float, far: float) -> None:
    """Draw a curve as the camera sees it: solid in front, thin and of the opacity ``far`` behind."""
    pair = {"lw": width, "zorder": 3}, {"lw": 0.6 * width, "alpha": far, "zorder": 2}
    pair_of_lines(axes, seen_curve, facing >= 0.0, pair, color=color)


def _arrow(axes: Any, curve: Curve, moments: np.ndarray, camera: np.ndarray) -> None:
    """Draw an arrowhead at the point of the curve that faces the viewer most, if it is visible."""
    facing = _facing(curve, moments, camera)
    at = int(np.argmax(facing[:-8]))
    if facing[at] < FACING:
        return
    start, end = (curve[[at, at + 6]]) @ camera[:2].T
    arrow(axes, start, end, "0.15", 0.6, zorder=4, head=0.17)


def _landmarks(axes: Any, moments: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """Draw the axes and the steady rotations, filled if stable, open if unstable; the places (m, 2) of the names."""
    middle = int(np.argsort(moments)[1])
    labels = []
    for i in range(3):
        tip = np.zeros(3)
        tip[i] = 1.0 / np.sqrt(moments[i])
        for sign in (1.0, -1.0):
            if sign * camera[2][i] > 0.0:
                stable = i != middle
                look = {"ms": 5.0, "mew": 1.0, "mec": "0.1", "mfc": "0.1" if stable else "white", "zorder": 5}
                axes.plot(*(sign * tip @ camera[:2].T), "o", **look)
        if camera[2][i] > 0.0:
            start = tip @ camera[:2].T
            along = start / np.hypot(*start) * np.sqrt(1.0 / moments.min())
            arrow(axes, start, start + 0.2 * along, "0.25", 0.9, zorder=4, head=0.2, shrinkA=3)
            labels.append(start + 0.27 * along)
            style = {"ha": "center", "va": "center", "fontsize": "large", "zorder": 6}
            halo(axes.text(*labels[-1], rf"$\omega_{i + 1}$", **style), 3.0)
    return np.array(labels)
