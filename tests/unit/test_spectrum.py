"""Spectra of Lyapunov exponents: their sum against determinants, all of them against an orthogonalisation each step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import topcli
from orbits import LORENZ, of_field
from topcli.analysis.lyapunov import Growth, spectrum_of
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.errors import UsageError

STRONG = {"x": "16*(y - x)", "y": "45.92*x - y - x*z", "z": "x*y - 4*z"}
"""Lorenz's system of Wolf and others, Physica D 16 (1985) 285: exponents 1.50, 0, -22.46."""
STIFF = {"x": "-150*(x - y*y)", "y": "z", "z": "-y - 0.1*x"}
NUDGE = 1e-5


def spectrum(experiment: Experiment, **options: Any) -> Growth:
    method, y0 = experiment.method(), list(experiment.y0)
    return spectrum_of(experiment.top, experiment.scheme, method, experiment.h, experiment.N, y0, **options)


def jacobians(experiment: Experiment) -> np.ndarray:
    """Derivatives of the steps along the orbit (N, d, d), by central differences of the step itself."""
    step = topcli.step(experiment.resolved())
    y, d = np.array(experiment.y0, dtype=float), len(experiment.y0)
    states = np.empty((experiment.N, d))
    for n in range(experiment.N):
        states[n], y = y, step(y, 1)
    moved = states[:, None, :] + NUDGE * np.concatenate([np.eye(d), -np.eye(d)])
    images = step(moved.reshape(-1, d), 1).reshape(experiment.N, 2, d, d)
    return np.moveaxis(images[:, 0] - images[:, 1], 1, 2) / (2.0 * NUDGE)


FIELDS = {
    "strong contraction": (STRONG, (1.0, 2.0, 20.0), 0.02),
    "stiff": (STIFF, (1.0, 1.0, 0.5), 0.01),
}


@pytest.mark.parametrize(
    ("experiment", "divergence"),
    [
        (of_field(LORENZ, (1.0, 2.0, 20.0), "taylor", 0.01, 10_000), -41.0 / 3.0),
        (of_field(STRONG, (1.0, 2.0, 20.0), "taylor", 0.02, 5_000), -21.0),
        (load_experiment("heavy_chaotic", ["scheme=taylor", "N=20000"]), 0.0),
    ],
    ids=["Lorenz", "strong contraction", "heavy top"],
)
def test_all_vectors_of_a_scheme_with_steps_of_its_own_follow_one_orbit(
    experiment: Experiment, divergence: float
) -> None:
    """Their exponents add up to the divergence of the field, a constant, to round-off."""
    assert spectrum(experiment).exponents.sum() == pytest.approx(divergence, abs=1e-9)


@pytest.mark.parametrize("field", ["strong contraction", "stiff"])
def test_vectors_are_made_orthogonal_as_often_as_it_takes(field: str) -> None:
    """The exponents are those of an orthogonalisation after each step, with derivatives by differences."""
    experiment = of_field(FIELDS[field][0], FIELDS[field][1], "rk4", FIELDS[field][2], 2000)
    growth = spectrum(experiment, discard=0)
    q = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    total = np.zeros(3)
    for jacobian in jacobians(experiment):
        q, r = np.linalg.qr(jacobian @ q)
        total += np.log(np.abs(np.diag(r)))
    assert growth.logs[-1] == pytest.approx(total, abs=3.0)  # by the directions of the first vectors
    assert growth.logs[-1, 2] < -800.0


def test_a_step_that_stretches_vectors_too_differently_is_refused() -> None:
    experiment = of_field({"x": "-1000*(x - y)", "y": "-0.1*y"}, (1.0, 1.0), "taylor", 0.05)
    with pytest.raises(UsageError, match=r"after one step at t = 0, .* differ by a factor exp\(\d\d\), too much"):
        spectrum(experiment)


def test_vectors_that_all_grow_fast_are_not_lost() -> None:
    """In 64 steps by exp(2600), more than a double can hold; their difference alone would allow as many steps."""
    growth = spectrum(of_field({"x": "40*x - y*y", "y": "40.02*y + x*y"}, (0.0, 0.0), "taylor", 1.0))
    assert growth.exponents == pytest.approx([40.02, 40.0], abs=0.01)


def test_all_exponents_leave_out_the_same_time() -> None:
    """So that they add up: those of Lorenz's system from the neighbourhood of a spiral that is left slowly."""
    growth = spectrum(of_field(LORENZ, (0.0, 10.0, 0.0), "rk4", 0.01, 50_000))
    assert growth.skipped[0] > 0
    assert len(set(growth.skipped.tolist())) == 1
    assert growth.exponents.sum() == pytest.approx(-41.0 / 3.0, abs=1e-3)
    assert growth.exponents == pytest.approx([0.9056, 0.0, -14.572], abs=0.05)
    assert (np.abs(growth.exponents - [0.9056, 0.0, -14.572]) < growth.errors).all()


def test_what_a_spectrum_discards_does_not_count() -> None:
    late = spectrum(of_field(LORENZ, (0.0, 10.0, 0.0), "rk4", 0.01, 20_000), discard=8_000)
    assert (late.n[-1], late.skipped[0]) == (12_000, 0)
    assert late.exponents.sum() == pytest.approx(-41.0 / 3.0, abs=1e-3)
    assert late.exponents[0] == pytest.approx(0.9056, abs=late.errors[0])
