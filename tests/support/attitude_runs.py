"""Short stored runs with their attitude, and the angle between attitudes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from topcli.config.load import load_experiment
from topcli.runs.run import run_experiment

TURNED = "output.attitude=quaternion"


def stored(out: Path, scene: str, *sets: str) -> Path:
    return run_experiment(load_experiment(scene, list(sets)), out).stored.folder


def turned_apart(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Angles between attitudes, which q and -q share."""
    return (Rotation.from_quat(p, scalar_first=True).inv() * Rotation.from_quat(q, scalar_first=True)).magnitude()
