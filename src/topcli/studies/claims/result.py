"""Decided claims together: plain data, a table, files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.errors import UsageError
from topcli.store.run_folder import io_failure, require_writable, write_whole
from topcli.studies.claims.decided import Control, Decided
from topcli.studies.claims.page import claims_page

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("id", "statement", "source", "experiment", "figure", "bound", "verdict")


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
    def failed(self) -> tuple[str, ...]:
        """Names of the claims of which a run failed."""
        return tuple(row.claim.id for row in self.rows if row.failed)

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
        return claims_page(self.rows, self.controls, self.summary)
