"""Portraits of the tops of the catalogue: motions of their two scenes in the plane of two components."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, caption, component_symbol
from topcli.figures.scenes import scene_config
from topcli.tops import CATALOGUE

PLANES = {
    "volterra": ("m1", "m2"),
    "lagrange-gyrostat": ("gamma1", "gamma2"),
    "kowalevski-gyrostat": ("gamma1", "gamma2"),
    "goryachev-chaplygin": ("gamma1", "gamma3"),
    "hess-appelrot": ("gamma1", "gamma3"),
    "clebsch": ("p2", "p3"),
    "kirchhoff": ("p1", "p3"),
    "suslov": ("omega1", "omega2"),
    "coupled-euler": ("x1", "x3"),
    "gaudin": ("a1", "b3"),
    "weierstrass": ("x", "v"),
    "so4": ("m12", "m13"),
}
CASES: dict[str, dict[str, Any]] = {
    "gentle": {"color": "#56B4E9", "linestyle": "-", "linewidth": 0.8},
    "hard": {"color": "#A84300", "linestyle": "-", "linewidth": 1.1},
}
"""The scenes of each top with their looks: pale and dark, because a curve that is traced many times fills dashes."""
DURATIONS, SAMPLES = {"gentle": 40.0, "hard": 80.0}, 1500


@dataclass(frozen=True)
class Portrait:
    """Curves of both scenes of a top, from the columns ``form:case:component``; a dot marks the start."""

    form: str
    plane: tuple[str, str]

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw into ``axes``; ``styles`` is not used."""
        for case, look in CASES.items():
            x, y = (data[f"{self.form}:{case}:{name}"] for name in self.plane)
            axes.plot(x, y, label=case, **look)
            axes.plot(x[:1], y[:1], "o", color=look["color"], markersize=2.5)
        axes.plot([], [], "o", color="0.4", markersize=2.5, label="start")
        across, up = map(component_symbol, self.plane)
        caption(axes, across, up, self.form)


def load_portraits(request: Request) -> Loaded:
    """Load the panels of all tops and the exact motions of their scenes."""
    data, sources = {}, []
    for form, plane in PLANES.items():
        for case in CASES:
            scene = load_experiment(scene_config(f"{form.replace('-', '_')}_{case}", request.configs))
            sources.append(scene.digest)
            t = np.linspace(0.0, DURATIONS[case], SAMPLES + 1)
            states = reference_states(scene.top, scene.y0, t)
            data |= {f"{form}:{case}:{name}": states[:, scene.top.components.index(name)] for name in plane}
    panels = tuple(Portrait(form, PLANES[form]) for form in CATALOGUE)
    source = {"scenes": sources, "durations": DURATIONS, "samples": SAMPLES}
    return Loaded(panels, lambda: data, source, Grid(3, (7.0, 5.8), ncols=3))
