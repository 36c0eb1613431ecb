"""``topcli check``: compare the declared properties of schemes and tops with measurements."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from topcli.errors import ExitCode, counted
from topcli.studies import SILENT, Watch
from topcli.studies.study import Config, Data, Faults, Flag, Head, Result, Study, config_flag, top_flag
from topcli.table import Column, Table, number, two_digits
from topcli.tops import TOPS


def measure(
    file: Annotated[str | Path | None, Flag("", "FILE")] = None,
    schemes: Annotated[Sequence[str], Flag("--scheme", "SCHEME", default="the schemes of the file or of the top")] = (),
    top: Annotated[str | None, top_flag("the tops of the file or of the schemes")] = None,
    config: Annotated[Config, config_flag("a generic state")] = None,
    watch: Watch = SILENT,
) -> Result:
    """Check the declared properties of schemes and tops.

    For a scheme, the study checks order, self-adjointness, and exact and modified invariants. It also checks that
    compiled code agrees with plain Python, that ensembles agree with single runs, and that the counters of critical
    events, which some schemes have, are finite. For a top, it checks the equations and the integrals. Each check is
    also applied to a control, a deliberately wrong scheme or top, which it must reject. The command exits with code 4
    if a scheme or top is not as declared.

    Parameters
    ----------
    file : path or str, optional
        Python file with the tops and schemes to check.
    schemes : sequence of str, optional
        Names of the schemes to check; by default, those of the file or of the top.
    top : str, optional
        Name of the top to check, together with its schemes.
    config : path, str or mapping, optional
        Config with the initial state of the checks; by default, a generic state.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report on the checks. ``table`` has a row for each check, with the declared property, the measured and the
        allowed value, the value of the control (a deliberately wrong variant, which must fail the check), and the
        verdict.

    Raises
    ------
    UsageError
        If a scheme or top is unknown, or if a file cannot be loaded.

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
    names = [*map(TOPS.called, data["tops"]), *(f"{name} ({TOPS.called(form)})" for form, name in data["schemes"])]
    return ", ".join(names)


CHECKS = Table(
    "rows",
    (
        Column("of", "subject"),
        Column("check", "check"),
        Column("declared", "declared", detail=True),
        Column("measured", "measured", two_digits),
        Column("allowed", "allowed", two_digits),
        Column("control, which must fail", "control", two_digits, detail=True),
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


def answer(data: Data) -> str:
    """Numbers of checks by verdict."""
    counts = Counter(row["verdict"] for row in data["rows"])
    false, holding = counts.pop("false", 0), counts.pop("holds", 0)
    said = "".join(f", {count} {verdict}" for verdict, count in counts.items())
    wrong = f"{counted(false, 'declaration')} false" if false else "no declaration is false"
    return f"{wrong}; {holding} hold{said}"


def notes(data: Data) -> Iterator[str]:
    """Reasons of what was not decided, and orders above the declared ones."""
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
    answer=answer,
    notes=notes,
    faults=faults,
    parts=lambda data: [(form, name) for form, name in data["schemes"]],
    unit="parts",
    stem=lambda data: "check",
    known=lambda data: "rows" in data and "tops" in data,
)
