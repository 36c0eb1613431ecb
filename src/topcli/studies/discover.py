"""``topcli discover``: polynomials of the state that stay constant along orbits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from topcli.errors import UsageError
from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Flag, Head, Result, Study
from topcli.table import Column, Table, ten_digits, two_digits

TOLERANCE = 1e-11


def measure(
    *runs: Annotated[str | Path, Flag("", "RUN", required=True)],
    degree: Annotated[int, Flag("--degree", "D", least=1)] = 2,
    columns: Annotated[Sequence[str], Flag("--columns", "NAME,...")] = (),
    tolerance: Annotated[float, Flag("--tolerance", "X")] = TOLERANCE,
    watch: Watch = SILENT,
) -> Result:
    """Find polynomials that stay constant along orbits.

    Of the monomials up to the degree, the null space is found by singular values: those below the tolerance, relative
    to the largest, if a gap of at least 1e4 separates them from the others. What follows from constants of a lower
    degree is not listed again.

    Parameters
    ----------
    *runs : path or str
        Folders of runs; CSV or Parquet files.
    degree : int, optional
        Try polynomials up to this degree.
    columns : sequence of str, optional
        Use these components only; by default all.
    tolerance : float, optional
        Largest singular value of a constant.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` has a row for each polynomial, ``levels`` one for each degree, with the singular values on both sides
        of the gap.

    Raises
    ------
    UsageError
        For what is no run or series, unknown components, and too few rows.
    RunError
        For a damaged run.

    Examples
    --------
    >>> import topcli
    >>> run = topcli.run("euler_hk", "results")
    >>> topcli.discover(run.folder).study["relations"]
    2
    """
    from topcli.studies.discover_orbits import discover_study, read_orbit, require_enough

    if not runs:
        raise UsageError("discover: nothing is given; name the folder of a run, such as results/NAME, or a file")
    if not 0.0 < tolerance < 1.0:
        raise UsageError(f"--tolerance {tolerance:g}: must be between 0 and 1, such as 1e-11")
    orbits = [read_orbit(run, columns) for run in runs]
    require_enough(orbits, degree)
    watch.begin("discover")
    return Result(discover_study(orbits, degree, tolerance))


def _subject(data: Data) -> str:
    count = len(data["sources"])
    where = data["sources"][0] if count == 1 else f"{count} orbits"
    return f"{where}: {data['rows']} rows, degree {data['degree']}"


LEVELS = Table(
    "levels",
    (
        Column("degree", "degree"),
        Column("monomials", "monomials"),
        Column("null space", "null"),
        Column("products", "products"),
        Column("new", "found"),
        Column("largest below the gap", "kept", two_digits),
        Column("smallest above", "left", two_digits),
    ),
    name="levels",
    heading="Singular values",
    title=_subject,
    index="degree",
)
CONSTANTS = Table(
    "constants",
    (
        Column("constant", "polynomial"),
        Column("value", lambda row: row["values"][0] if len(row["values"]) == 1 else None, ten_digits),
        Column("deviation", "deviation", two_digits),
        Column("", "degree"),
    ),
    heading="Constants",
    title="polynomials that are constant",
    index="polynomial",
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    return Head("Constants of orbits", _subject(data), f"{len(data['constants'])} found")


def printed(result: Result) -> Iterator[Table]:
    """Tables that are not empty."""
    if result.data["constants"]:
        yield CONSTANTS
    yield LEVELS


def notes(data: Data) -> Iterator[str]:
    """Meaning of the constants."""
    if not data["constants"]:
        yield f"no polynomial up to degree {data['degree']} is constant within the tolerance {data['tolerance']:g}"
    elif len(data["sources"]) == 1:
        yield "constant on this orbit; on others the coefficients may differ: give several runs to see"
    else:
        count = len(data["sources"])
        yield f"constant on each of {count} orbits, with a value of its own; give runs until none drops out"


DISCOVER = Study(
    "discover",
    measure,
    head,
    (CONSTANTS, LEVELS),
    printed=printed,
    notes=notes,
    stem=lambda data: "discover",
    unit="orbits",
)
