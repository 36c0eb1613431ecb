"""Portraits of the tops of the catalogue: two motions of each top in the plane of two components."""

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
from topcli.tops import CATALOGUE, gentle_scene

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
HARD: dict[str, tuple[str, ...]] = {
    "volterra": ("top.b1=0.1", "top.b2=-0.2", "top.b3=0.3", "initial.m=[0.03, 1.2, -0.1]"),
    "lagrange-gyrostat": ("top.k=1.73", "initial.omega=[0, 0, 0.5]", "initial.gamma=[1e-3, 0, auto]"),
    "kowalevski-gyrostat": (
        "top.k=10",
        "initial.omega=[0, 0, 0]",
        "initial.gamma=[1, 0, 1e-3]",
        "initial.normalize=true",
    ),
    "goryachev-chaplygin": ("initial.omega=[0.4, 0.5, 0.9]", "initial.gamma=[-0.6, 0.48, 0.64]"),
    "hess-appelrot": ("initial.omega=[0.5, 1.5, -0.75]", "initial.gamma=[0.6, 0, 0.8]"),
    "clebsch": ("initial.m=[1e-6, 0, 0]", "initial.p=[0, 0, 1]"),
    "kirchhoff": ("initial.m=[1e-6, 0, 0.01]", "initial.p=[0, 0, 1]"),
    "suslov": ("initial.omega1=1", "initial.omega2=-0.399999999"),
    "coupled-euler": ("top.alpha5=12",),
    "gaudin": ("top.lambda1=2.5", "top.lambda2=0.5", "initial.a=[1e-6, 0, 1]", "initial.b=[0, 0, -1]"),
    "weierstrass": ("initial.x=-0.999999",),
    "so4": ("initial.m12=1e-6", "initial.m13=1", "initial.m14=0", "initial.m23=0", "initial.m24=0", "initial.m34=1e-6"),
}
"""Overrides of the scene of each top that make its hard motion: near a separatrix, or with less symmetry."""
CASES: dict[str, dict[str, Any]] = {
    "gentle": {"color": "#56B4E9", "linestyle": "-", "linewidth": 0.8},
    "hard": {"color": "#A84300", "linestyle": "-", "linewidth": 1.1},
}
"""The motions of each top with their looks: pale and dark, because a curve that is traced many times fills dashes."""
DURATIONS, SAMPLES = {"gentle": 40.0, "hard": 80.0}, 1500


@dataclass(frozen=True)
class Portrait:
    """Curves of both motions of a top, from the columns ``form:case:component``; a dot marks the start."""

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
    """Load the panels of all tops and their exact motions."""
    data, sources = {}, []
    for form, plane in PLANES.items():
        for case in CASES:
            overrides = HARD[form] if case == "hard" else ()
            scene = load_experiment(scene_config(gentle_scene(form), request.configs), overrides)
            sources.append(scene.digest)
            t = np.linspace(0.0, DURATIONS[case], SAMPLES + 1)
            states = reference_states(scene.top, scene.y0, t)
            data |= {f"{form}:{case}:{name}": states[:, scene.top.components.index(name)] for name in plane}
    panels = tuple(Portrait(form, PLANES[form]) for form in CATALOGUE)
    source = {"scenes": sources, "durations": DURATIONS, "samples": SAMPLES}
    return Loaded(panels, lambda: data, source, Grid(3, (7.0, 5.8), ncols=3))
