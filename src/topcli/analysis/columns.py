"""The columns of a time series: ``n``, ``t``, the components of the state, the invariants."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Invariant, Top
from topcli.errors import UsageError, nearest, quoted


def column_names(top: Top) -> list[str]:
    """All columns that a run of ``top`` can record, in their order."""
    return ["n", "t", *top.components, *(invariant.name for invariant in top.invariants())]


_ASCII = str.maketrans({"²": "^2", "·": ".", "γ": "gamma", "ω": "omega", "κ": "kappa", "₃": "3"})


def spellings(name: str, symbol: str) -> list[str]:
    """Ways to write an invariant where a column is named: its name, its symbol, and that in ASCII.

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
    n: NDArray[np.int64],
    h: float,
    states: Array,
    names: Iterable[str],
    modified: Iterable[Invariant] = (),
    values: Mapping[str, Array] | None = None,
) -> dict[str, NDArray[Any]]:
    """Columns called ``names``, each of shape (m,), from step numbers (m,) and states (m, d).

    ``modified`` are the integrals of the scheme, which have columns too. Invariants that are not among the ``values``
    by name are evaluated if they are named. Raises UsageError for an unknown name.
    """
    values = values or {}
    invariants = {invariant.name: invariant for invariant in (*top.invariants(), *modified)}
    made: dict[str, NDArray[Any]] = {}
    for name in names:
        if name == "n":
            made[name] = n
        elif name == "t":
            made[name] = n * h
        elif name in top.components:
            made[name] = states[:, top.components.index(name)]
        elif name in invariants:
            made[name] = values[name] if name in values else invariant_values([invariants[name]], states)[name]
        else:
            raise UsageError(f"no column {quoted(name)}; {nearest(name, ['n', 't', *top.components, *invariants])}")
    return made
