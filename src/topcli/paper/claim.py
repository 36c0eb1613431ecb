"""Types of the ledger: a claim, the kind of check that decides it, its finding, and the verdict that follows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

HOLDS = "holds"
HOLDS_WITHIN = "holds within"
FAILS = "does not hold as stated"
MISPRINT = "misprint"
NOT_TRIED = "not tried"
PAPER = "paper"
OURS = "ours"


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

    @property
    def text(self) -> str:
        """Interval with its unit, such as ``≤ 1e-45`` or ``1.9 to 2.1``."""
        if self.low == self.high:
            words = number_text(self.low)
        elif self.low in (-math.inf, 0.0) and not math.isinf(self.high):
            words = f"≤ {number_text(self.high)}"
        elif math.isinf(self.high):
            words = f"{'>' if self.open_low else '≥'} {number_text(self.low)}"
        else:
            words = f"{number_text(self.low)} to {number_text(self.high)}"
        return f"{words} {self.unit}".rstrip()


def number_text(value: float) -> str:
    """Number with two significant digits, or with all digits of an integer."""
    if value == round(value) and abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.2g}"


@dataclass(frozen=True)
class Finding:
    """Result of a check: the measured ``figure``, and the ``corrected`` one of a corrected reading if there is one.

    ``note`` adds, in a few words, what the figure does not say.
    """

    figure: float
    bound: Bound
    corrected: float | None = None
    note: str = ""

    @property
    def verdict(self) -> str:
        """Verdict that follows from the figures and the bound alone."""
        if self.bound.admits(self.figure):
            return HOLDS_WITHIN if self.bound.approximate else HOLDS
        if self.corrected is not None and self.bound.admits(self.corrected):
            return MISPRINT
        return FAILS


@dataclass(frozen=True)
class Kind:
    """One kind of check.

    Parameters
    ----------
    name : str
        Name in the ledger.
    measures : str
        Meaning of the figure.
    defect : str
        Known defect that the check must find, its positive control.
    control : callable
        ``control()`` carries out the check on that defect; its verdict must be "does not hold as stated".
    """

    name: str
    measures: str
    defect: str
    control: Callable[[], Finding]


@dataclass(frozen=True)
class Claim:
    """A checkable statement and the experiment that decides it.

    A claim of the paper is decided on the paper's own scope: its figure, initial state, window, step and symbols. A
    statement that goes beyond the sentence is an entry of its own, with ``ours``.

    Parameters
    ----------
    id : str
        Name on the command line.
    statement : str
        The statement in a few words.
    source : str
        Section and, where it has one, the equation of the paper; of a finding, the place that it goes beyond.
    kind : Kind
        Kind of the check.
    experiment : str
        The experiment in a line; names of scenes and commands stand between backticks.
    decide : callable
        ``decide()`` carries out the experiment. It knows neither the statement nor the recorded verdict.
    slow : bool, optional
        True if it takes more than a few tenths of a second, and is left out of the fast subset.
    ours : bool, optional
        True for a finding of this project, which the paper does not state.
    """

    id: str
    statement: str
    source: str
    kind: Kind
    experiment: str
    decide: Callable[[], Finding]
    slow: bool = False
    ours: bool = False

    @property
    def origin(self) -> str:
        """Author of the statement: ``paper`` or ``ours``."""
        return OURS if self.ours else PAPER
