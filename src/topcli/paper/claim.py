"""Types of the ledger of claims: measurement, bound and verdict of a check."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from topcli.errors import counted

HOLDS = "holds"
HOLDS_WITHIN = "holds within"
FAILS = "does not hold as stated"
MISPRINT = "misprint"
NOT_TRIED = "not tried"


def summary_of(counts: Mapping[str, int]) -> str:
    """Number of claims, and the number for each verdict."""
    verdicts = ", ".join(f"{count} {_predicate(verdict, count)}" for verdict, count in counts.items())
    return f"{counted(sum(counts.values()), 'claim')} of the paper: {verdicts}"


def _predicate(verdict: str, count: int) -> str:
    """Verdict as what ``count`` claims do."""
    one, several = {
        HOLDS: ("holds", "hold"),
        HOLDS_WITHIN: ("holds within its bound", "hold within their bounds"),
        MISPRINT: ("is a misprint", "are misprints"),
        FAILS: ("does not hold as stated", "do not hold as stated"),
        NOT_TRIED: ("was not tried", "were not tried"),
    }.get(verdict, (verdict, verdict))
    return one if count == 1 else several


@dataclass(frozen=True)
class Measurement:
    """Result of a check.

    Parameters
    ----------
    figure : float
        The measured figure.
    limit : float, optional
        Limit of the figure of a true statement by theory, where it depends on the experiment.
    corrected : float, optional
        Figure of a corrected reading of the statement.
    note : str, optional
        What the figure does not say, in a few words.
    reason, unit : str, optional
        Reason of the limit and unit of the figure, where they depend on the experiment.
    """

    figure: float
    limit: float | None = None
    corrected: float | None = None
    note: str = ""
    reason: str = ""
    unit: str = ""


@dataclass(frozen=True)
class Bound:
    """Interval in which the figure of a true statement lies, known before anything is measured.

    Parameters
    ----------
    low, high : float, optional
        Ends of the interval; infinite for a bound on one side.
    reason : str
        Theory that the bound comes from.
    unit : str, optional
        Unit of the figure.
    approximate : bool, optional
        True if the statement is itself approximate ("very small"); it then holds within the bound.
    open_low : bool, optional
        True if ``low`` itself is outside, as for "is not zero".
    """

    low: float = -math.inf
    high: float = math.inf
    reason: str = ""
    unit: str = ""
    approximate: bool = False
    open_low: bool = False

    def admits(self, figure: float) -> bool:
        """True if the figure lies in the interval; never for nan."""
        above = figure > self.low if self.open_low else figure >= self.low
        return above and figure <= self.high

    def verdict(self, figure: float, corrected: float | None = None) -> str:
        """Verdict on a statement with this figure, and with this ``corrected`` one if it is read with a correction."""
        if self.admits(figure):
            return HOLDS_WITHIN if self.approximate else HOLDS
        return MISPRINT if corrected is not None and self.admits(corrected) else FAILS

    @property
    def text(self) -> str:
        """Interval with its unit, such as ``≤ 1e-45`` or ``1.9 to 2.1``."""
        if self.low == self.high:
            interval = number_text(self.low)
        elif self.low in (-math.inf, 0.0) and not math.isinf(self.high):
            interval = f"≤ {number_text(self.high)}"
        elif math.isinf(self.high):
            interval = f"{'>' if self.open_low else '≥'} {number_text(self.low)}"
        else:
            interval = f"{number_text(self.low)} to {number_text(self.high)}"
        return f"{interval} {self.unit}".rstrip()


def number_text(value: float) -> str:
    """Number with two significant digits, or with all digits of an integer."""
    if value == round(value) and abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.2g}"


def category_of(verdict: str) -> str:
    """Verdict without its bound."""
    return HOLDS_WITHIN if verdict.startswith(HOLDS_WITHIN) else verdict
