"""``topcli discover``: polynomials of the state that stay constant along orbits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from topcli.errors import UsageError, counted
from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Flag, Head, Result, Study
from topcli.table import Column, Table, ten_digits, two_digits

TOLERANCE = 1e-11


def measure(
    *runs: Annotated[str | Path, Flag("", "RUN", required=True)],
    degree: Annotated[int, Flag("--degree", "D", least=1)] = 2,
    columns: Annotated[Sequence[str], Flag("--component", "NAME", default="all")] = (),
    tolerance: Annotated[float, Flag("--tolerance", "X")] = TOLERANCE,
    watch: Watch = SILENT,
) -> Result:
    """Find polynomials that stay constant along orbits.

    The study computes the singular values of a matrix with a column for each monomial and a row for each recorded
    state. Singular values count as zero if their ratio to the largest one is below the tolerance and a gap of at least
    a factor of 1e4 separates them from the others. Each singular value that counts as zero gives a polynomial that
    is constant along the orbits. Polynomials that follow from constants of a lower degree are not listed.

    Parameters
    ----------
    *runs : path or str
        Orbits, as folders or names of runs, or CSV or Parquet files.
    degree : int, optional
        Search for polynomials up to this degree.
    columns : sequence of str, optional
        Components of the state that the polynomials may contain; by default all.
    tolerance : float, optional
        Treat singular values below this fraction of the largest one as zero.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report on the polynomials. ``table`` has a row for each polynomial. ``levels`` has a row for each degree, with
        the largest singular value that counts as zero and the smallest one that does not.

    Raises
    ------
    UsageError
        If an argument is neither a run nor a CSV or Parquet file, if a component is unknown, or if there are too few
        rows.
    RunError
        If the files of a run are damaged.

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
    return f"{where}: {counted(data['rows'], 'row')}, degree {data['degree']}"


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
    title="null spaces by degree",
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
    title=_subject,
    index="polynomial",
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    return Head("Constants of orbits", _subject(data), f"{len(data['constants'])} found")


def answer(data: Data) -> str:
    """Number of constants found, and where."""
    count, orbits = len(data["constants"]), len(data["sources"])
    where = "on this orbit" if orbits == 1 else f"on each of {orbits} orbits"
    if not count:
        return f"no polynomial up to degree {data['degree']} is constant {where}, within {data['tolerance']:g}"
    found, value = counted(count, "independent polynomial"), "its value" if count == 1 else "the values"
    differs = "" if orbits == 1 else f"; {value} may differ from orbit to orbit"
    return f"{found} up to degree {data['degree']} {'is' if count == 1 else 'are'} constant {where}{differs}"


def printed(result: Result, verbose: bool) -> Iterator[Table | str]:
    """Answer, and tables that are not empty; the singular values without a constant, or if ``verbose``."""
    yield answer(result.data)
    if result.data["constants"]:
        yield CONSTANTS
    if verbose or not result.data["constants"]:
        yield LEVELS


def notes(data: Data) -> Iterator[str]:
    """Note on the use of more orbits."""
    if data["constants"]:
        alone = len(data["sources"]) == 1
        yield (
            "the coefficients may differ on other orbits; give several runs to test this"
            if alone
            else "a polynomial may be constant by chance; add runs until no polynomial drops out"
        )


DISCOVER = Study(
    "discover",
    measure,
    head,
    (CONSTANTS, LEVELS),
    answer=answer,
    printed=printed,
    notes=notes,
    stem=lambda data: "discover",
    parts=lambda data: [(top, scheme) for top, scheme in data.get("parts", ())],
    unit="orbits",
)
