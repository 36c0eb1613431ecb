"""Decided claims together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from topcli.paper.decided import Control, Decided
from topcli.paper.page import claims_page


def counted(verdicts: Sequence[str]) -> dict[str, int]:
    """Number of times that each verdict occurs, most frequent first."""
    return dict(sorted(Counter(verdicts).items(), key=lambda item: (-item[1], item[0])))


@dataclass(frozen=True, repr=False)
class Claims:
    """Claims of the paper and findings beyond it, with their verdicts.

    Attributes
    ----------
    rows : tuple of Decided
        The claims, in the order of the ledger.
    controls : tuple of Control
        The positive control of each kind of check that was used.
    """

    rows: tuple[Decided, ...]
    controls: tuple[Control, ...]

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def summary(self) -> str:
        """Number of claims of the paper and of findings of ours, each with the number for each verdict."""
        parts = []
        for counts, noun in ((self.counts, "claim{} of the paper"), (self.findings, "finding{} of ours")):
            if counts:
                total = sum(counts.values())
                verdicts = ", ".join(f"{verdict}: {count}" for verdict, count in counts.items())
                parts.append(f"{total} {noun.format('s' if total > 1 else '')}; {verdicts}")
        return ". ".join(parts)

    @property
    def counts(self) -> dict[str, int]:
        """Number of claims of the paper for each verdict, most frequent first."""
        return counted([row.category for row in self.rows if not row.claim.ours])

    @property
    def findings(self) -> dict[str, int]:
        """Number of findings of ours for each verdict, most frequent first."""
        return counted([row.category for row in self.rows if row.claim.ours])

    @property
    def changed(self) -> tuple[str, ...]:
        """Names of the claims whose verdict differs from the recorded one."""
        return tuple(row.claim.id for row in self.rows if row.changed)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the claims of which a run failed."""
        return tuple(row.claim.id for row in self.rows if row.failed)

    @property
    def blunt(self) -> tuple[str, ...]:
        """Names of the kinds of checks that did not find the defect of their positive control."""
        return tuple(control.kind.name for control in self.controls if not control.caught)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON: the list ``claims``, and ``controls`` and numbers of verdicts by name.

        ``verdicts`` counts the claims of the paper, ``findings`` what is beyond it.
        """
        return {
            "claims": [row.as_dict() for row in self.rows],
            "controls": {control.kind.name: control.as_dict() for control in self.controls},
            "verdicts": self.counts,
            "findings": self.findings,
        }

    def to_markdown(self) -> str:
        """Page of the documentation with the claims."""
        return claims_page(self.rows, self.controls, self.summary)
