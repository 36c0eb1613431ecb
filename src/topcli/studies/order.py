"""``topcli order``: measure errors over several step sizes, observed orders of convergence, and round-off."""

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
    Config,
    Data,
    Faults,
    Flag,
    Head,
    Overrides,
    Result,
    Study,
    cited_parts,
    config_flag,
    scheme_names,
    top_flag,
)
from topcli.table import EVERY, Column, Table, two_digits

AS_DECLARED = "as declared"
FALSE = ("too low", "inconsistent")
"""Verdicts on a scheme whose declared order is false."""
FILE = Path("order") / "order.json"


def _sizes(texts: Sequence[str], option: str = "--h") -> list[float]:
    """Numbers of an option, step sizes of ``--h``. Raises UsageError."""
    try:
        return [float(text) for text in texts]
    except ValueError:
        if option != "--h":
            raise UsageError(f"{option}={shortened(texts[0])}: must be a number") from None
        given = [part.strip() for text in texts for part in text.split(",")]
        right = " ".join(f"--h {part}" for part in given)
        known = all(re.fullmatch(r"[-+.\deE]+", part) for part in given)
        raise UsageError(
            f"--h {quoted(','.join(texts))}: must be one number; "
            + (f"repeat the option for several: {shortened(right)}" if known else "for example --h 0.1 --h 0.05")
        ) from None


def _settings(
    overrides: Sequence[str], sizes: Sequence[float], duration: float | None, config: Config
) -> tuple[Sequence[str], Sequence[float], float | None]:
    """Overrides without h, and without T if there is no config; step sizes and duration with these."""
    rest = []
    for text in overrides:
        key, _, value = (part.strip() for part in text.partition("="))
        if key == "h":
            sizes = [*sizes, *_sizes([value])]
        elif key == "T" and config is None and duration is None:
            duration = _sizes([value], "--set T")[0]
        else:
            rest.append(text)
    return rest, sizes, duration


def measure(
    *schemes: Annotated[str, scheme_names("six common schemes; with --top or --config, all that fit the top")],
    top: Annotated[str | None, top_flag("the top of the schemes")] = None,
    config: Annotated[Config, config_flag("a packaged scene")] = None,
    overrides: Overrides = (),
    sizes: Annotated[Sequence[float], Flag("--h", "H", read=_sizes, default="chosen for each scheme")] = (),
    duration: Annotated[float | None, Flag("--duration", "T", default="10, or that of the config")] = None,
    steps: Annotated[int, Flag("--max-steps", "N", least=1)] = LADDER_STEPS,
    watch: Watch = SILENT,
) -> Result:
    """Measure errors at several h, and orders of convergence.

    The error of a run is its largest distance from a reference solution in double-double arithmetic. The order is
    fitted at the smallest step sizes whose errors exceed round-off. The command exits with code 4 if the
    measured order is below the order that the scheme declares, or if an invariant that the scheme declares as conserved
    changes by more than round-off.

    Parameters
    ----------
    *schemes : str
        Names of schemes. Without names, all schemes that fit ``top`` or ``config`` are measured, or six schemes of the
        Kowalevski top if neither ``top`` nor ``config`` is given.
    top : str, optional
        Name of a top, whose packaged scene is run.
    config : path, str or mapping, optional
        Config or scene that gives the top, the initial state and the duration N*h.
    overrides : sequence of str, optional
        Override a key of the config, e.g. top.c0=-1 or scheme.branch=sign. The keys h and T set ``sizes`` and
        ``duration``.
    sizes : sequence of float, optional
        Run each scheme with these step sizes. By default, each scheme is run with its own decreasing step sizes,
        until round-off dominates or a run would need more than ``steps`` steps.
    duration : float, optional
        Run from time 0 to this time.
    steps : int, optional
        Take at most this many steps in each run.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report with the orders and the errors. The error of a run is the largest Euclidean distance between its states
        and the reference solution, a Taylor series, at evenly spaced times. ``table`` has a row for each scheme.
        ``errors`` has a row for each step size and a column for each scheme.

    Raises
    ------
    UsageError
        If a scheme or top is unknown, if a scheme does not fit the top, or if a step size is too small or too large.
    RunError
        If the reference solution of the motion cannot be computed.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.order("hk", "rk4", config="euler_hk", duration=2, sizes=[0.1, 0.05, 0.025])
    >>> report.table["order"].round(1).to_dict()
    {'hk': 2.0, 'rk4': 4.0}
    >>> report.errors.shape
    (3, 2)
    """
    from topcli.studies.order_ladders import ladders, order_study

    overrides, sizes, duration = _settings(overrides, sizes, duration, config)
    plan = ladders(schemes, top=top, config=config, sets=overrides, sizes=sizes, duration=duration, steps=steps)
    file = FILE if plan == ladders(()) else None
    watch.begin("order", plan.problem.experiment, file=file)
    used, interval = [rung.value for rung in plan.rungs], plan.problem.interval
    for size in plan.sizes:
        taken = min(used, key=lambda value: abs(value - size))
        if abs(taken - size) > 1e-9 * size:
            multiple = f"so that the time between comparisons, {interval:g}, is a multiple of h"
            watch.message(f"h = {size:g} becomes {taken:.6g}, {multiple}")
    return Result(order_study(plan, watch), file=file)


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


