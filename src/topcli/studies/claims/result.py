"""Decided claims together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from topcli.studies.claims.decided import Control, Decided
from topcli.studies.claims.page import claims_page


@dataclass(frozen=True, repr=False)
class Claims:
    """Claims of the paper with their verdicts.

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
        """Number of claims, and of those with each verdict."""
        counts = ", ".join(f"{verdict}: {count}" for verdict, count in self.counts.items())
        return f"{len(self)} claims; {counts}"

    @property
    def counts(self) -> dict[str, int]:
        """Number of claims for each verdict, most frequent first."""
        found = [row.category for row in self.rows]
        return {word: found.count(word) for word in sorted(set(found), key=lambda word: (-found.count(word), word))}

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
        """Return plain data, ready for JSON: the list ``claims``, and ``controls`` and ``verdicts`` by name."""
        return {
            "claims": [row.as_dict() for row in self.rows],
            "controls": {control.kind.name: control.as_dict() for control in self.controls},
            "verdicts": self.counts,
        }

    def to_markdown(self) -> str:
        """Page of the documentation with the claims."""
        return claims_page(self.rows, self.controls, self.summary)
