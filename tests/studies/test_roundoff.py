"""The growth of round-off: the fit on series whose law is known, the study and the command."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import topcli
from cases import table_of
from conftest import Said
from topcli.studies.roundoff import growth

SIZE = 1e-16


def walks(seed: int, copies: int = 8, blocks: int = 256) -> np.ndarray:
    return SIZE * np.cumsum(np.random.default_rng(seed).normal(size=(copies, blocks)), axis=1)


def noise(seed: int, copies: int = 8, blocks: int = 256) -> np.ndarray:
    return SIZE * np.random.default_rng(seed).normal(size=(copies, blocks))


@pytest.mark.slow
@pytest.mark.parametrize("copies", [2, 8])
def test_random_walk_has_exponent_one_half(copies: int) -> None:
    """Exponents about 1/2, within the errors that are reported; never taken for a bias."""
    fits = [growth(walks(seed, copies), 100, 1.0) for seed in range(60)]
    exponents, errors, biases, bias_errors = np.array(
        [(fit.exponent, fit.exponent_error, fit.bias, fit.bias_error) for fit in fits]
    ).T
    assert abs(exponents.mean() - 0.5) < 0.03
    assert np.mean(abs(exponents - exponents.mean()) < errors) > 0.85
    assert np.mean(abs(biases) < bias_errors) > 0.85
    assert "biased" not in {fit.verdict for fit in fits}
    assert fits[0].steps == [200, 400, 800, 1600, 3200, 6400, 12800]
    np.testing.assert_allclose(fits[0].rms[0], SIZE * np.sqrt(2.0), rtol=0.2)


@pytest.mark.parametrize("bias", [0.3, -0.5, 3.0])
def test_bias_has_exponent_one(bias: float) -> None:
    """A mean that a walk hides at first and that wins in the end; its size is found."""
    trend = SIZE * bias * np.arange(256)
    fit = growth(walks(1) + trend, 100, 1.0)
    assert fit.verdict == "biased"
    assert fit.exponent is not None
    assert 0.6 < fit.exponent < 1.02
    assert abs(fit.bias - SIZE * bias / 100) < 2.0 * fit.bias_error
    pure = growth(noise(1) + 100.0 * trend, 100, 1.0)
    assert pure.exponent == pytest.approx(1.0, abs=0.01)


def test_growth_of_noise_is_flat() -> None:
    flat = growth(noise(2), 100, 1.0)
    assert (flat.verdict, flat.exponent) == ("flat", pytest.approx(0.0, abs=0.03))
    still = growth(np.zeros((4, 64)), 100, 1.0)
    assert (still.verdict, still.exponent, still.bias) == ("flat", None, 0.0)
    assert growth(1e6 * noise(3), 100, 1.0).verdict == "moves"
    for shape in ((4, 15), (1, 64)):
        with pytest.raises(ValueError, match=f"{shape[1]} blocks of {shape[0]} copies"):
            growth(np.zeros(shape), 100, 1.0)


@pytest.mark.slow
def test_the_figures_of_both_forms_are_in_their_places() -> None:
    report = topcli.roundoff("hk", config="euler_hk", steps=20_000, copies=2)
    rows = report.tables[0].rows
    assert report.answer.startswith("plain sums: random walk (m²/K, m·ω/K, κ12, κ23, κ31); compensated sums: flat (")
    for plain, other in zip(rows[::2], rows[1::2], strict=True):
        assert (plain["sums"], other["sums"], plain["invariant"]) == ("plain", "compensated", other["invariant"])
        assert plain["rms_drift"] > 10.0 * other["rms_drift"]
        for row in (plain, other):
            assert row["rms_drift"] < row["largest_drift"]
            assert row["bias_error"] > 0.0
            assert row["cost"] == row["ns_per_step"] / plain["ns_per_step"]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    table_of("""
hybrid --steps 100    2  --steps 100: too few for a fit of the growth; give at least 256
hybrid --set N=10     2  --set N=10: the number of steps is set by --steps
exact                 2  closed form
hk                    2  conserves nothing exactly on kowalevski_generic_hk
midpoint --config heavy_hk --set h=4 --steps 1e4 --copies 3  1  error: midpoint with plain sums:
"""),
)
def test_command_names_what_is_wrong(cli: Callable[..., Said], arguments: str, code: int, message: str) -> None:
    said = cli("roundoff", *arguments.split())
    assert said.code == code
    assert message in said.err
