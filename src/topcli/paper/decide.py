"""Carry out the experiments of the ledger, and each kind of check on its positive control."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from topcli.errors import RunError
from topcli.paper.claim import NOT_TRIED, Claim, Finding, Kind
from topcli.paper.decided import Control, Decided
from topcli.paper.ledger import chosen
from topcli.paper.recorded import RECORDED
from topcli.paper.result import Claims


def decided(claim: Claim) -> Decided:
    """Carry out the experiment of one claim, and compare its verdict with the recorded one.

    A claim whose experiment needs a package that is not installed, or fails, is "not tried".
    """
    start = time.perf_counter()
    finding, reason, failed = _tried(claim.decide)
    return Decided(claim, finding, reason, RECORDED.get(claim.id), time.perf_counter() - start, failed)


def _tried(check: Callable[[], Finding]) -> tuple[Finding | None, str, bool]:
    """Finding of a check; if there is none, the reason, and True if a run failed instead of lacking a package."""
    try:
        return check(), "", False
    except ModuleNotFoundError as error:
        return None, f"{NOT_TRIED}: needs the package {error.name}, which is not installed", False
    except RunError as error:
        return None, str(error).splitlines()[0], True


def decide_claims(
    ids: str | Sequence[str] = (), *, fast: bool = False, on_progress: Callable[[int, int], None] | None = None
) -> Claims:
    """Decide the claims with these names, by default all; with ``fast`` slow ones are left out unless they are named.

    ``on_progress(done, total)`` is called after each check. Raises UnknownNameError with the nearest names.
    """
    wanted = chosen((ids,) if isinstance(ids, str) else ids, fast)
    kinds: list[Kind] = list(dict.fromkeys(claim.kind for claim in wanted))
    report = on_progress or (lambda done, total: None)
    total = len(wanted) + len(kinds)
    rows: list[Decided] = []
    for claim in wanted:
        rows.append(decided(claim))
        report(len(rows), total)
    controls: list[Control] = []
    for kind in kinds:
        finding, reason, failed = _tried(kind.control)
        controls.append(Control(kind, finding, reason, failed))
        report(len(rows) + len(controls), total)
    return Claims(tuple(rows), tuple(controls))