def _step_size(h: float) -> str:
    """A step size with two digits, or with three if these are all."""
    text = f"{h:.3g}"
    return text if float(text) == h else two_digits(h)


ORDERS = Table(
    "schemes",
    (
        Column("scheme", "scheme"),
        Column("declared order", "declared_order"),
        Column("observed", "order", "{:.2f}".format),
        Column("verdict", "verdict"),
        Column("h of the fit", lambda row: row["fitted"] or None, _span, detail=True),
        Column("round-off", "plateau", two_digits, detail=True),
        Column("from h", "onset", two_digits, detail=True),
        Column("", "ended"),
        Column("", "broken"),
        Column("smallest error", _best("error"), two_digits, "smallest_error"),
        Column("at h", _best("h"), _step_size, "at_h"),
    ),
    heading="Observed orders",
    title=_subject,
    index="scheme",
    numbers=(1, 2, 4, 5, 6, 7, 8),
)
ERRORS = Table(
    _errors_at,
    _error_columns,
    name="errors",
    heading="Largest error at each h",
    title="largest error at each h",
    index="h",
    detail=True,
    numbers=EVERY,
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    broken = sum(bool(row["broken"]) for row in data["schemes"])
    return Head("Orders of convergence", _subject(data), f"{broken} failed" if broken else "measured", not broken)


def answer(data: Data) -> str:
    """Schemes by verdict, with their observed orders."""
    named: dict[str, list[str]] = {}
    for row in data["schemes"]:
        verdict = "failed" if row["broken"] else row["verdict"] or "no declared order"
        order = "" if row["order"] is None else f" {row['order']:.2f}"
        named.setdefault(verdict, []).append(row["scheme"] + order)
    good = named.pop(AS_DECLARED, [])
    parts = [f"order as declared: {', '.join(good)}"] if good else []
    return "; ".join([*parts, *(f"{verdict}: {', '.join(names)}" for verdict, names in named.items())])


def notes(data: Data) -> Iterator[str]:
    """Schemes left out, step sizes without a result, and undecided orders."""
    for left in data["left_out"]:
        yield f"{left['scheme']} is left out: {left['reason']}"
    undecided: dict[str, list[str]] = {}
    for row in data["schemes"]:
        if row["failed"] and not row["broken"]:
            first = row["failed"][0]
            failed = f"{len(row['failed'])} of its step sizes gave no result"
            yield f"{row['scheme']}: {failed}; h = {first['h']:.2g} {first['reason']}"
        if row["points"] and not row["broken"] and row["verdict"] not in FALSE and row["why"]:
            undecided.setdefault(row["why"], []).append(row["scheme"])
    for why, names in undecided.items():
        yield f"{', '.join(names)}: order undecided: {why}"


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
    answer=answer,
    notes=notes,
    faults=faults,
    figure="topcli.figures.errors:loaded_order",
    draws="the errors against h",
    captions=("largest error against the step size h, with the observed orders",),
    parts=cited_parts,
    unit="schemes",
    file=FILE,
    known=lambda data: "duration" in data and "schemes" in data,
)
