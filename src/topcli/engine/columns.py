"""Names of the columns of a time series: ``n``, ``t``, components, invariants, quantities, the attitude.

That of the attitude is the unit quaternion, or Euler's angles, of the rotation from the body's frame to space.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from topcli.contracts import Array, Top


def column_names(top: Top, *further: Iterable[str]) -> list[str]:
    """Names of the columns of a run of ``top``, in order; those of ``further`` lists come last."""
    invariants = (invariant.name for invariant in top.invariants())
    return ["n", "t", *top.components, *invariants, *(name for names in further for name in names)]


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
        from scipy.spatial.transform import Rotation

        angles = np.column_stack([columns[name] for name in ATTITUDES["euler-angles"]])
        return Rotation.from_euler("ZXZ", angles).as_quat()[:, [3, 0, 1, 2]]
    return None
