"""Verdicts on the paper's claims: a bar for each part of the paper, and one for the findings beyond it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.figures.picture import Styles
from topcli.paper.claim import FAILS, HOLDS, HOLDS_WITHIN, MISPRINT, NOT_TRIED
from topcli.paper.ledger import ledger

LOOKS = {
    HOLDS: ("#0072B2", "white"),
    HOLDS_WITHIN: ("#56B4E9", "black"),
    MISPRINT: ("#E69F00", "black"),
    FAILS: ("#D55E00", "white"),
    NOT_TRIED: ("0.8", "black"),
}
"""Colours of the bars and of the numbers in them, in the order of the legend."""
OTHERS = "other claims"


def verdict_category(verdict: str) -> str:
    """Verdict without its bound."""
    return HOLDS_WITHIN if verdict.startswith(HOLDS_WITHIN) else verdict


@dataclass(frozen=True)
class VerdictPanel:
    """Number of statements with each verdict, a stacked bar for each of the ``subjects``.

    The columns are the ``verdicts``, each with a number of claims for every subject.
    """

    subjects: tuple[str, ...]
    verdicts: tuple[str, ...]

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the bars into ``axes``, the first subject on top."""
        rows = np.arange(len(self.subjects))
        left = np.zeros(len(rows))
        for verdict in self.verdicts:
            counts = data[verdict]
            colour, ink = LOOKS[verdict]
            axes.barh(rows, counts, left=left, height=0.72, color=colour, label=verdict)
            for row in np.flatnonzero(counts):
                at = (left[row] + 0.5 * counts[row], row)
                axes.text(*at, f"{counts[row]:.0f}", ha="center", va="center", color=ink, fontsize="small")
            left = left + counts
        axes.set_yticks(rows, self.subjects)
        axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(0.0, 1.02 * left.max()), xlabel="number of statements")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.tick_params(axis="y", length=0)
        axes.grid(False)
        look: dict[str, Any] = {"fontsize": "small", "frameon": False, "handlelength": 1.2, "columnspacing": 1.2}
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(LOOKS), borderaxespad=0.2, **look)


def verdict_panel(claims: Sequence[Mapping[str, Any]]) -> tuple[VerdictPanel, dict[str, np.ndarray]]:
    """Panel and data of decided claims, given as the plain data of ``topcli claims --json``."""
    homes = {claim.id: section.title.partition(" (")[0] for section in ledger().sections for claim in section.claims}
    pairs = [(homes.get(one["id"], OTHERS), verdict_category(one["verdict"])) for one in claims]
    present = {subject for subject, _ in pairs}
    subjects = tuple(subject for subject in dict.fromkeys((*homes.values(), OTHERS)) if subject in present)
    verdicts = tuple(verdict for verdict in LOOKS if any(found == verdict for _, found in pairs))
    data = {verdict: np.array([float(pairs.count((one, verdict))) for one in subjects]) for verdict in verdicts}
    return VerdictPanel(subjects, verdicts), data
