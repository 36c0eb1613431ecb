"""The registered schemes and the tops that each of them is tried on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from conftest import GEN
from topcli.contracts import Top
from topcli.schemes.registry import all_schemes
from topcli.tops import CATALOGUE, TOPS
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

Heavy: Any = TOPS["heavy"]
SCHEMES = tuple(scheme for scheme in all_schemes() if scheme.top not in CATALOGUE)
"""Without those on tops of the catalogue, of which ``tests/tops/test_catalogue.py`` tries the generated ones."""
CHOSEN: dict[str, list[Top]] = {
    "kowalevski": [Kowalevski(), Kowalevski(c0=-1.5), Kowalevski(c0=0.0), Kowalevski(c0=2.0, A=5.0)],
    "euler": [Euler(), Euler(A=1.3, B=2.0, C=0.9), Euler(A=2.0, B=2.0, C=3.0)],
    "euler+gamma": [EulerGamma(), EulerGamma(A=1.3, B=2.0, C=0.9), EulerGamma(A=1.0, B=1.0, C=1.0)],
    "heavy": [Heavy(), Heavy(A=0.7, B=1.1, C=1.6, x0=-0.4, y0=1.2, z0=0.3), Heavy(A=3.0, B=1.0, C=2.5, y0=0.0)],
    "lagrange": [Lagrange(), Lagrange(A=1.4, C=2.1, mu=-0.8), Lagrange(mu=0.0), Lagrange(A=1.0, C=1.0)],
    "lagrange/inertial": [LagrangeInertial()],
}
BODIES = [form for form in TOPS if form not in CATALOGUE]
"""Forms of the tops that are cases of the Euler-Poisson equations."""
TRIALS: dict[str, list[Top]] = {form: CHOSEN.get(form) or [top.new()] for form, top in TOPS.items()}
"""Tops to try the schemes of each form on, the default one if none is chosen; the first two are generic."""


def gen(top: Top) -> tuple[float, ...]:
    """A generic state of the top."""
    return GEN[: len(top.components)]


by_name = pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: f"{s.name}/{s.top}")


def random_heavy_tops(count: int, seed: int) -> list[Top]:
    """Heavy tops of real bodies: moments that are sums of pairs of positive numbers, any centre of gravity."""
    random = np.random.default_rng(seed)
    made = []
    for a, b, c in random.uniform(0.2, 1.5, size=(count, 3)):
        x, y, z = random.normal(size=3)
        made.append(Heavy(A=b + c, B=c + a, C=a + b, x0=x, y0=y, z0=z))
    return made
