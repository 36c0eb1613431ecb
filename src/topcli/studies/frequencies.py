"""``topcli frequencies``: frequencies of an orbit, and how fast its averages converge."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.frequencies import LEAST_CYCLES, LEAST_ROWS, agreement_digits, strongest_line
from topcli.config.load import load_experiment
from topcli.contracts import Array
from topcli.engine.rows import Rows
from topcli.errors import ExitCode, UsageError
from topcli.runs.plans import plans, trajectory_of
from topcli.studies import SILENT, Watch
from topcli.studies.report import Report, Table, plain
from topcli.table import two_digits

MOST_ROWS = 1 << 22
"""Largest number of rows of an orbit."""
RESOLUTION = 70
"""Distance of two lines, in cycles over the whole orbit, from which on neither shifts the other by 1e-13 of a cycle."""


def frequencies(
    config: str | Path | Mapping[str, Any],
    overrides: Sequence[str] = (),
    *,
    component: Sequence[str] = (),
    watch: Watch = SILENT,
) -> Report:
    """Measure the frequencies of an orbit and detect chaos.

    The study finds the strongest line in the spectrum of each recorded column, in the first and in the second half of
    the orbit. For a regular orbit, the frequencies of the two halves are equal, and averages over the two halves agree
    to many digits. For a chaotic orbit, frequencies and averages differ between the halves.

    Parameters
    ----------
    config : path, str or mapping
        Config file or name of a packaged scene.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    component : sequence of str, optional
        Components, invariants or quantities (formulas in ``output.quantities`` of the config) to measure. By default,
        all components and quantities are measured.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        ``table`` has a row for each measured column: the frequency of the strongest line of its spectrum in cycles per
        unit of time, its change from the first half of the orbit to the second, and the digits to which averages over
        the halves agree.

    Raises
    ------
    UsageError
        If a column is unknown, or if the run has too few rows for a frequency or too many to fit in memory.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.frequencies("euler_attitude", component=["omega2"], overrides=["N=10000"])
    >>> abs(report.table.loc["omega2", "frequency"] / topcli.motion("euler_attitude")["frequency"] - 1) < 1e-6
    True
    """
    experiment = load_experiment(config, overrides)
    rows = experiment.N // experiment.output.every + 1
    if rows < 2 * LEAST_ROWS:
        raise UsageError(f"{rows} recorded rows: too few for frequencies; take at least {2 * LEAST_ROWS}")
    if rows > MOST_ROWS:
        least = math.ceil(experiment.N / (MOST_ROWS - 1))
        raise UsageError(f"output.every: {rows} recorded rows do not fit in memory; take {least} or more")
    everything = [*experiment.top.components, *(quantity.name for quantity in experiment.quantities)]
    names = list(component) or everything
    # an unknown name is refused before the run
    first = Rows(next(plans(experiment)), np.zeros(1, dtype=np.int64), np.array([experiment.y0], dtype=float))
    first.columns(names)
    watch.begin("frequencies", experiment)
    orbit, spacing = trajectory_of(experiment), experiment.h * experiment.output.every
    subject = f"{experiment.scheme.name} on {experiment.name}: {experiment.top.title}"
    title = f"{subject}, h = {experiment.h:g}, N = {experiment.N}"
    measured, notes, answer, errors = [], [], "", []
    if len(orbit) < rows:
        errors = [f"no frequencies: the run {orbit.ending.message}"]
    else:
        measured = plain([_line(name, orbit[name], spacing) for name in names])
        judged = [row for row in measured if row["digits"] is not None]
        answer, T = _answer(judged), abs(experiment.N * experiment.h)
        notes = [
            *_slow(judged),
            f"limits of {rows} rows over T = {T:g}: a frequency above {0.5 / abs(spacing):g} appears as a lower one, "
            f"and two lines closer than about {RESOLUTION / T:.2g} disturb each other",
        ]
    formats = {"frequency": ".12g", "period": ".6g", "change": two_digits, "digits": ".1f"}
    code = ExitCode.FAILED if errors else ExitCode.SUCCESS
    tables = [Table("Frequencies", measured, formats)]
    return Report("frequencies", title, answer, tables, notes, errors, code, experiment.resolved())


def _line(name: str, rows: Array, spacing: float) -> dict[str, Any]:
    """Strongest line of a column, its change from the first half to the second, and the digits of the average."""
    line, half, unit = strongest_line(rows), len(rows) // 2, abs(spacing)
    first, second = (strongest_line(part).frequency for part in (rows[:half], rows[half:]))
    frequency = line.frequency / unit
    return {
        "column": name, "frequency": frequency, "period": 1.0 / frequency if frequency else math.inf,
        "amplitude": line.amplitude, "change": (second - first) / unit, "digits": float(agreement_digits(rows)),
    }  # fmt: skip


def _answer(rows: Sequence[Mapping[str, Any]]) -> str:
    """Agreement of the halves of the orbit."""
    if not rows:
        return ""
    agree = f"averages over the halves agree to at least {min(row['digits'] for row in rows):.1f} digits"
    changed = [row for row in rows if row["change"] is not None]
    if not changed:
        return agree
    most = max(changed, key=lambda row: abs(row["change"]))
    change = f"{two_digits(abs(most['change']))} ({most['column']})"
    return f"from the first half of the orbit to the second, no frequency changes by more than {change}; {agree}"


def _slow(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Columns that are too slow for a frequency, or for its change."""
    notes = []
    for key, least in (("frequency", LEAST_CYCLES), ("change", 2.0 * LEAST_CYCLES)):
        if slow := [row["column"] for row in rows if row[key] is None]:
            notes.append(f"no {key} for {', '.join(slow)}: fewer than {least:g} cycles in the run; take a longer one")
    return notes
