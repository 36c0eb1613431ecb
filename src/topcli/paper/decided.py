"""One decided claim, and one positive control, as plain data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from topcli.paper.claim import FAILS, HOLDS_WITHIN, NOT_TRIED, Bound, Claim, Finding, Kind
from topcli.runs.report import finite


@dataclass(frozen=True)
class Decided:
    """One claim with its ``finding``; without one, ``reason`` says why it was not tried.

    ``recorded`` is the verdict of the repository, None if there is none yet. ``failed`` is True if a run of the
    experiment failed.
    """

    claim: Claim
    finding: Finding | None
    reason: str
    recorded: str | None
    seconds: float
    failed: bool = False

    @property
    def category(self) -> str:
        """Verdict without the bound."""
        return self.finding.verdict if self.finding else NOT_TRIED

    @property
    def verdict(self) -> str:
        """Verdict as it is shown: of an approximate statement with the bound."""
        if self.finding is None or self.category != HOLDS_WITHIN:
            return self.category
        return f"{HOLDS_WITHIN} {self.finding.bound.text.removeprefix('≤ ')}"

    @property
    def changed(self) -> bool:
        """True if the verdict differs from the recorded one; never for a claim that was not tried."""
        return self.finding is not None and self.category != self.recorded

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON; ``figure`` is None if it is not finite."""
        claim, finding = self.claim, self.finding
        return finite(
            {
                "id": claim.id,
                "origin": claim.origin,
                "statement": claim.statement,
                "source": claim.source,
                "kind": claim.kind.name,
                "measures": claim.kind.measures,
                "experiment": claim.experiment.replace("`", ""),
                "figure": finding.figure if finding else None,
                "corrected": finding.corrected if finding else None,
                "bound": bound_data(finding.bound) if finding else None,
                "bound_text": finding.bound.text if finding else None,
                "bound_reason": finding.bound.reason if finding else None,
                "note": finding.note if finding else self.reason,
                "verdict": self.verdict,
                "recorded": self.recorded,
                "slow": claim.slow,
                "seconds": self.seconds,
            }
        )


def bound_data(bound: Bound) -> dict[str, float | None]:
    """Ends of a bound, None where it has none."""
    return {"low": bound.low if math.isfinite(bound.low) else None, "high": bound.high}


@dataclass(frozen=True)
class Control:
    """Result of a kind of check on its positive control."""

    kind: Kind
    finding: Finding | None
    reason: str
    failed: bool = False

    @property
    def caught(self) -> bool:
        """True if the check found the defect, or lacked a package."""
        return not self.failed if self.finding is None else self.finding.verdict == FAILS

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return finite(
            {
                "measures": self.kind.measures,
                "defect": self.kind.defect,
                "figure": self.finding.figure if self.finding else None,
                "bound": bound_data(self.finding.bound) if self.finding else None,
                "bound_text": self.finding.bound.text if self.finding else None,
                "verdict": self.finding.verdict if self.finding else self.reason,
            }
        )
