"""``topcli claims``: decide the claims of the paper."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from topcli.cli.options import Json
from topcli.cli.output import ProgressDisplay, emit, emit_prose, emit_text, print_cells, print_json, print_message

if TYPE_CHECKING:
    from topcli.paper.decide import Claims, Decided


def complete_claim(incomplete: str) -> list[str]:
    """Names of claims that begin with ``incomplete``."""
    from topcli.paper.ledger import claim_names

    return [name for name in claim_names() if name.startswith(incomplete.lower())]


def _print_details(row: Decided) -> None:
    """Print everything about one claim, a line each."""
    claim, measured = row.claim, row.measurement
    emit(f"{claim.id}: {row.verdict}")
    lines = {
        "statement": claim.statement,
        "origin": claim.origin,
        "source": claim.source,
        "experiment": claim.experiment_text.replace("`", ""),
    }
    if measured is None or row.bound is None:
        lines["reason"] = row.reason
    else:
        lines["figure"] = f"{row.figure_text} ({row.check.measures})"
        if measured.corrected is not None:
            from topcli.paper.claim import number_text

            lines["corrected"] = number_text(measured.corrected)
        lines["bound"] = f"{row.bound_text} ({row.bound.reason})"
        if measured.note:
            lines["note"] = measured.note
    lines["control"] = row.check.defect
    for label, text in lines.items():
        emit_prose(f"{label}: {text}", indent="  ")


def _judge(decided: Claims) -> None:
    """Report what differs from the record, and exit with 4 if anything does, with 1 if a run failed."""
    for row in decided.rows:
        if row.measurement is None:
            print_message(f"{'error: ' if row.failed else ''}{row.claim.id}: {row.reason}")
    for row in decided.rows:
        if row.changed:
            print_message(f"error: {row.claim.id}: the verdict is {row.verdict!r}; recorded: {row.claim.recorded!r}")
    for control in decided.controls:
        if not control.caught:
            print_message(
                f"error: check {control.check.name!r}: did not find its positive control: {control.check.defect}"
            )
    if decided.changed or decided.uncaught:
        raise typer.Exit(4)
    if decided.failed:
        raise typer.Exit(1)


def report_claims(decided: Claims, details: bool, as_json: bool, as_markdown: bool) -> None:
    """Print decided claims, and exit with 4 or 1 if something is wrong with them."""
    if as_json:
        print_json("claims", decided.as_dict())
    elif as_markdown:
        from topcli.paper.page import claims_page

        emit_text(claims_page(decided))
    elif details:
        for row in decided.rows:
            _print_details(row)
    else:
        from topcli.paper.page import CLAIMS

        print_cells(CLAIMS.cells(decided.as_dict()))
    if not as_markdown:
        print_message(decided.summary)
    _judge(decided)


def claims(
    ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="ID", help="Names of claims; all by default.", autocompletion=complete_claim),
    ] = None,
    fast: Annotated[bool, typer.Option("--fast", help="Leave out claims that take longer.")] = False,
    as_json: Json = False,
    as_markdown: Annotated[
        bool, typer.Option("--markdown", help="Print the documentation page of the claims.")
    ] = False,
) -> None:
    """Decide the paper's claims by experiments.

    Findings beyond the paper are marked as ours. Claims that are named are shown with all details. Exits with status 4
    if a verdict differs from the recorded one, or if a check does not find the defect of its positive control.
    """
    from topcli.errors import UsageError
    from topcli.paper.decide import decide_claims
    from topcli.paper.ledger import ledger

    if as_json and as_markdown:
        raise UsageError("--json and --markdown exclude each other; choose one")
    ledger().chosen(ids or (), fast)
    display = ProgressDisplay(1, as_json or as_markdown, unit="checks")
    display.begin("claims")
    try:
        decided = decide_claims(ids or (), fast=fast, on_progress=display)
    finally:
        display.close()
    report_claims(decided, bool(ids), as_json, as_markdown)
