"""Columns of the attitude: the unit quaternion, or Euler's angles, of the rotation from the body's frame to space."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from topcli.contracts import Array

QUATERNION = "quaternion"
ATTITUDES: Mapping[str, tuple[str, ...]] = {
    QUATERNION: ("q0", "q1", "q2", "q3"),
    "euler-angles": ("psi", "theta", "phi"),
}
"""Names of the columns by the form of the attitude."""
SYMBOLS = {name: f"q_{name[1]}" for name in ATTITUDES[QUATERNION]}
SYMBOLS |= {"psi": r"\psi", "theta": r"\theta", "phi": r"\varphi"}
"""LaTeX of the columns."""


def attitude_columns(form: str, q: Array) -> dict[str, Array]:
    """Columns (m,) by name of the attitudes ``q`` (m, 4), unit quaternions, in one of the forms of ``ATTITUDES``."""
    from topcli.arithmetic.quaternions import euler_angles

    values = q.T if form == QUATERNION else euler_angles(q)
    return dict(zip(ATTITUDES[form], values, strict=True))


def quaternions_of(columns: Mapping[str, Array]) -> Array | None:
    """Unit quaternions (m, 4) of recorded columns of either form; None if there are none."""
    if all(name in columns for name in ATTITUDES[QUATERNION]):
        return np.column_stack([columns[name] for name in ATTITUDES[QUATERNION]])
    if all(name in columns for name in ATTITUDES["euler-angles"]):
        psi, theta, phi = (0.5 * columns[name] for name in ATTITUDES["euler-angles"])
        return np.column_stack(
            [
                np.cos(theta) * np.cos(psi + phi),
                np.sin(theta) * np.cos(psi - phi),
                np.sin(theta) * np.sin(psi - phi),
                np.cos(theta) * np.sin(psi + phi),
            ]
        )
    return None
