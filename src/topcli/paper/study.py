"""``topcli claims``: test the claims of the paper by experiments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Annotated

from topcli.errors import ExitCode
from topcli.paper.claim import FAILS, HOLDS, NOT_TRIED, category_of, number_text, summary_of
from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Faults, Flag, Head, Result, Study
from topcli.table import Column, Table

if TYPE_CHECKING:
    from topcli.paper.decide import Claims, Decided


def _claim_names() -> Sequence[str]:
    from topcli.paper.ledger import claim_names

    return claim_names()


def measure(
    ids: Annotated[Sequence[str] | str, Flag("", "ID", names=_claim_names, default="all")] = (),
    *,
    fast: bool = False,
    watch: Watch = SILENT,
) -> Result:
    """Test the claims of the paper by experiments.

    Claims given by name are shown with all details. The command exits with code 4 if the verdict on a claim differs
    from the recorded one, or if a check accepts its control, a statement with a deliberate error.

    Parameters
    ----------
    ids : str or sequence of str, optional
        Names of the claims to test. An example is ``"hybrid-reversible"``. By default, all claims are tested.
    fast : bool, optional
        Skip claims that take longer than a few tenths of a second. Claims that are named are never skipped.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report on the claims. ``table`` has a row for each claim, with its statement, source, experiment, measured
        number, bound and verdict. ``rows`` contains the tested claims. ``controls`` contains the deliberate error that
        each kind of check must find. ``counts`` gives the number of claims with each verdict. ``changed`` lists the
        claims whose verdicts differ from the recorded ones, ``failed`` lists the claims that could not be tested, and
        ``uncaught`` lists the checks that missed their deliberate error. ``to_markdown()`` returns the documentation's
        page of claims as Markdown.

    Raises
    ------
    UnknownNameError
        If ``ids`` contains an unknown name. The message gives the nearest names.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.claims(["hybrid-k-sq", "hybrid-reversible"])
    >>> report.table["verdict"].tolist()
    ['holds', 'does not hold as stated']
    >>> report.changed, report.uncaught
    ((), ())
    """
    from topcli.paper.decide import decide_claims
    from topcli.paper.ledger import ledger

    ledger().chosen((ids,) if isinstance(ids, str) else ids, fast)
    watch.begin("claims")
    return decided_result(decide_claims(ids, fast=fast, on_progress=watch))


def decided_result(claims: Claims) -> Result:
    """Result of decided claims."""
    return Result(claims.as_dict(), of=claims)


TABLE = Table(
    "claims",
    (
        Column("id", "id"),
        *(Column("", key) for key in ("source", "experiment")),
        Column("verdict", "verdict", key=""),
        Column("measured", "figure", number_text, key="figure"),
        Column("bound", "bound_text", key="bound"),
        Column("source", "source", key="", detail=True),
        Column("statement", "statement"),
        *(Column("", key) for key in ("verdict", "note", "recorded", "seconds")),
    ),
    heading="Claims",
    index="id",
    numbers=False,
    marks={HOLDS: "good", FAILS: "bad"},
)


def _holds(row: Data) -> bool:
    return str(row["verdict"]).startswith(HOLDS)


EXCEPTIONS = Table(
    lambda data: [row for row in data["claims"] if not _holds(row)],
    TABLE.columns,
    name="exceptions",
    title="claims that do not hold as stated, or were not decided",
    numbers=False,
)
HOLDING = Table(
    lambda data: [row for row in data["claims"] if _holds(row)],
    TABLE.columns,
    name="holding",
    title="claims that hold",
    detail=True,
    numbers=False,
)


def printed(
    result: Result, verbose: bool, *, markdown: Annotated[bool, Flag("--markdown", alone=True)] = False
) -> Iterator[Table | str]:
    """Claims that do not hold, then with ``verbose`` the others; all details of claims that were named.

    Parameters
    ----------
    markdown : bool, optional
        Print the documentation page of the claims.
    """
    claims: Claims = result.of
    if markdown:
        from topcli.paper.page import claims_page

        yield claims_page(claims)
    elif claims.named:
        yield "\n".join(line for row in claims.rows for line in _details(row))
    else:
        yield answer(result.data)
        if EXCEPTIONS.content(result.data)[0]:
            yield EXCEPTIONS
        if verbose:
            yield HOLDING


def answer(data: Data) -> str:
    """Number of claims for each verdict."""
    counts = Counter(category_of(row["verdict"]) for row in data["claims"])
    return summary_of(dict(counts.most_common()))


def _details(row: Decided) -> Iterator[str]:
    """Everything about one claim, a line each."""
    claim, measured = row.claim, row.measurement
    yield f"{claim.id}: {row.verdict}"
    for label in ("statement", "source"):
        yield f"  {label}: {getattr(claim, label)}"
    yield f"  experiment: {claim.experiment_text.replace('`', '')}"
    if measured is None or row.bound is None:
        yield f"  reason: {row.reason}"
    else:
        yield f"  measured: {row.figure_text} ({row.check.measures})"
        if measured.corrected is not None:
            yield f"  corrected: {number_text(measured.corrected)}"
        yield f"  bound: {row.bound_text} ({row.bound.reason})"
        if measured.note:
            yield f"  note: {measured.note}"
    yield f"  control (a deliberate error that the check must detect): {row.check.defect}"


def head(data: Data) -> Head:
    """Head of the chapter."""
    about = "each with the measured value that decides it and its bound"
    return Head("Claims of the paper", about, "decided")


def notes(data: Data) -> Iterator[str]:
    """Claims that were not tried."""
    yield from (f"{row['id']}: {row['note']}" for row in data["claims"] if str(row.get("note")).startswith(NOT_TRIED))


def faults(data: Data) -> Faults:
    """Failed runs, verdicts that differ from the recorded ones, and checks that missed their deliberate error."""
    failed, changed = [], []
    for row in data["claims"]:
        if row["verdict"] == NOT_TRIED:
            if not row["note"].startswith(NOT_TRIED):
                failed.append(f"{row['id']}: {row['note']}")
        elif category_of(row["verdict"]) != row["recorded"]:
            changed.append(f"{row['id']}: the verdict is {row['verdict']!r}; recorded: {row['recorded']!r}")
    changed += [
        f"check {name!r}: did not detect its deliberate error: {control['defect']}"
        for name, control in data["controls"].items()
        if control["verdict"] != FAILS and not control["verdict"].startswith(NOT_TRIED)
    ]
    code = ExitCode.VIOLATED if changed else ExitCode.FAILED if failed else ExitCode.SUCCESS
    return Faults(code, [*failed, *changed])


CLAIMS = Study(
    "claims",
    measure,
    head,
    (TABLE,),
    answer=answer,
    printed=printed,
    frames=(EXCEPTIONS, HOLDING),
    notes=notes,
    faults=faults,
    figure="topcli.figures.outcomes:loaded_claims",
    draws="",
    captions=("statements with each verdict, by parts of the paper",),
    unit="checks",
    known=lambda data: isinstance(data.get("claims"), list),
    extras={
        **{
            name: attrgetter(f"of.{name}")
            for name in ("rows", "controls", "summary", "counts", "changed", "failed", "uncaught")
        },
        "to_markdown": lambda result: partial(_page, result.of),
    },
)


def _page(claims: Claims) -> str:
    """Page of the documentation with the claims."""
    from topcli.paper.page import claims_page

    return claims_page(claims)
