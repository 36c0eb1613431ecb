"""Experiments of the ledger of claims, and the control experiments of each kind of check."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from topcli.errors import RunError
from topcli.paper.claim import FAILS, HOLDS_WITHIN, NOT_TRIED, Bound, Measurement, number_text, summary_of
from topcli.paper.ledger import Check, Claim, Ledger, ledger
from topcli.runs.report import finite


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """Measurement of a check; without one, ``reason`` says why, and ``failed`` is True if a run failed."""

    check: Check
    measurement: Measurement | None = None
    bound: Bound | None = None
    reason: str = ""
    failed: bool = False
    seconds: float = 0.0

    @property
    def category(self) -> str:
        """Verdict without the bound, which follows from the figures and the bound alone."""
        if self.measurement is None or self.bound is None:
            return NOT_TRIED
        return self.bound.verdict(self.measurement.figure, self.measurement.corrected)

    @property
    def caught(self) -> bool:
        """True if the check found the defect that it was carried out on, or lacked a package."""
        return not self.failed if self.measurement is None else self.category == FAILS

    @property
    def figure_text(self) -> str:
        """Figure with two digits and its unit; a dash if there is none."""
        if self.measurement is None or self.bound is None:
            return "–"
        return f"{number_text(self.measurement.figure)} {self.bound.unit}".rstrip()

    @property
    def bound_text(self) -> str:
        """Bound with its unit; a dash if there is none."""
        return self.bound.text if self.bound else "–"

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON; a number is None if it is not finite."""
        measured, bound = self.measurement, self.bound
        return finite(
            {
                "measures": self.check.measures,
                "defect": self.check.defect,
                "figure": measured and measured.figure,
                "bound": bound and {"low": bound.low, "high": bound.high},
                "bound_text": bound and bound.text,
                "verdict": self.category if measured else self.reason,
            }
        )


@dataclass(frozen=True, kw_only=True)
class Decided(CheckResult):
    """A decided claim."""

    claim: Claim

    @property
    def verdict(self) -> str:
        """Verdict as it is shown: of an approximate statement with the bound."""
        if self.bound is None or self.category != HOLDS_WITHIN:
            return self.category
        return f"{HOLDS_WITHIN} {self.bound.text.removeprefix('≤ ')}"

    @property
    def changed(self) -> bool:
        """True if the verdict differs from the recorded one; never for a claim that was not tried."""
        return self.measurement is not None and self.category != self.claim.recorded

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON; a number is None if it is not finite."""
        claim, measured, bound = self.claim, self.measurement, self.bound
        control = super().as_dict()
        return {
            **{key: getattr(claim, key) for key in ("id", "statement", "source")},
            "kind": self.check.name,
            "measures": self.check.measures,
            "experiment": claim.experiment_text.replace("`", ""),
            "figure": control["figure"],
            "corrected": finite(measured and measured.corrected),
            "bound": control["bound"],
            "bound_text": control["bound_text"],
            "bound_reason": bound and bound.reason,
            "note": measured.note if measured else self.reason,
            "verdict": self.verdict,
            "recorded": claim.recorded,
            "slow": claim.slow,
            "seconds": self.seconds,
        }


@dataclass(frozen=True, repr=False)
class Claims:
    """Claims of the paper with their verdicts.

    Attributes
    ----------
    rows : tuple of Decided
        The claims, in the order of the ledger.
    controls : tuple of CheckResult
        The positive control of each kind of check that was used.
    named : bool
        True if the claims were asked for by name.
    """

    rows: tuple[Decided, ...]
    controls: tuple[CheckResult, ...]
    named: bool = False

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def summary(self) -> str:
        """Number of claims, and the number for each verdict."""
        return summary_of(self.counts)

    @property
    def counts(self) -> dict[str, int]:
        """Number of claims for each verdict, most frequent first."""
        verdicts = Counter(row.category for row in self.rows)
        return dict(sorted(verdicts.items(), key=lambda item: (-item[1], item[0])))

    @property
    def changed(self) -> tuple[str, ...]:
        """Names of the claims whose verdict differs from the recorded one."""
        return tuple(row.claim.id for row in self.rows if row.changed)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the claims of which a run failed."""
        return tuple(row.claim.id for row in self.rows if row.failed)

    @property
    def uncaught(self) -> tuple[str, ...]:
        """Names of the kinds of checks that did not find the defect of their positive control."""
        return tuple(control.check.name for control in self.controls if not control.caught)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON: the list ``claims``, and ``controls`` and numbers of verdicts by name."""
        return {
            "claims": [row.as_dict() for row in self.rows],
            "controls": {control.check.name: control.as_dict() for control in self.controls},
            "verdicts": self.counts,
        }


def carry_out(check: Check, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of the result of a check, which has no measurement if it needs a package that is missing, or fails."""
    start = time.perf_counter()
    fields: dict[str, Any] = {"check": check}
    try:
        measured = check.bind(parameters)()
        fields |= {"measurement": measured, "bound": check.bound(measured, parameters)}
    except ModuleNotFoundError as error:
        fields["reason"] = f"{NOT_TRIED}: needs the package {error.name}, which is not installed"
    except RunError as error:
        fields |= {"reason": str(error).splitlines()[0], "failed": True}
    return fields | {"seconds": time.perf_counter() - start}


def decide_claims(
    ids: str | Sequence[str] = (),
    *,
    fast: bool = False,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    claims: Ledger | None = None,
) -> Claims:
    """Decide the claims with these names, by default all; with ``fast`` slow ones are left out unless they are named.

    ``on_progress(done, total)`` is called after each check; ``claims`` is the ledger, by default that of the package.
    Raises UnknownNameError with the nearest names.
    """
    wanted = (claims or ledger()).chosen((ids,) if isinstance(ids, str) else ids, fast)
    checks = list({claim.check.name: claim.check for claim in wanted}.values())
    total = len(wanted) + len(checks)
    rows: list[Decided] = []
    for claim in wanted:
        rows.append(Decided(claim=claim, **carry_out(claim.check, claim.parameters)))
        on_progress(len(rows), total)
    controls: list[CheckResult] = []
    for check in checks:
        controls.append(CheckResult(**carry_out(check, check.control)))
        on_progress(len(rows) + len(controls), total)
    return Claims(tuple(rows), tuple(controls), bool(ids))
