"""Sizes of the terms of each invariant, to which bounds of round-off are relative, against formulas of their own.

Other tests divide deviations by ``Invariant.scale``; this one makes that an independent measure.
"""

from __future__ import annotations

import numpy as np
import pytest

from conftest import random_states
from declared import TRIALS
from topcli.contracts import Top

Terms = dict[str, list[float]]


def kowalevski(y: list[float], moment: float, c0: float) -> Terms:
    """Terms for the moments 2C, 2C, C with C = moment/2, and c = c0/C."""
    C = 0.5 * moment
    c = c0 / C
    w1, w2, w3, g1, g2, g3 = y
    xi1, xi2 = w1 * w1 - w2 * w2 - c * g1, 2.0 * w1 * w2 - c * g2
    return {
        "gamma_sq": [g1 * g1, g2 * g2, g3 * g3],
        "two_l": [2.0 * C * w1 * g1, 2.0 * C * w2 * g2, C * w3 * g3],
        "energy": [C * w1 * w1, C * w2 * w2, 0.5 * C * w3 * w3, c0 * g1],
        "k_sq": [xi1 * xi1, xi2 * xi2],
    }


def rigid(y: list[float], moments: tuple[float, ...], gravity: tuple[float, ...]) -> Terms:
    """Terms of a heavy top; E = omega.I omega/2 + gravity.gamma."""
    w, g = y[:3], y[3:]
    return {
        "gamma_sq": [b * b for b in g],
        "m_gamma": [m * a * b for m, a, b in zip(moments, w, g, strict=True)],
        "energy": [*(0.5 * m * a * a for m, a in zip(moments, w, strict=True)), *np.multiply(gravity, g)],
        "m_axis": [moments[2] * w[2]],
    }


def free(y: list[float], moments: tuple[float, ...]) -> Terms:
    """Terms of Euler's top; m.omega is twice the energy."""
    w, g = y[:3], y[3:]
    return {
        "m_sq": [(m * a) ** 2 for m, a in zip(moments, w, strict=True)],
        "m_omega": [m * a * a for m, a in zip(moments, w, strict=True)],
        "gamma_sq": [b * b for b in g],
        "m_gamma": [m * a * b for m, a, b in zip(moments, w, g, strict=False)],
    }


def inertial(y: list[float]) -> Terms:
    m, a = y[:3], y[3:]
    return {
        "a_sq": [v * v for v in a],
        "m_p": [m[2]],
        "m_a": [u * v for u, v in zip(m, a, strict=True)],
        "energy": [*(0.5 * u * u for u in m), a[2]],
    }


def terms_of(top: Top, y: list[float]) -> Terms:
    values = top.model_dump()
    if top.form == "lagrange/inertial":
        return inertial(y)
    if top.form == "kowalevski":
        return kowalevski(y, values["A"], values["c0"])
    if top.form == "lagrange":
        return rigid(y, (values["A"], values["A"], values["C"]), (0.0, 0.0, values["mu"]))
    moments = (values["A"], values["B"], values["C"])
    if top.form == "heavy":
        return rigid(y, moments, (values["x0"], values["y0"], values["z0"]))
    return free(y, moments)


@pytest.mark.parametrize("top", [top for tops in TRIALS.values() for top in tops], ids=repr)
def test_scale_is_the_size_of_the_terms(top: Top) -> None:
    """The sum of the terms' magnitudes; for k² = |omega² - c gamma|², of the terms within the square."""
    for y in random_states(50, seed=71)[:, : len(top.components)]:
        terms = terms_of(top, y.tolist())
        for invariant in top.invariants():
            size = sum(map(abs, terms[invariant.name]))
            scale = float(invariant.scale(y[None])[0])
            if invariant.name == "k_sq":
                assert size <= scale * (1.0 + 1e-14)
                w_sq, c = y[0] ** 2 + y[1] ** 2, abs(2.0 * top.model_dump()["c0"] / top.model_dump()["A"])
                assert scale == pytest.approx((w_sq + c * np.hypot(y[3], y[4])) ** 2, rel=1e-14)
            else:
                assert scale == pytest.approx(size, rel=1e-14)


@pytest.mark.parametrize("top", [top for tops in TRIALS.values() for top in tops], ids=repr)
def test_value_is_the_sum_of_the_terms(top: Top) -> None:
    for y in random_states(50, seed=72)[:, : len(top.components)]:
        terms = terms_of(top, y.tolist())
        for invariant in top.invariants():
            value = float(invariant.value(y[None])[0])
            size = float(invariant.scale(y[None])[0])
            assert value == pytest.approx(sum(terms[invariant.name]), rel=0.0, abs=4e-15 * max(size, 1e-300))
