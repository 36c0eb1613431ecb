"""Columns of a time series: ``n``, ``t``, the components of the state, the invariants, quantities, the attitude.

That of the attitude is the unit quaternion, or Euler's angles, of the rotation from the body's frame to space.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.quantities import Quantity
from topcli.contracts import Array, Invariant, Top
from topcli.errors import UsageError, nearest, quoted


def column_names(top: Top, quantities: Iterable[Quantity] = ()) -> list[str]:
    """Names of all columns that a run of ``top`` can record, in order; those of a user's ``quantities`` come last."""
    invariants = (invariant.name for invariant in top.invariants())
    return ["n", "t", *top.components, *invariants, *(quantity.name for quantity in quantities)]


_ASCII = str.maketrans({"²": "^2", "·": ".", "γ": "gamma", "ω": "omega", "κ": "kappa", "₃": "3"})


def spellings(name: str, symbol: str) -> list[str]:
    """Accepted spellings of an invariant's column: its name, its symbol, and the symbol in ASCII.

    >>> spellings("gamma_sq", "γ²")
    ['gamma_sq', 'γ²', 'gamma^2']
    """
    return list(dict.fromkeys((name, symbol, symbol.translate(_ASCII))))


def invariant_values(invariants: Iterable[Invariant], states: Array) -> dict[str, Array]:
    """Values (m,) of each invariant along states (m, d), by name; infinite or nan ones come without a warning."""
    with np.errstate(all="ignore"):
        return {invariant.name: invariant.value(states) for invariant in invariants}


def columns(
    top: Top,
    n: NDArray[Any],
    h: float,
    states: Array,
    names: Iterable[str],
    modified: Iterable[Invariant] = (),
    values: Mapping[str, NDArray[Any]] | None = None,
    quantities: Iterable[Quantity] = (),
) -> dict[str, NDArray[Any]]:
    """Columns by name, computed from recorded rows.

    Parameters
    ----------
    top : Top
        Top whose components and invariants are the columns.
    n : ndarray, shape (m,)
        Step numbers, with fractions at the crossings of a section.
    h : float
        Step size.
    states : ndarray, shape (m, d)
        Recorded states.
    names : iterable of str
        Columns to compute; no other column is computed.
    modified : iterable of Invariant, optional
        Integrals of the scheme, which have columns too.
    values : mapping of str to ndarray, shape (m,), optional
        Values of invariants by name, if they have been evaluated before, and of columns that are not functions of
        the state.
    quantities : iterable of Quantity, optional
        Observables of the user, which have columns too.

    Returns
    -------
    dict of str to ndarray, shape (m,)

    Raises
    ------
    UsageError
        For an unknown name.
    """
    values = values or {}
    invariants = {invariant.name: invariant for invariant in (*top.invariants(), *modified)}
    formulas = {quantity.name: quantity for quantity in quantities}
    data: dict[str, NDArray[Any]] = {}
    for name in names:
        if name in values:
            data[name] = values[name]
        elif name == "n":
            data[name] = n
        elif name == "t":
            data[name] = n * h
        elif name in top.components:
            data[name] = states[:, top.components.index(name)]
        elif name in formulas:
            data[name] = formulas[name].values(top, n, h, states)
        elif name in invariants:
            data[name] = invariant_values([invariants[name]], states)[name]
        else:
            known = dict.fromkeys(("n", "t", *top.components, *invariants, *formulas, *values))
            raise UsageError(f"no column {quoted(name)}; {nearest(name, known)}")
    return data


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
