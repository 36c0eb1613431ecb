"""``topcli frequencies``: frequencies and rotation numbers of an orbit, and how fast its averages converge."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from topcli.errors import ExitCode
from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Faults, Flag, Head, Overrides, Result, Study, parts_of, top_title
from topcli.table import Column, Table, number, two_digits

if TYPE_CHECKING:
    from topcli.contracts import Array

MOST_ROWS = 1 << 22
"""Largest number of rows of an orbit."""
RESOLUTION = 70
"""Distance of two lines, in cycles over the whole orbit, from which on neither shifts the other by 1e-13 of a cycle."""


def measure(
    config: Annotated[str | Path, Flag("", "CONFIG")],
    overrides: Overrides = (),
    *,
    component: Annotated[Sequence[str], Flag("--component", "NAME", default="all components and quantities")] = (),
    angle: Annotated[Sequence[str], Flag("--angle", "X,Y")] = (),
    watch: Watch = SILENT,
) -> Result:
    """Measure the frequencies of an orbit and detect chaos.

    The study finds the strongest line in the spectrum of each recorded column, in the first and in the second half of
    the orbit. For a regular orbit, the frequencies of the two halves are equal, and averages over the two halves agree
    to many digits. For a chaotic orbit, frequencies and averages differ between the halves.

    Parameters
    ----------
    config : path or str
        Config file or name of a packaged scene.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    component : sequence of str, optional
        Components, invariants or quantities (formulas in ``output.quantities`` of the config) to measure. By default,
        all components and quantities are measured, or none if an ``angle`` is given.
    angle : sequence of str, optional
        Measure how fast the point (X, Y) turns about the origin, where X and Y are two columns. Each pair is a text
        such as ``"gamma1,gamma2"``.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report with a ``table`` that has a row for each measured column and each ``angle``.

    Raises
    ------
    UsageError
        If a column is unknown, or if the run has too few rows for a frequency or too many to fit in memory.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.frequencies("euler_attitude", component=["omega2"], overrides=["N=10000"])
    >>> abs(report.study["columns"][0]["frequency"] / topcli.motion("euler_attitude")["frequency"] - 1) < 1e-6
    True
    """
    import numpy as np

    from topcli.analysis.frequencies import LEAST_ROWS
    from topcli.config.load import load_experiment
    from topcli.engine.rows import Rows
    from topcli.errors import UsageError
    from topcli.runs.plans import plans, trajectory_of
    from topcli.runs.report import finite

    experiment = load_experiment(config, overrides)
    top, every, quantities = experiment.top, experiment.output.every, experiment.quantities
    rows = experiment.N // every + 1
    if rows < 2 * LEAST_ROWS:
        raise UsageError(f"{rows} recorded rows: too few for frequencies; take at least {2 * LEAST_ROWS}")
    if rows > MOST_ROWS:
        least = math.ceil(experiment.N / (MOST_ROWS - 1))
        raise UsageError(f"output.every: {rows} recorded rows do not fit in memory; take {least} or more")
    pairs = [_pair(text) for text in angle]
    names = list(component) or ([] if pairs else [*top.components, *(quantity.name for quantity in quantities)])
    asked, start = [*names, *(name for pair in pairs for name in pair)], np.array([experiment.y0], dtype=float)
    # an unknown name is refused before the run
    first = Rows(next(plans(experiment)), np.zeros(1, dtype=np.int64), start)
    first.columns(asked)
    watch.begin("frequencies", experiment)
    orbit, spacing = trajectory_of(experiment), experiment.h * every
    # the rows that a run which ended early lacks have no values, and so has no frequency
    kept = np.arange(rows) < len(orbit)
    recorded = {name: np.where(kept, np.resize(orbit[name], rows), np.nan) for name in asked}
    found = [_line(name, recorded[name], spacing) for name in names]
    found += [_rotation(pair, recorded[pair[0]], recorded[pair[1]], spacing) for pair in pairs]
    return Result(
        {
            "config": experiment.resolved(),
            "T": experiment.N * experiment.h,
            "rows": rows,
            "highest": 0.5 / abs(spacing),
            "columns": finite(found),
            "completed": len(orbit) == rows,
            "outcome": orbit.outcome.value,
            "message": orbit.ending.message,
        },
    )


def _pair(text: str) -> tuple[str, str]:
    from topcli.errors import UsageError, quoted

    x, comma, y = (part.strip() for part in text.partition(","))
    if not (x and comma and y) or "," in y:
        raise UsageError(f"--angle {quoted(text)}: write two columns, such as --angle gamma1,gamma2")
    return x, y


def _line(name: str, rows: Array, spacing: float) -> Data:
    """Strongest line of a column, its change from the first half to the second, and the digits of the average."""
    from topcli.analysis.frequencies import agreement_digits, strongest_line

    line, half = strongest_line(rows), len(rows) // 2
    first, second = (strongest_line(part).frequency for part in (rows[:half], rows[half:]))
    return {
        "name": name,
        "frequency": line.frequency / abs(spacing),
        "amplitude": line.amplitude,
        "change": (second - first) / abs(spacing),
        "digits": float(agreement_digits(rows)),
    }


def _rotation(pair: tuple[str, str], x: Array, y: Array, spacing: float) -> Data:
    """Mean rotation of a point, with its sense, and its change from the first half to the second."""
    from topcli.analysis.frequencies import rotation_number

    half = len(x) // 2
    first, second = rotation_number(x[: half + 1], y[: half + 1]), rotation_number(x[half:], y[half:])
    change = (second - first) / spacing
    return {
        "name": f"angle of {', '.join(pair)}",
        "frequency": rotation_number(x, y) / spacing,
        "amplitude": None,
        "change": change,
        "digits": -math.log10(max(abs(second - first), 1e-16)),
    }


def _period(row: Data) -> float | None:
    f = row["frequency"]
    return None if f is None else 1.0 / abs(f) if f else math.inf


def _subject(data: Data) -> str:
    config = data["config"]
    return (
        f"{config['scheme']['name']} on {config['name']}: {top_title(config)}, h = {config['h']:g}, N = {config['N']}"
    )


TABLE = Table(
    "columns",
    (
        Column("column", "name", key="column"),
        Column("frequency", "frequency", "{:.12g}".format),
        Column("period", _period, "{:.6g}".format),
        Column("amplitude", "amplitude", number),
        Column("change", "change", two_digits),
        Column("digits", "digits", "{:.1f}".format),
    ),
    heading="Frequencies",
    title=_subject,
    index="column",
    numbers=(1, 2, 3, 4, 5),
)


def answer(data: Data) -> str:
    """Agreement of the halves of the orbit."""
    finite = [row for row in data["columns"] if row["digits"] is not None]
    if not (data["completed"] and finite):
        return ""
    agree = f"averages over the halves agree to at least {min(row['digits'] for row in finite):.1f} digits"
    changes = {abs(row["change"]): row["name"] for row in finite if row["change"] is not None}
    if not changes:
        return agree
    most = max(changes)
    return (
        "from the first half of the orbit to the second, no frequency changes by more than "
        f"{two_digits(most)} ({changes[most]}); {agree}"
    )


def notes(data: Data) -> Iterator[str]:
    """Meaning of the columns, the limits of the rows, and columns that are too slow for these."""
    if not data["completed"]:
        return
    from topcli.analysis.frequencies import LEAST_CYCLES

    finite = [row for row in data["columns"] if row["digits"] is not None]
    for key, least in (("frequency", LEAST_CYCLES), ("change", 2.0 * LEAST_CYCLES)):
        slow = [row["name"] for row in finite if row[key] is None]
        if slow:
            yield f"no {key} for {', '.join(slow)}: fewer than {least:g} cycles in the run; take a longer one"
    yield (
        "frequency: strongest line of the spectrum, in cycles per unit time; change: frequency of the second half of "
        "the orbit minus that of the first; digits: number of digits to which the averages over the halves agree"
    )
    yield (
        f"limits of {data['rows']} rows over T = {data['T']:g}: a frequency above {data['highest']:g} appears as a "
        f"lower one, and two lines closer than about {RESOLUTION / abs(data['T']):.2g} disturb each other"
    )


def head(data: Data) -> Head:
    """Head of the chapter."""
    return Head("Frequencies", _subject(data), data["outcome"].replace("_", " "), data["outcome"] == "completed")


def faults(data: Data) -> Faults:
    """An orbit that ended early."""
    if data["completed"]:
        return Faults()
    return Faults(ExitCode.FAILED, [f"no frequencies: the run {data['message']}"])


FREQUENCIES = Study(
    "frequencies",
    measure,
    head,
    (TABLE,),
    answer=answer,
    notes=notes,
    faults=faults,
    stem=lambda data: f"{data['config']['scheme']['name']}_{data['config']['name']}",
    parts=lambda data: parts_of(data["config"], [data["config"]["scheme"]["name"]]),
)
