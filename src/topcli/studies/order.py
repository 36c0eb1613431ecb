"""``topcli order``: errors over a ladder of step sizes, observed orders of convergence, the plateau of round-off."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated

from topcli.errors import ExitCode, UsageError, quoted, shortened
from topcli.studies import SILENT, Watch
from topcli.studies.study import (
    LADDER_STEPS,
    ConfigSource,
    Data,
    Faults,
    Flag,
    Head,
    Overrides,
    Result,
    SchemeNames,
    Study,
    TopName,
    cited_parts,
)
from topcli.table import EVERY, Column, Table, two_digits

FALSE = ("too low", "inconsistent")
"""Verdicts on a scheme whose declared order is false."""
FILE = Path("order") / "order.json"


def _sizes(texts: Sequence[str]) -> list[float]:
    """Step sizes of the options ``--h``. Raises UsageError."""
    try:
        return [float(text) for text in texts]
    except ValueError:
        given = [part.strip() for text in texts for part in text.split(",")]
        right = " ".join(f"--h {part}" for part in given)
        known = all(re.fullmatch(r"[-+.\deE]+", part) for part in given)
        raise UsageError(
            f"--h {quoted(','.join(texts))}: must be one number; "
            + (f"repeat the option for several: {shortened(right)}" if known else "for example --h 0.1 --h 0.05")
        ) from None


def measure(
    *schemes: SchemeNames,
    top: TopName = None,
    config: ConfigSource = None,
    overrides: Overrides = (),
    sizes: Annotated[Sequence[float], Flag("--h", "H", read=_sizes, default="a ladder")] = (),
    duration: Annotated[float | None, Flag("--duration", "T", default="10, or N*h")] = None,
    steps: Annotated[int, Flag("--steps", "N", least=1)] = LADDER_STEPS,
    watch: Watch = SILENT,
) -> Result:
    """Measure errors over h, observed orders and round-off.

    Errors are the largest over the run against a reference in double-double arithmetic. The order is fitted at the
    smallest steps above the plateau of round-off. Exits with status 4 if it is below the declared order, or if an
    invariant that a scheme declares to conserve is off by more than round-off, and with 3 if the code of some of the
    schemes fails.

    Parameters
    ----------
    *schemes : str
        Names of schemes; all by default. Without ``top`` and ``config``, six by default.
    top : str, optional
        Run the packaged scene of this top.
    config : path, str or mapping, optional
        Run this config or scene for its N*h. It gives the top, the initial state and the duration.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    sizes : sequence of float, optional
        Use this step size; repeat for several. By default a ladder for each scheme; dimensionless.
    duration : float, optional
        Run for the time T.
    steps : int, optional
        Take at most N steps in a run of a ladder.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Errors are the largest Euclidean norms of the difference of states from a Taylor reference in double-double
        arithmetic at common times. ``table`` has a row for each scheme, ``errors`` one for each step size.

    Raises
    ------
    UsageError
        For an unknown or unfit scheme or top, or a step size out of range.
    RunError
        If the reference cannot follow the motion.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.order("hk", "rk4", config="euler_hk", duration=2, sizes=[0.1, 0.05, 0.025])
    >>> report.table["order"].round(1).to_dict()
    {'hk': 2.0, 'rk4': 4.0}
    >>> report.errors.shape
    (3, 2)
    """
    from topcli.studies.order_ladders import ladders, order_source, order_study

    plan = ladders(schemes, top=top, config=config, sets=overrides, sizes=sizes, duration=duration, steps=steps)
    file = FILE if plan == ladders(()) else None
    watch.begin("order", plan.problem.experiment, file=file)
    used = [rung.value for rung in plan.rungs]
    for size in plan.sizes:
        taken = min(used, key=lambda value: abs(value - size))
        if abs(taken - size) > 1e-9 * size:
            watch.message(f"h = {size:g} becomes {taken:.6g}, which divides the time between comparisons")
    return Result(order_study(plan, watch), source=lambda: order_source(plan), file=file)


def _best(key: str) -> Callable[[Data], float | None]:
    """Figure of the point with the smallest error of a scheme."""

    def value(row: Data) -> float | None:
        known = [point for point in row["points"] if point["error"] is not None]
        return min(known, key=lambda point: point["error"])[key] if known else None

    return value


def _errors_at(data: Data) -> list[Data]:
    """Errors by scheme at each step size: nan if one is not finite, nothing if the scheme was not run."""
    errors: dict[float, Data] = {}
    for row in data["schemes"]:
        for point in row["points"]:
            error = math.nan if point["error"] is None else point["error"]
            errors.setdefault(point["h"], {"h": point["h"]})[row["scheme"]] = error
    return [errors[h] for h in sorted(errors, reverse=True)]


def _error_columns(data: Data) -> list[Column]:
    names = [row["scheme"] for row in data["schemes"]]
    return [
        Column("h", "h", "{:.4g}".format),
        *(Column(name, lambda row, name=name: row.get(name), two_digits, name) for name in names),
    ]


def _subject(data: Data) -> str:
    return f"{data['name']}: {data['top']}, t from 0 to {data['duration']:g}"


def _span(sizes: Sequence[float]) -> str:
    return f"{two_digits(sizes[0])} to {two_digits(sizes[-1])}"


ORDERS = Table(
    "schemes",
    (
        Column("scheme", "scheme"),
        Column("order", "declared_order"),
        Column("observed", "order", "{:.2f}".format),
        Column("verdict", "verdict"),
        Column("fitted over h", lambda row: row["fitted"] or None, _span),
        Column("round-off", "plateau", two_digits),
        Column("from h", "onset", two_digits),
        Column("", "ended"),
        Column("", "broken"),
        Column("smallest error", _best("error"), two_digits, "smallest_error"),
        Column("at h", _best("h"), two_digits, "at_h"),
    ),
    heading="Observed orders",
    title=_subject,
    index="scheme",
)
ERRORS = Table(
    _errors_at,
    _error_columns,
    name="errors",
    heading="Largest error at each h",
    title="largest error at each h",
    index="h",
    numbers=EVERY,
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    broken = sum(bool(row["broken"]) for row in data["schemes"])
    return Head("Orders of convergence", _subject(data), f"{broken} failed" if broken else "measured", not broken)


def notes(data: Data) -> Iterator[str]:
    """Schemes left out, step sizes without a result, and undecided orders."""
    for left in data["left_out"]:
        yield f"{left['scheme']} is left out: {left['reason']}"
    for row in data["schemes"]:
        if row["failed"] and not row["broken"]:
            first = row["failed"][0]
            failed = f"{len(row['failed'])} of its step sizes gave no result"
            yield f"{row['scheme']}: {failed}; h = {first['h']:.2g} {first['reason']}"
        if not row["broken"] and row["verdict"] not in FALSE and row["why"] and len(row["points"]) > 2:
            yield f"{row['scheme']}: order undecided: {row['why']}"


def faults(data: Data) -> Faults:
    """Code that failed, schemes without a result, and orders that are not as declared."""
    rows = data["schemes"]
    broken = [f"{row['scheme']}: {row['broken']}" for row in rows if row["broken"]]
    false = [f"{row['scheme']}: {row['why']}" for row in rows if not row["broken"] and row["verdict"] in FALSE]
    false += [f"{row['scheme']}: {row['false_claim']}" for row in rows if row.get("false_claim")]
    if broken:
        code = ExitCode.PARTLY_FAILED if len(broken) < len(rows) else ExitCode.WRONG_USAGE
    elif not all(row["points"] for row in rows):
        code = ExitCode.FAILED
    else:
        code = ExitCode.VIOLATED if false else ExitCode.SUCCESS
    return Faults(code, [*broken, *false])


ORDER = Study(
    "order",
    measure,
    head,
    (ORDERS, ERRORS),
    notes=notes,
    faults=faults,
    figure="topcli.figures.errors:loaded_order",
    draws="the errors over h into DIR/figures",
    captions=("largest error over the step size h, with observed orders",),
    parts=cited_parts,
    unit="schemes",
    file=FILE,
    known=lambda data: "duration" in data and "schemes" in data,
)
