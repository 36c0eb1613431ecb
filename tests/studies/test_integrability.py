"""Evidence for and against integrability: degrees, heights, HK bases, densities, and recorded verdicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import topcli
from conftest import ROOT
from topcli.analysis.algebraic_growth import DegreeGrowth, confirmed_growth, degree_growth, degrees
from topcli.analysis.hk_basis import density, hk_bases, monomials
from topcli.engine.residues import PRIME, Jet, RationalMap, inverse, residue
from topcli.studies.integrability import verdict_on
from topcli.studies.report import Report


def plain_map(d: int, step: Callable[..., Sequence[Any]]) -> RationalMap:
    return RationalMap(d, lambda y: y, lambda y: step(*y), lambda y: y)


def verdict(report: Report) -> Any:
    return report.tables[2].rows[0]


def degrees_of(report: Report) -> list[int]:
    return [row["degree"] for row in report.tables[1].rows if row["degree"]]


LYNESS = plain_map(2, lambda x, y: (y, (3 + y) / x))
"""Its integral is (x + 1)(y + 1)(x + y + 3)/(xy), its invariant measure dx dy/(xy) (Lyness 1942)."""
HENON = plain_map(2, lambda x, y: (1 + y - Fraction(7, 5) * x**2, Fraction(3, 10) * x))
"""Polynomial of degree 2 whose iterates have the degree 2^n (Friedland, Milnor 1989)."""
MOEBIUS = plain_map(1, lambda x: ((2 * x + 1) / (x + 3),))


# arithmetic


def test_residues_are_those_of_rational_numbers() -> None:
    """With derivatives, which are compared with those of the formula."""
    x, y = Fraction(3, 7), Fraction(-5, 11)
    jets = [Jet(np.array([[residue(v)], [i == 0], [i == 1]], dtype=np.int64)) for i, v in enumerate((x, y))]

    def formula(x: Any, y: Any) -> Any:
        return (x**3 - 2 * y / x + Fraction(1, 3)) / (1 - x * y) + 0.5 * y + x**-2

    u, v = x**3 - 2 * y / x + Fraction(1, 3), 1 - x * y
    slope_x = ((3 * x**2 + 2 * y / x**2) * v + u * y) / v**2 - 2 / x**3
    slope_y = (-2 / x * v + u * x) / v**2 + Fraction(1, 2)
    value = u / v + y / 2 + x**-2
    assert formula(*jets).a[:, 0].tolist() == [residue(number) for number in (value, slope_x, slope_y)]
    assert (inverse(np.array([2, PRIME - 1])) * np.array([2, PRIME - 1]) % PRIME == 1).all()
    with pytest.raises(ZeroDivisionError):
        inverse(np.array([1, 0]))


# degrees


def test_degrees_of_known_maps() -> None:
    assert degrees(HENON) == [2, 4, 8, 16, 32]
    assert set(degrees(MOEBIUS)) == {1}
    lyness = degree_growth(degrees(LYNESS))
    assert (lyness.law, lyness.power) == ("polynomial", 2)
    assert degree_growth(degrees(HENON)).factor == 2.0


@pytest.mark.parametrize(
    ("sequence", "law", "power", "factor", "surplus"),
    [
        ([6, 33, 180, 981, 5346], "exponential", None, 3 + math.sqrt(6), 2),
        ([3, 9, 19, 33, 51, 73, 99], "polynomial", 2, None, 2),
        ([3, 9, 19, 33, 51, 73], None, None, None, 0),
        ([n**3 + 1 for n in range(1, 10)], "polynomial", 3, None, 2),
        ([8, 12, 18, 27], None, None, None, 0),  # a factor of 3/2, which is not a whole number
    ],
)
def test_growth_is_that_of_the_shortest_recurrence(
    sequence: list[int], law: str | None, power: int | None, factor: float | None, surplus: int
) -> None:
    growth = degree_growth(sequence)
    assert (growth.law, growth.power, growth.surplus) == (law, power, surplus)
    assert growth.factor == (factor and pytest.approx(factor, rel=1e-12))


@pytest.mark.parametrize("sequence", [[5, 25, 109, 465, 1973], [5, 25, 109, 465, 1973, 8361]])
def test_a_fit_or_a_single_further_term_needs_the_heights(sequence: list[int]) -> None:
    """The degrees of coupled Euler tops: 2 + sqrt 5, with the second sequence; within 15 %."""
    assert degree_growth(sequence).law is None
    for factor, law in [(3.7, None), (4.0, "exponential"), (4.7, "exponential"), (5.1, None)]:
        growth = confirmed_growth(sequence, [round(8 * factor**n) for n in range(5)])
        assert growth.law == law
        if law and len(sequence) > 5:
            assert (growth.factor, growth.surplus) == (pytest.approx(2 + math.sqrt(5), rel=1e-12), 1)


# HK bases and densities


def test_hk_bases_and_densities_of_known_maps() -> None:
    """Lyness' integral has a numerator of degree 3; Henon's map has none."""
    assert [(basis.null, basis.integrals) for basis in hk_bases(LYNESS, (2, 3))] == [(0, 0), (1, 1)]
    assert [basis.integrals for basis in hk_bases(HENON, (2, 3, 4))] == [0, 0, 0]
    measure = density(LYNESS, 4)
    assert measure is not None
    assert [monomials(2, measure.degree)[i] for i in np.flatnonzero(measure.basis[0])] == [(0, 1)]  # P = xy
    assert density(HENON, 5) is None  # its Jacobian is the constant -3/10


# the command


@pytest.mark.parametrize(
    ("law", "repeated", "integrals", "expected"),
    [
        ("polynomial", True, 2, "integrable"),
        ("polynomial", True, 1, "undecided"),
        ("polynomial", False, 2, "undecided"),
        ("exponential", True, 2, "not integrable"),
        ("exponential", False, 0, "undecided"),
        (None, True, 2, "undecided"),
    ],
)
def test_verdicts(law: str | None, repeated: bool, integrals: int, expected: str) -> None:
    assert verdict_on(DegreeGrowth(law, characteristic=(1, -1)), repeated, integrals, 3)[0] == expected


LAWS = {"n^2": None, r"(3+\sqrt6)^n": 3.0 + math.sqrt(6.0)}


@pytest.mark.slow
@pytest.mark.parametrize("command", ["euler", "lagrange", "kowalevski", "coupled-euler"])
def test_recorded_verdicts(command: str) -> None:
    """Rows of the table on the page of the documentation."""
    lines = (ROOT / "docs" / "integrability.md").read_text().splitlines()
    rows = [[cell.strip(" `$") for cell in line.split("|")] for line in lines if line.startswith("|")]
    _, _, listed, law, integrals, density, expected, _ = next(row for row in rows if row[1] == command)
    report = topcli.integrability(command)
    numbers = verdict(report)
    assert degrees_of(report)[:5] == [int(text) for text in listed.split(",")]
    *_, (n, bits) = ((row["n"], row["bits"]) for row in report.tables[1].rows if row["bits"])
    assert report.table.loc["heights", "found"] == f"{bits} bits after {n} steps"
    assert numbers["entropy"] == pytest.approx(math.log(LAWS[law] or 1.0), rel=1e-9)
    assert numbers["integrals"] == int(integrals)
    assert numbers["density_degree"] == (None if density == "none" else int(density))
    assert numbers["verdict"] == expected
    assert report.answer.startswith(f"{expected}: ")


REFUSED = {
    "(s[0] + h * s[1] if s[1] > 0.0 else s[0], s[1], s[2])": "it makes a decision that depends on the state",
    "(math.exp(s[0]), s[1], s[2])": "it uses math.exp, which rational functions do not have",
}


SCHEME = '''import math
import topcli
from topcli.contracts import Stepper
@topcli.scheme("mine", top="euler", order=1, explicit=True, self_adjoint=False)
def mine(top, options):
    """A step."""
    return Stepper(lambda s, h, p: STEP, 3)
'''


def test_a_special_step_size_is_found_out(cli: Any, in_tmp: Any) -> None:
    """The degree falls at h = 0.3, the default, but not at the step size of the repetition."""
    (in_tmp / "mine.py").write_text(SCHEME.replace("STEP", "(s[0] + (h - 0.3) * s[1] ** 2, s[1] + h * s[0], s[2])"))
    document = cli("integrability", "euler", "mine", "--plugin", "mine.py", "--json").json()
    iterates = document["tables"][1]["rows"]
    assert {row["degree"] for row in iterates} - {None} == {1}
    assert [row["repeated"] for row in iterates[:3]] == [2, 2, 4]
    assert document["answer"].startswith("undecided: the degrees along another line with another h are different; ")


@pytest.mark.parametrize("step", REFUSED)
def test_a_step_that_is_not_rational_is_refused(cli: Any, in_tmp: Any, step: str) -> None:
    """By name; decisions that only count events are not, such as those of hk of the Kowalevski top."""
    (in_tmp / "mine.py").write_text(SCHEME.replace("STEP", step))
    said = cli("integrability", "euler", "mine", "--plugin", "mine.py")
    assert said.code == 2
    assert said.err == f"error: integrability: scheme 'mine' cannot compute with rational functions: {REFUSED[step]}\n"
