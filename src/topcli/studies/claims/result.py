"""Decided claims: plain data, a table, files."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.errors import UsageError
from topcli.store.run_folder import io_failure, require_writable, write_whole
from topcli.studies.claims.claim import FAILS, HOLDS_WITHIN, NOT_TRIED, Bound, Claim, Finding, Kind
from topcli.studies.report import finite

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("id", "statement", "source", "experiment", "figure", "bound", "verdict")


@dataclass(frozen=True)
class Decided:
    """One claim with its ``finding``; without one, ``reason`` says why it was not tried.

    ``recorded`` is the verdict of the repository, None if there is none yet.
    """

    claim: Claim
    finding: Finding | None
    reason: str
    recorded: str | None
    seconds: float

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

    @property
    def caught(self) -> bool:
        """True if the check found the defect, or could not be tried."""
        return self.finding is None or self.finding.verdict == FAILS

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


@dataclass(frozen=True, repr=False)
class Claims:
    """Claims of the paper with their verdicts, as ``topcli.claims`` returns them.

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

    def __repr__(self) -> str:
        return f"<{self.summary}>"

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
    def blunt(self) -> tuple[str, ...]:
        """Names of the kinds of checks that did not find the defect of their positive control."""
        return tuple(control.kind.name for control in self.controls if not control.caught)

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the claims, one row each, indexed by ``id``."""
        import pandas as pd

        rows = [{**row.as_dict(), "bound": row.finding.bound.text if row.finding else None} for row in self.rows]
        return pd.DataFrame(rows, columns=[*COLUMNS, "note", "recorded", "seconds"]).set_index("id")

    def _repr_html_(self) -> str:
        return self.table[list(COLUMNS[1:])].to_html()

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON: the list ``claims``, and ``controls`` and ``verdicts`` by name."""
        return {
            "claims": [row.as_dict() for row in self.rows],
            "controls": {control.kind.name: control.as_dict() for control in self.controls},
            "verdicts": self.counts,
        }

    def save(self, path: str | Path) -> Path:
        """Write the claims to a file, whole or not at all.

        Parameters
        ----------
        path : path or str
            File ending in ``.json``, ``.csv``, ``.html`` or ``.md``; the last is the page of the documentation.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        UsageError
            If the name has another ending, or its folder cannot be written.
        RunError
            If writing fails.
        """
        path = Path(path)
        writers: dict[str, Callable[[], str]] = {
            ".json": lambda: json.dumps(self.as_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n",
            ".csv": lambda: self.table.to_csv(),
            ".html": lambda: self.table.to_html() + "\n",
            ".md": self.to_markdown,
        }
        if path.suffix.lower() not in writers:
            raise UsageError(f"{path}: the name must end in {', '.join(list(writers)[:-1])} or {list(writers)[-1]}")
        text = writers[path.suffix.lower()]()
        require_writable(path.parent)
        try:
            write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
        except OSError as error:
            raise io_failure(error, path, "nothing was written") from error
        return path

    def to_markdown(self) -> str:
        """Page of the documentation with the claims."""
        from topcli.studies.claims.page import claims_page

        return claims_page(self)
