"""``topcli integrability``: computed evidence for or against the integrability of a scheme's map."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeVar

from topcli.analysis.algebraic_growth import (
    EXPONENTIAL,
    LONGEST_HEIGHT,
    MOST_POINTS,
    POLYNOMIAL,
    SURPLUS,
    DegreeGrowth,
    confirmed_growth,
    degrees,
    fitted_law,
    heights,
)
from topcli.analysis.hk_basis import HKBasis, density, hk_bases
from topcli.engine.numbers import rationals
from topcli.engine.residues import RationalMap, modular_map, rational_map
from topcli.errors import RunError, counted
from topcli.field.polynomial import Polynomial, decimal
from topcli.studies import SILENT, Watch
from topcli.studies.entries import experiment_on
from topcli.studies.report import Report, Table
from topcli.tops import TOPS

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
_TESTS = 5
CHEAP = 2000
"""Degree up to which an iterate is repeated."""
T = TypeVar("T")


def integrability(
    top: str,
    scheme: str = "hk",
    *,
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    watch: Watch = SILENT,
) -> Report:
    """Collect evidence on the integrability of a scheme's map.

    The study iterates the map from random states. In arithmetic modulo a prime, it measures the growth of the degrees
    of the iterates and searches for independent integrals (from Hirota-Kimura bases) and for invariant densities. With
    exact fractions, it measures how fast the number of digits of the state grows. The step must be a rational function
    of the state: schemes with roots, iterations or decisions that depend on the state are refused.

    Parameters
    ----------
    top : str
        Name of a top, or "custom" for the top that a config defines.
    scheme : str, optional
        Name of a scheme.
    config : path, str or mapping, optional
        Config that gives the parameters of the top and the step size; without it, the default parameters and h = 0.3
        are used.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        ``table`` has a row for each test, with the result and its meaning. The second table has the degrees of the
        iterates and the bits of the states, the third the verdict with the law of their growth.

    Raises
    ------
    UsageError
        If the top or scheme is unknown, or if the step is not a rational function of the state.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.integrability("euler")
    >>> report.tables[1].frame()["degree"].tolist()[:4], report.tables[2].rows[0]["verdict"]
    ([3, 9, 19, 33], 'integrable')
    """
    experiment = experiment_on(top, scheme, config, overrides, h=H, N=1)
    body, h = experiment.top, decimal(experiment.h)
    d = len(body.components)
    watch.begin("integrability", unit="tests")

    # five tests
    subject = experiment.scheme, body, experiment.options
    modular, other = modular_map(*subject, h), modular_map(*subject, h + OTHER_H)
    first = _tested(1, watch, lambda: degrees(modular, 1))
    cheap = sum(degree < CHEAP for degree in first)
    again = _tested(2, watch, lambda: degrees(other, 2, max(cheap, 1)))
    bits = _tested(3, watch, lambda: heights(rational_map(*subject, h, rationals(LONGEST_HEIGHT))))
    bases = _tested(4, watch, lambda: _bases(modular))
    most = _density_degree(d)
    measure = _tested(5, watch, lambda: density(modular, most, 1))

    # what follows from them
    growth, (law_of_bits, fit) = confirmed_growth(first, bits), fitted_law(0, bits)
    integrals = max(basis.integrals for basis in bases)
    same = bool(first and again) and all(a == b for a, b in zip(first, again, strict=False))
    verdict, why = verdict_on(growth, same, integrals, d)
    fitted = {None: "too few steps", POLYNOMIAL: f"about n^{fit:.2f}"}.get(law_of_bits, f"about {fit:.4g}^n")
    listed = "; ".join(f"degree {basis.degree}: null space {basis.null} of {basis.monomials}" for basis in bases)
    tests = {
        "degrees": (_listed(first), growth_text(growth)),
        "repeated": ("the same" if same else _listed(again), f"along another line, with h = {h + OTHER_H}"),
        "heights": (f"{bits[-1]} bits after {counted(len(bits) - 1, 'step')}", fitted),
        "HK bases": (f"independent integrals: {integrals}", listed),
        "density": ("none", f"no polynomial P up to degree {most}"),
    }
    if measure:
        polynomials = counted(len(measure.basis), "independent polynomial")
        tests["density"] = f"degree {measure.degree}", f"measure dx/P with {polynomials} P"
    evidence = [{"test": test, "found": result, "meaning": meaning} for test, (result, meaning) in tests.items()]
    iterates = [
        {"n": n, "degree": degree, "repeated": repeated, "bits": size}
        for n, (degree, repeated, size) in enumerate(zip_longest(first, again, bits[1:]), start=1)
    ]
    conclusion = {
        "verdict": verdict,
        **{key: getattr(growth, key) for key in ("law", "power", "factor", "entropy")},
        "integrals": integrals,
        "needed": needed_integrals(d),
        "density_degree": measure and measure.degree,
        "density_dimension": measure and len(measure.basis),
    }
    tables = [
        Table("Evidence", evidence),
        Table("Iterates", iterates, detail=True),
        Table("Verdict", [conclusion], detail=True),
    ]
    title = f"{experiment.scheme.name} on {TOPS.called(body.form)}, h = {experiment.h:g}"
    answer = f"{verdict}: {why}; this is computed evidence for these parameters, not a proof"
    return Report("integrability", title, answer, tables, config=experiment.resolved())


def _tested(number: int, watch: Watch, work: Callable[[], T]) -> T:
    """Result of the test with this number. Raises RunError for a division by zero, unlikely on random states."""
    try:
        result = work()
    except ZeroDivisionError as error:
        raise RunError(f"integrability: the step fails on random states: {error}") from None
    watch(number, _TESTS)
    return result


def needed_integrals(d: int) -> int:
    """Independent integrals that an integrable map of ``d`` components has: its level sets are points or surfaces."""
    return d - 1 if d <= 3 else d - 2


def verdict_on(growth: DegreeGrowth, repeated: bool, integrals: int, d: int) -> tuple[str, str]:
    """Verdict on a map, and the reason."""
    needed, independent = needed_integrals(d), counted(integrals, "independent integral")
    if not growth.law:
        return UNDECIDED, "no law for the growth of the degrees was found"
    if not repeated:
        return UNDECIDED, "the degrees along another line with another h are different"
    if growth.law == EXPONENTIAL:
        fitted = "" if growth.characteristic else "; the heights agree, although no recurrence was found"
        return NOT_INTEGRABLE, f"the degrees grow exponentially, so the algebraic entropy is positive{fitted}"
    if integrals >= needed:
        return INTEGRABLE, f"the degrees grow polynomially, with {independent} ({needed} needed)"
    return UNDECIDED, f"the degrees grow polynomially, but with only {independent} ({needed} needed)"


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


def _bases(step: RationalMap) -> list[HKBasis]:
    """HK bases of increasing degree, up to the first with enough integrals."""
    bases: list[HKBasis] = []
    for basis in hk_bases(step, BASES[: 2 if step.d > 5 else 3], 1):
        bases.append(basis)
        if basis.integrals >= needed_integrals(step.d):
            break
    return bases


def _density_degree(d: int) -> int:
    """Largest degree of a density that is looked for."""
    sizes = [1]
    while len(sizes) <= LARGEST_DENSITY and sizes[-1] * (d + len(sizes)) // len(sizes) <= MOST_MONOMIALS:
        sizes.append(sizes[-1] * (d + len(sizes)) // len(sizes))
    return len(sizes) - 1


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers)) or f"above {MOST_POINTS // 2} at once"
