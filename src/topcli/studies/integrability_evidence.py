"""Computed evidence for or against the integrability of a scheme's map, and the verdict that follows from it."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from topcli.analysis.algebraic_growth import (
    EXPONENTIAL,
    LONGEST_HEIGHT,
    MOST_POINTS,
    POLYNOMIAL,
    SURPLUS,
    DegreeGrowth,
    DigitGrowth,
    confirmed_growth,
    degrees,
    digit_growth,
    heights,
)
from topcli.analysis.hk_basis import Density, HKBasis, density, hk_bases
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.engine.numbers import rationals
from topcli.engine.residues import RationalMap, modular_map, rational_map
from topcli.errors import RunError, UsageError, counted, quoted, shortened
from topcli.field.polynomial import Polynomial, decimal
from topcli.schemes.own_tops import forms
from topcli.schemes.registry import names_for
from topcli.studies.stress.cases import GENERIC
from topcli.studies.stress.cases import config as config_of
from topcli.tops import CUSTOM

INTEGRABLE, NOT_INTEGRABLE, UNDECIDED = "integrable", "not integrable", "undecided"
H = 0.3
"""Step size if none is given; degrees do not depend on it, except in special position."""
OTHER_H = Fraction(1, 7)
"""Difference of the step size of the repetition."""
BASES = (2, 3, 4)
"""Degrees of HK bases, up to the one that has enough integrals."""
MOST_MONOMIALS = 1000
"""Monomials of a density, about 2 s of work: degree 6 for six components."""
LARGEST_DENSITY = 6
SEEDS = 3
"""Attempts with other random numbers, after a division by zero modulo the prime."""
CHEAP = 2000
"""Degree up to which an iterate is repeated."""
SHOWN_TERMS = 12
"""Longest density that is shown as a formula."""
T = TypeVar("T")


def map_experiment(
    name: str, scheme: str, config: str | Path | Mapping[str, Any] | None, overrides: Sequence[str]
) -> Experiment:
    """Experiment that gives top, options and step size: that of ``config``, or the top ``name`` with its defaults.

    Raises UsageError, also for a config of another top.
    """
    if config is None:
        known = forms(name)
        named = re.split(r"[:+]", scheme.lower())[0]
        top = next((form for form in known if named in names_for(form.form)), known[0]).new()
        state = tuple(GENERIC[i % len(GENERIC)] for i in range(len(top.components)))
        return load_experiment({**config_of(top, state, H, 1), "scheme": scheme}, overrides)
    experiment = load_experiment(config, overrides, {"scheme": scheme})
    top = experiment.top
    if name.lower() not in (top.kind, top.form, CUSTOM) or (name.lower() == CUSTOM) != (top.kind == CUSTOM):
        raise UsageError(
            f"integrability: {shortened(str(config))} is of the top {quoted(top.kind)}, not {quoted(name)}"
        )
    return experiment


def _retried(work: Callable[[int], T]) -> T:
    """Result of ``work(seed)`` for the first seed without a division by zero."""
    for seed in range(1, SEEDS):
        try:
            return work(seed)
        except ZeroDivisionError:
            continue
    try:
        return work(SEEDS)
    except ZeroDivisionError as error:
        raise RunError(f"integrability: the step fails on random states: {error}") from None


def needed_integrals(d: int) -> int:
    """Independent integrals that an integrable map of ``d`` components has: its level sets are points or surfaces."""
    return d - 1 if d <= 3 else d - 2


def verdict_of(growth: DegreeGrowth, repeated: bool, integrals: int, d: int) -> tuple[str, str]:
    """Verdict on a map, and the reason."""
    needed, found = needed_integrals(d), counted(integrals, "independent integral")
    if not growth.law:
        return UNDECIDED, "no law for the growth of the degrees was found"
    if not repeated:
        return UNDECIDED, "the degrees along another line with another h are different"
    if growth.law == EXPONENTIAL:
        known = "" if growth.characteristic else "; the heights agree, although no recurrence was found"
        return NOT_INTEGRABLE, f"the degrees grow exponentially, so the algebraic entropy is positive{known}"
    if integrals >= needed:
        return INTEGRABLE, f"the degrees grow polynomially, with {found} ({needed} needed)"
    return UNDECIDED, f"the degrees grow polynomially, but with only {found} ({needed} needed)"


def growth_text(growth: DegreeGrowth) -> str:
    """Law of the degrees in a few words, with the polynomial of the recurrence."""
    if not growth.law:
        return "no recurrence found"
    if not growth.characteristic:
        return f"about {growth.factor:.3g}^n; no recurrence found"
    by = f"{growth.surplus} terms" if growth.surplus >= SURPLUS else f"{growth.surplus} term and the heights"
    n = len(growth.characteristic) - 1
    terms = {(0,) * (n - i): Fraction(c) for i, c in enumerate(growth.characteristic)}
    law = ("n" if growth.power == 1 else f"n^{growth.power}") if growth.law == POLYNOMIAL else f"{growth.factor:.4g}^n"
    return f"{law}; recurrence {Polynomial(terms).text('x')}, confirmed by {by}"


def _bases(step: RationalMap, seed: int) -> list[HKBasis]:
    """HK bases of increasing degree, up to the first with enough integrals."""
    found: list[HKBasis] = []
    for basis in hk_bases(step, BASES[: 2 if step.d > 5 else 3], seed):
        found.append(basis)
        if basis.integrals >= needed_integrals(step.d):
            break
    return found


def _density_degree(d: int) -> int:
    """Largest degree of a density that is looked for."""
    sizes = [1]
    while len(sizes) <= LARGEST_DENSITY and sizes[-1] * (d + len(sizes)) // len(sizes) <= MOST_MONOMIALS:
        sizes.append(sizes[-1] * (d + len(sizes)) // len(sizes))
    return len(sizes) - 1


def integrability_study(experiment: Experiment, on_progress: Callable[[int, int], None]) -> dict[str, Any]:
    """Collect the evidence on the map of an experiment's scheme, and return plain data."""
    top, h = experiment.top, decimal(experiment.h)
    d, most = len(top.components), _density_degree(len(top.components))
    seconds: list[float] = []

    def timed(work: Callable[[int], T]) -> T:
        start = time.perf_counter()
        result = _retried(work)
        seconds.append(time.perf_counter() - start)
        on_progress(len(seconds), 5)
        return result

    subject = experiment.scheme, top, experiment.options
    modular, other = modular_map(*subject, h), modular_map(*subject, h + OTHER_H)
    found = timed(lambda seed: degrees(modular, seed))
    cheap = sum(degree < CHEAP for degree in found)
    again = timed(lambda seed: degrees(other, SEEDS + seed, max(cheap, 1)))
    bits = timed(lambda seed: heights(rational_map(*subject, h, rationals(LONGEST_HEIGHT))))
    bases = timed(lambda seed: _bases(modular, seed))
    measure = timed(lambda seed: density(modular, most, seed))
    growth, fit = confirmed_growth(found, bits), digit_growth(np.arange(len(bits)), np.array(bits))
    integrals = max(basis.integrals for basis in bases)
    verdict, why = verdict_of(growth, _agree(again, found), integrals, d)
    listed = "; ".join(f"degree {basis.degree}: null space {basis.null} of {basis.monomials}" for basis in bases)
    rows = {
        "degrees": (_listed(found), growth_text(growth)),
        "repeated": (
            "the same" if _agree(again, found) else _listed(again),
            f"along another line, with h = {h + OTHER_H}",
        ),
        "heights": (f"{bits[-1]} bits after {counted(len(bits) - 1, 'step')}", _fit_text(fit)),
        "HK bases": (f"independent integrals: {integrals}", listed),
        "density": _density_text(measure, d, most, top.components),
    }
    return {
        "config": experiment.resolved(),
        "top": top.form,
        "scheme": experiment.scheme.name,
        "h": experiment.h,
        "degrees": found,
        "growth": growth.as_dict(),
        "repeated": again,
        "heights": {"bits": bits, "growth": fit and fit.as_dict()},
        "hk_bases": [asdict(basis) for basis in bases],
        "integrals": integrals,
        "needed": needed_integrals(d),
        "density": measure and {"degree": measure.degree, "dimension": len(measure.basis)},
        "verdict": verdict,
        "why": why,
        "tests": [
            {"test": test, "found": shown, "meaning": meaning, "seconds": spent}
            for (test, (shown, meaning)), spent in zip(rows.items(), seconds, strict=True)
        ],
    }


def _fit_text(fit: DigitGrowth | None) -> str:
    if fit and fit.power is not None:
        return f"about n^{fit.power:.2f}"
    return f"about {fit.factor:.4g}^n" if fit and fit.factor is not None else "too few steps"


def _listed(degrees: list[int]) -> str:
    return ", ".join(map(str, degrees)) or f"above {MOST_POINTS // 2} at once"


def _agree(one: list[int], other: list[int]) -> bool:
    """True if two sequences of degrees agree as far as both go."""
    return bool(one) and all(a == b for a, b in zip(one, other, strict=False))


def _density_text(found: Density | None, d: int, most: int, names: tuple[str, ...]) -> tuple[str, str]:
    if found is None:
        return "none", f"no polynomial P up to degree {most}"
    polynomials, count = found.polynomials(d), len(found.basis)
    shown = f"{count} independent polynomials P" if count > 1 else "one polynomial P"
    if count == 1 and polynomials and len(polynomials[0].terms) <= SHOWN_TERMS:
        shown = f"P = {polynomials[0].text(names)}"
    return f"degree {found.degree}", f"measure dx/P with {shown}"
