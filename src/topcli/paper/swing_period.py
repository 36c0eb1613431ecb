"""Time between swings of the paper's scene, which lies at the distance eps = 1e-3 from a homoclinic orbit."""

from __future__ import annotations

import numpy as np

from topcli.contracts import Array

EPS = 1e-3
"""Distance of the scene from the homoclinic orbit, gamma_3(0)."""
TIME = 50.0


def spacing_law(eps: Array) -> Array:
    """Time between swings of the motion at the distances ``eps`` (m,) from the homoclinic orbit, to leading order."""
    return 2.0 * np.sqrt(2.0) * np.log(8.0 * np.sqrt(7.0) / eps)
