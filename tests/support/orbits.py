"""Systems with known exponents, and curves of growth written down, for the tests of chaos."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from topcli.analysis.lyapunov import Growth, checkpoints, growth_of
from topcli.analysis.recurrence import Recurrence
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.tops import gentle_scene

LORENZ = {"x": "10*(y - x)", "y": "28*x - y - x*z", "z": "x*y - 8/3*z"}
ROESSLER = {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 5.7)"}
HENON_HEILES = {"x": "px", "y": "py", "px": "-x - 2*x*y", "py": "-y - x*x + y*y"}
DUFFING = {"x": "v", "v": "x - x**3"}
PENDULUM = {"q": "p", "p": "sin(q)"}
HARD = {
    "clebsch": "h=0.05 initial.m=[1e-6,0,0] initial.p=[0,0,1]",
    "gaudin": "h=0.05 top.lambda1=2.5 top.lambda2=0.5 initial.a=[1e-6,0,1] initial.b=[0,0,-1]",
    "kirchhoff": "h=0.05 top.a1=1 top.a3=1.6 top.b1=0.8 top.b3=2 initial.m=[1e-6,0,0.01] initial.p=[0,0,1]",
    "kowalevski-gyrostat": "top.k=10 initial.omega=[0,0,0] initial.gamma=[1,0,1e-3] initial.normalize=true h=0.02",
}
"""Motions next to a separatrix."""


def hard(form: str, *overrides: str) -> Experiment:
    """A motion of a top next to a separatrix, by the midpoint rule."""
    return load_experiment(gentle_scene(form), ["scheme=midpoint", *HARD[form].split(), *overrides])


def of_field(field: Mapping[str, str], y: Sequence[float], scheme: str, h: float, N: int = 1000) -> Experiment:
    """Experiment with a field of its own."""
    top = {"kind": "custom", "components": list(field), "field": dict(field)}
    initial = dict(zip(field, y, strict=True))
    return load_experiment({"name": "orbit", "top": top, "initial": initial, "scheme": scheme, "h": h, "N": N})


def growth_along(experiment: Experiment, y: Any = None, N: int | None = None, **options: Any) -> Growth:
    """Growth of tangent vectors along the orbits of an experiment from the states ``y`` (m, d)."""
    states = np.array([experiment.y0] if y is None else y, dtype=float)
    scheme, method = experiment.scheme, experiment.method()
    return growth_of(experiment.top, scheme, method, experiment.h, N or experiment.N, states, **options)


Curve = Callable[[Any], Any]


def curves(*of_time: Curve, T: float = 1000.0, recurrence: Recurrence | None = Recurrence.WANDERS) -> Growth:
    """Growth with a curve G(u) for each orbit, u from 0 to 1 along the time T."""
    n = checkpoints(1000)
    later = [np.broadcast_to(curve(n[1:] / 1000), len(n) - 1) for curve in of_time]
    logs = np.pad(np.array(later, dtype=float).T, ((1, 0), (0, 0)))
    count = len(of_time)
    return Growth(n, T / 1000, logs, np.ones(count), np.zeros(count, dtype=np.int64), [recurrence] * count)
