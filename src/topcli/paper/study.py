"""``topcli claims``: the claims of the paper and findings beyond it, decided by experiments."""

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
    ids: Annotated[Sequence[str] | str, Flag("", "ID", names=_claim_names)] = (),
    *,
    fast: bool = False,
    watch: Watch = SILENT,
) -> Result:
    """Decide the paper's claims by experiments.

    Findings beyond the paper are marked as ours. Claims that are named are shown with all details. Exits with status 4
    if a verdict differs from the recorded one, or if a check does not find the defect of its positive control.

    Parameters
    ----------
    ids : str or sequence of str, optional
        Names of claims; all by default. For example ``"hybrid-reversible"``.
    fast : bool, optional
        Leave out claims that take longer. These take more than a few tenths of a second; a claim that is named is not
        left out.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` has a row for each claim: origin, statement, source, experiment, figure, bound, verdict. ``rows`` are
        the decided claims and ``controls`` the positive controls of the kinds of checks; ``counts`` and ``findings``
        are the numbers of verdicts on the paper and beyond it, and ``changed``, ``failed`` and ``uncaught`` the names
        of what differs from the record. ``to_markdown()`` is the page of the documentation.

    Raises
    ------
    UnknownNameError
        If there is no such claim; the message names the nearest ones.

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
        Column("origin", "origin"),
        Column("statement", "statement"),
        *(Column("", key) for key in ("source", "experiment")),
        Column("verdict", "verdict", key=""),
        Column("figure", "figure", number_text),
        Column("bound", "bound_text", key="bound"),
        Column("source", "source", key=""),
        *(Column("", key) for key in ("verdict", "note", "recorded", "seconds")),
    ),
    heading="Claims",
    index="id",
    numbers=False,
    marks={HOLDS: "good", FAILS: "bad"},
)


def printed(
    result: Result, *, markdown: Annotated[bool, Flag("--markdown", alone=True)] = False
) -> Iterator[Table | str]:
    """The table; of claims that were named, all details.

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
        yield TABLE


def _details(row: Decided) -> Iterator[str]:
    """Everything about one claim, a line each."""
    claim, measured = row.claim, row.measurement
    yield f"{claim.id}: {row.verdict}"
    for label in ("statement", "origin", "source"):
        yield f"  {label}: {getattr(claim, label)}"
    yield f"  experiment: {claim.experiment_text.replace('`', '')}"
    if measured is None or row.bound is None:
        yield f"  reason: {row.reason}"
    else:
        yield f"  figure: {row.figure_text} ({row.check.measures})"
        if measured.corrected is not None:
            yield f"  corrected: {number_text(measured.corrected)}"
        yield f"  bound: {row.bound_text} ({row.bound.reason})"
        if measured.note:
            yield f"  note: {measured.note}"
    yield f"  control: {row.check.defect}"


def head(data: Data) -> Head:
    """Head of the chapter."""
    parts = []
    for origin, title in (("paper", ""), ("ours", "findings of ours: ")):
        counted = Counter(category_of(row["verdict"]) for row in data["claims"] if row["origin"] == origin)
        if counted:
            parts.append(title + ", ".join(f"{count} {verdict}" for verdict, count in counted.most_common()))
    about = "each with the figure that decides it and its bound"
    return Head("Claims of the paper", about, "decided", message="; ".join(parts))


def notes(data: Data) -> Iterator[str]:
    """Numbers of claims for each verdict, and claims that were not tried."""
    if summary := summary_of(data.get("verdicts", {}), data.get("findings", {})):
        yield summary
    yield from (f"{row['id']}: {row['note']}" for row in data["claims"] if str(row.get("note")).startswith(NOT_TRIED))


def faults(data: Data) -> Faults:
    """Failed runs, verdicts that differ from the record, and checks that did not find their defect."""
    failed, changed = [], []
    for row in data["claims"]:
        if row["verdict"] == NOT_TRIED:
            if not row["note"].startswith(NOT_TRIED):
                failed.append(f"{row['id']}: {row['note']}")
        elif category_of(row["verdict"]) != row["recorded"]:
            changed.append(f"{row['id']}: the verdict is {row['verdict']!r}; recorded: {row['recorded']!r}")
    changed += [
        f"check {name!r}: did not find its positive control: {control['defect']}"
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
    printed=printed,
    notes=notes,
    faults=faults,
    figure="topcli.figures.outcomes:loaded_claims",
    draws="",
    captions=("statements with each verdict, by parts of the paper; findings beyond it apart",),
    unit="checks",
    known=lambda data: isinstance(data.get("claims"), list),
    extras={
        **{
            name: attrgetter(f"of.{name}")
            for name in ("rows", "controls", "summary", "counts", "findings", "changed", "failed", "uncaught")
        },
        "to_markdown": lambda result: partial(_page, result.of),
    },
)


def _page(claims: Claims) -> str:
    """Page of the documentation with the claims."""
    from topcli.paper.page import claims_page

    return claims_page(claims)
