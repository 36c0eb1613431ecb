"""Orbits from stored runs and from files of other programs, and the constants found on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import comb
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.constants import EXTRA, Constant, Floats, Level, constants
from topcli.config.formulas import declared_class
from topcli.errors import UsageError, nearest, quoted
from topcli.field.polynomial import Polynomial
from topcli.store.foreign import ForeignSeries
from topcli.store.series import read_series
from topcli.store.verify import intact_run
from topcli.tops import top_class

MOST_ROWS = 20_000
"""Rows of an orbit that are used, evenly spaced."""
MOST_MONOMIALS = 500
DIGITS = 6
"""Digits of the coefficients that are shown."""
TIMES = ("n", "t")
"""Columns that are not components."""


@dataclass(frozen=True)
class Orbit:
    """States (rows, d) of a run or series, with the names of the components, and top and scheme of a run."""

    source: str
    names: tuple[str, ...]
    states: Floats
    parts: tuple[tuple[str, str], ...] = ()


def read_orbit(source: str | Path, columns: Sequence[str]) -> Orbit:
    """Orbit in the folder of a run or in a file; the components are the ``columns``, by default all.

    Raises UsageError for what is neither and for unknown columns, and RunError for a damaged run.
    """
    path = Path(source)
    parts: tuple[tuple[str, str], ...] = ()
    if path.is_file():
        series = ForeignSeries(path)
        known = [name for name in series.names if name not in TIMES]
        names = _chosen(columns, known, str(path))
        found = series.read(names)
    else:
        run = intact_run(path)
        config = run.manifest["config"]
        if "ensemble" in config:
            raise UsageError(f"{path}: is an ensemble; discover takes single runs, several of them if you like")
        top = declared_class(config["top"]) or top_class(config["top"]["kind"], config["initial"])
        names = _chosen(columns, top.components, str(path))
        found = read_series(run.series, names)
        parts = ((top.form, config["scheme"]["name"]),)
    states = np.column_stack([found[name].astype(float) for name in names])
    if not np.isfinite(states).all():
        raise UsageError(f"{path}: row {int(np.argmin(np.isfinite(states).all(axis=1))) + 1} is not finite")
    if not np.ptp(states, axis=0).any():
        raise UsageError(f"{path}: the state is the same in all rows, so that every polynomial is constant")
    return Orbit(str(path), tuple(names), states[:: -(-len(states) // MOST_ROWS)], parts)


def _chosen(columns: Sequence[str], known: Sequence[str], where: str) -> list[str]:
    wanted = [name.strip() for text in columns for name in text.split(",") if name.strip()]
    for name in wanted:
        if name not in known:
            raise UsageError(f"--component {name}: {where} has no component {quoted(name)}; {nearest(name, known)}")
        if wanted.count(name) > 1:
            raise UsageError(f"--component {name}: given twice")
    return wanted or list(known)


def require_enough(orbits: Sequence[Orbit], degree: int) -> None:
    """Raise UsageError for too many monomials, and for orbits with too few rows or of different components."""
    first = orbits[0]
    d = len(first.names)
    monomials = comb(d + degree, degree) - 1
    if monomials > MOST_MONOMIALS:
        raise UsageError(
            f"--degree {degree}: {d} components have {monomials} monomials, and at most {MOST_MONOMIALS} are tried; "
            "lower the degree, or choose components with --component"
        )
    for orbit in orbits:
        if orbit.names != first.names:
            raise UsageError(
                f"{orbit.source}: has the components {', '.join(orbit.names)}, and {first.source} has "
                f"{', '.join(first.names)}; they must be the same"
            )
        if len(orbit.states) < monomials + EXTRA:
            raise UsageError(
                f"{orbit.source}: {len(orbit.states)} rows are too few for the {monomials} monomials of degree "
                f"{degree}; at least {monomials + EXTRA} are needed"
            )


def discover_study(orbits: Sequence[Orbit], degree: int, tolerance: float) -> dict[str, Any]:
    """Constants of the orbits as plain data."""
    names = orbits[0].names
    levels = constants([orbit.states for orbit in orbits], degree, tolerance)
    return {
        "sources": [orbit.source for orbit in orbits],
        "parts": [list(part) for orbit in orbits for part in orbit.parts],
        "columns": list(names),
        "rows": sum(len(orbit.states) for orbit in orbits),
        "degree": degree,
        "tolerance": tolerance,
        "levels": [_level(level) for level in levels],
        "constants": [_constant(one, names) for level in levels for one in level.constants],
        "relations": levels[-1].null,
    }


def _level(level: Level) -> dict[str, Any]:
    return {
        "degree": level.degree,
        "monomials": level.monomials,
        "null": level.null,
        "products": level.products,
        "found": len(level.constants),
        "kept": level.kept,
        "left": level.left,
    }


def _constant(one: Constant, names: Sequence[str]) -> dict[str, Any]:
    terms = {m: Fraction(f"{float(c):.{DIGITS}g}") for m, c in one.polynomial.terms.items()}
    return {
        "degree": one.polynomial.degree,
        "polynomial": Polynomial(terms).text(names),
        "values": list(one.values),
        "deviation": one.deviation,
    }
