"""Lax forms: the matrices against closed forms of their spectra, and the study, each with a form or run that fails."""

from __future__ import annotations

import pytest

import topcli
from cases import table_of
from declared import Heavy, random_heavy_tops
from topcli.contracts import EulerPoisson, Floats
from topcli.errors import UsageError
from topcli.studies.lax import (
    block_form,
    lagrange_form,
    lax_forms,
    manakov_form,
    spectral_content,
)

EULER = EulerPoisson((2.0, 1.5, 1.0), (0.0, 0.0, 0.0))
LAGRANGE = EulerPoisson((1.6, 1.6, 0.9), (0.0, 0.0, 0.7))


@pytest.mark.parametrize(
    ("moments", "gravity", "names"),
    table_of("""
(3.0, 2.0, 1.0)  (0.0, 0.0, 0.0)  manakov block
(2.0, 2.0, 1.0)  (1.0, 0.0, 0.0)  kowalevski block
(2.0, 2.0, 1.0)  (0.0, 0.0, 0.0)  manakov lagrange kowalevski block
(2.0, 2.0, 1.0)  (1.0, 0.0, 0.5)  block
"""),
)
def test_which_forms_a_top_has(moments: Floats, gravity: Floats, names: str) -> None:
    assert [form.name for form in lax_forms(EulerPoisson(moments, gravity))] == names.split()


def test_what_the_spectra_carry() -> None:
    for equations, make, count, carried in (
        (LAGRANGE, lagrange_form, 4, ("gamma_sq", "m_gamma", "energy")),
        (EULER, manakov_form, 2, ("energy",)),
    ):
        (A, B, C), (x, y, z) = equations.moments, equations.gravity
        invariants = Heavy(A=A, B=B, C=C, x0=x, y0=y, z0=z).invariants()
        assert spectral_content(make(equations), invariants, 6) == (count, carried)
    for top in random_heavy_tops(3, seed=3):
        form = block_form(top.euler_poisson())
        assert spectral_content(form, top.invariants(), 6) == (2, ("gamma_sq", "m_gamma"))


def test_the_study_reports_forms_and_runs() -> None:
    """Typical defects are 3e-17 to 9e-15 for what is exact."""
    report = topcli.lax("kowalevski", "midpoint", "backlund", overrides=["N=200"])
    forms, runs = report.table, report.tables[1].frame()
    assert forms["size"].to_dict() == {"kowalevski": "5x5", "block": "6x6"}
    assert forms["Lax pair"].to_dict() == {"kowalevski": True, "block": False}
    assert forms.loc["kowalevski", "carried integrals"] == "gamma_sq, two_l, energy, k_sq"
    assert forms["independent integrals"].tolist() == [4, 2]
    assert (forms["dL/dt - [M,L]"] < 1e-15).all()
    assert list(runs.index) == ["exact flow", "midpoint", "backlund"]
    drifts = runs[["kowalevski: tr L^k", "block: block traces of L^k"]]
    assert (drifts.loc[["exact flow", "backlund"]] < 1e-14).all(axis=None)
    assert drifts.loc["midpoint"].tolist() == pytest.approx([3.405e-7, 0.0], rel=1e-3, abs=1e-13)
    assert report.answer == "kowalevski is a Lax pair; block is no Lax pair"


def test_another_top_is_refused_and_a_failed_run_is_reported() -> None:
    with pytest.raises(UsageError, match="of the top 'kowalevski', not 'heavy'"):
        topcli.lax("heavy", config="kowalevski_hk")
    report = topcli.lax("heavy", "rk2", overrides=["h=60.0", "N=20", "top.x0=50"])
    assert (report.code, report.errors[0].partition(" at ")[0]) == (1, "rk2: blew up")
