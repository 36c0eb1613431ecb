"""``topcli claims``: decide the claims of the paper."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from topcli.cli.options import Json
from topcli.cli.output import ProgressDisplay, emit, emit_prose, emit_text, print_json, print_message, print_table

if TYPE_CHECKING:
    from topcli.paper.decided import Decided
    from topcli.paper.result import Claims


def complete_claim(incomplete: str) -> list[str]:
    """Names of claims that begin with ``incomplete``."""
    from topcli.paper.ledger import claim_names

    return [name for name in claim_names() if name.startswith(incomplete.lower())]


def _figure(row: Decided) -> str:
    from topcli.paper.claim import number_text

    return number_text(row.finding.figure) if row.finding else "–"


def _print_table(found: Claims) -> None:
    rows = [
        [
            row.claim.id,
            row.claim.origin,
            row.claim.statement,
            row.verdict,
            _figure(row),
            row.finding.bound.text if row.finding else "–",
            row.claim.source,
        ]
        for row in found.rows
    ]
    print_table(["id", "origin", "statement", "verdict", "figure", "bound", "source"], rows, numbers=False)


def _print_details(row: Decided) -> None:
    """Print everything about one claim, a line each."""
    claim, finding = row.claim, row.finding
    emit(f"{claim.id}: {row.verdict}")
    lines = {
        "statement": claim.statement,
        "origin": claim.origin,
        "source": claim.source,
        "experiment": claim.experiment.replace("`", ""),
    }
    if finding is None:
        lines["reason"] = row.reason
    else:
        lines["figure"] = f"{_figure(row)} {finding.bound.unit}".rstrip() + f" ({claim.kind.measures})"
        if finding.corrected is not None:
            from topcli.paper.claim import number_text

            lines["corrected"] = number_text(finding.corrected)
        lines["bound"] = f"{finding.bound.text} ({finding.bound.reason})"
        if finding.note:
            lines["note"] = finding.note
    lines["control"] = claim.kind.defect
    for label, text in lines.items():
        emit_prose(f"{label}: {text}", indent="  ")


def _judge(found: Claims) -> None:
    """Report what differs from the record, and exit with 4 if anything does, with 1 if a run failed."""
    for row in found.rows:
        if row.finding is None:
            print_message(f"{'error: ' if row.failed else ''}{row.claim.id}: {row.reason}")
    for row in found.rows:
        if row.changed:
            print_message(
                f"error: {row.claim.id}: the verdict is {row.verdict!r}; recorded: {row.recorded or 'none'!r}"
            )
    for control in found.controls:
        if not control.caught:
            print_message(
                f"error: check {control.kind.name!r}: did not find its positive control: {control.kind.defect}"
            )
    if found.changed or found.blunt:
        raise typer.Exit(4)
    if found.failed:
        raise typer.Exit(1)


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
    from topcli.paper.ledger import chosen

    if as_json and as_markdown:
        raise UsageError("--json and --markdown exclude each other; choose one")
    chosen(ids or (), fast)
    display = ProgressDisplay(1, as_json or as_markdown, unit="checks")
    display.begin("claims")
    try:
        found = decide_claims(ids or (), fast=fast, on_progress=display)
    finally:
        display.close()
    if as_json:
        print_json("claims", found.as_dict())
    elif as_markdown:
        emit_text(found.to_markdown())
    elif ids:
        for row in found.rows:
            _print_details(row)
    else:
        _print_table(found)
    if not as_markdown:
        print_message(found.summary)
    _judge(found)
