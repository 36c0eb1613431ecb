"""The period of the paper's scene by order and symmetry of the scheme: the data behind the figure ``period``."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import topcli
from topcli.analysis.swings import spacing_law
from topcli.figures import period


def test_the_law_is_that_of_the_homoclinic_orbit() -> None:
    """28.1716 at eps = 1e-3, and 2 sqrt 2 ln 10 more for each decade."""
    law = spacing_law(np.array([1e-3, 1e-4]))
    assert law[0] == pytest.approx(28.1716, abs=1e-4)
    assert law[1] - law[0] == pytest.approx(2.0 * math.sqrt(2.0) * math.log(10.0), rel=1e-12)


@pytest.mark.slow
def test_columns_are_those_of_the_runs() -> None:
    """With few steps: gamma_1 of the rows, the swings of the motion, spacings with the right limits and slope."""
    short = [replace(scheme, exponents=(-2.0, -3.0)) for scheme in period.SCHEMES]
    shown = (("exact", 1e-3), ("bohlin-a", 1e-3))
    progress: list[tuple[int, int]] = []
    columns = period.period_columns(lambda done, total: progress.append((done, total)), short, shown)
    assert progress[-1] == (50_000 + 5 * 55_000, 50_000 + 5 * 55_000)
    assert columns["swings"] == pytest.approx([14.0858, 42.2571], abs=1e-3)
    run = topcli.simulate("kowalevski_bohlin_a")
    np.testing.assert_allclose(columns["gamma1:bohlin-a:1e-03"], run["gamma1"][::10], atol=1e-9)
    assert columns["h:hk"].tolist() == [1e-2, 1e-3]
    for name, spacing in (("hk", 28.1722), ("rk2", 28.1699), ("rk4", 28.1714), ("hybrid", 28.1676)):
        assert columns[f"spacing:{name}"][1] == pytest.approx(spacing, abs=2e-4)
    coarse, fine = columns["spacing:bohlin-a"]
    assert fine == pytest.approx(15.2967, abs=1e-3)
    assert fine - coarse == pytest.approx(math.sqrt(2.0) * math.log(10.0), rel=0.01)
