"""``topcli check``: what schemes and tops declare against what is measured, each with a positive control."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from topcli.errors import ExitCode
from topcli.studies import SILENT, Watch
from topcli.studies.study import ConfigSource, Data, Faults, Flag, Head, Result, Study, TopName
from topcli.table import Column, Table, number


def measure(
    file: Annotated[str | Path | None, Flag("", "FILE")] = None,
    schemes: Annotated[Sequence[str], Flag("--scheme", "SCHEME")] = (),
    top: TopName = None,
    config: ConfigSource = None,
    watch: Watch = SILENT,
) -> Result:
    """Check what schemes and tops declare, with controls.

    Of a scheme: order, self-adjointness, exact and modified invariants, counters, machine code against plain Python,
    ensembles against single runs. Of a top: its field, and its integrals by their exact rate of change and on random
    states. Each check is also put to something that must fail it, the control. Exits with status 4 if a declaration
    is false.

    Parameters
    ----------
    file : path or str, optional
        Python file, as for --plugin; check its tops and schemes.
    schemes : sequence of str, optional
        Check this scheme; repeat for several.
    top : str, optional
        Check this top, and schemes on it.
    config : path, str or mapping, optional
        Start from this config's state; by default a generic one.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` has a row for each check: what is declared, what is measured and allowed, what the control gives, and
        the verdict.

    Raises
    ------
    UsageError
        For an unknown scheme or top, and for a file that cannot be loaded.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.check(schemes=["hk"], top="euler")
    >>> set(report.table["verdict"])
    {'holds', 'not tried'}
    """
    from topcli.studies.check_declarations import check_study, plan

    chosen = plan(file, schemes, top, config)
    watch.begin("check")
    return Result(check_study(chosen, watch))


def _subject(data: Data) -> str:
    names = [*data["tops"], *(f"{name} ({form})" for form, name in data["schemes"])]
    return ", ".join(names)


CHECKS = Table(
    "rows",
    (
        Column("of", "subject"),
        Column("check", "check"),
        Column("declared", "declared"),
        Column("measured", "measured", number),
        Column("allowed", "allowed", number),
        Column("control", "control", number),
        Column("verdict", "verdict"),
    ),
    heading="Declarations",
    title=_subject,
    keys=2,
    numbers=(3, 4, 5),
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    false = len(faults(data).lines)
    return Head("Declarations", _subject(data), f"{false} false" if false else "hold", not false)


def notes(data: Data) -> Iterator[str]:
    """Reasons of what was not decided, and orders above the declared ones."""
    yield "control: the same check of something that must fail it"
    for row in data["rows"]:
        declared = row["verdict"] in ("not tried", "undecided") and row["declared"]
        if not row["broken"] and row["why"] and (declared or row["verdict"] == "holds"):
            yield f"{row['subject']}: {row['check']}: {row['why']}"


def faults(data: Data) -> Faults:
    """False declarations, and code that failed."""
    broken = list(dict.fromkeys(f"{row['subject']}: {row['broken']}" for row in data["rows"] if row["broken"]))
    false = [
        f"{row['subject']}: {row['check']}: " + (row["why"] or f"{number(row['measured'])} > {number(row['allowed'])}")
        for row in data["rows"]
        if row["verdict"] == "false"
    ]
    blind = [
        f"{row['subject']}: {row['check']}: undecided, because the control passes too"
        for row in data["rows"]
        if row["verdict"] == "undecided" and not row["why"]
    ]
    if false:
        code = ExitCode.VIOLATED
    elif broken:
        code = ExitCode.WRONG_USAGE
    else:
        code = ExitCode.FAILED if blind else ExitCode.SUCCESS
    return Faults(code, [*broken, *false, *blind])


CHECK = Study(
    "check",
    measure,
    head,
    (CHECKS,),
    notes=notes,
    faults=faults,
    parts=lambda data: [(form, name) for form, name in data["schemes"]],
    unit="parts",
    saved=True,
    stem=lambda data: "check",
    known=lambda data: "rows" in data and "tops" in data,
)
