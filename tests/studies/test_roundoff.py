"""The growth of round-off: the fit on series whose law is known, the study and the command."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from cases import table_of
from topcli.analysis.roundoff import BlockMeans, block_weights, growth
from topcli.config.models import Experiment
from topcli.contracts import Ending, Floats, Invariant, Outcome, StepFunction, Stepper
from topcli.errors import UsageError
from topcli.studies.roundoff_copies import Copies, Sampling, _rows, forms_of, roundoff_experiment, roundoff_study

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


def made_of(function) -> Invariant:
    return Invariant("f", "f", "f", "a function of the first component", function, lambda y: np.abs(y[:, 0]))


def test_block_means_do_not_depend_on_the_chunks() -> None:
    states = np.random.default_rng(3).normal(size=(1 + 16 * 50, 1))
    whole, parts = (BlockMeans([made_of(lambda y: y[:, 0] ** 2)], 16, 50) for _ in range(2))
    whole.add(states)
    for piece in np.split(states, [1, 2, 99, 100, 101, 640]):
        parts.add(piece)
    np.testing.assert_allclose(parts.means, whole.means, rtol=1e-12)
    assert parts.largest == whole.largest
    first = states[0, 0] ** 2
    np.testing.assert_allclose(whole.means[0, 3], block_weights(50) @ (states[151:201, 0] ** 2 - first), rtol=1e-12)


@pytest.mark.slow
def test_block_means_take_an_oscillation_out() -> None:
    """An oscillation of size one to less than round-off, and not the walk beneath it."""
    rows, blocks = 80_000, 16
    t = 0.05 * np.arange(1 + rows * blocks)
    wave = 1.0 + np.cos(2.3 * t) + 0.5 * np.sin(0.9 * np.sqrt(2.0) * t)
    drift = 1e-9 * t
    means = BlockMeans([made_of(lambda y: y[:, 0])], blocks, rows)
    means.add((wave + drift)[:, None])
    steps = np.diff(means.means[0])
    np.testing.assert_allclose(steps, 1e-9 * 0.05 * rows, atol=1e-14)


def shrunk(step: StepFunction) -> StepFunction:
    """A step whose gamma1 is rounded towards zero, as a bad algebra may: biased by an ulp or so."""

    def biased(s: Floats, h: float, p: Floats) -> Floats:
        new = step(s, h, p)
        return (*new[:3], new[3] * (1.0 - 2.0**-53), *new[4:])

    return biased


def with_bias(experiment: Experiment) -> Experiment:
    method = experiment.method()
    assert isinstance(method, Stepper)
    scheme = replace(experiment.scheme, build=lambda top, options: replace(method, step=shrunk(method.step)))
    return experiment.model_copy(update={"scheme": scheme})


@pytest.mark.slow
def test_hybrid_is_a_random_walk_and_a_biased_scheme_is_not() -> None:
    experiment = roundoff_experiment("hybrid", "kowalevski_generic_hk", ["h=0.01"])
    study = roundoff_study(experiment, 400_000, 6)
    assert [row["verdict"] for row in study["forms"][0]["invariants"]] == ["random walk", "random walk"]
    control = roundoff_study(with_bias(experiment), 400_000, 6)["forms"][0]["invariants"]
    assert control[0]["name"] == "gamma_sq"
    assert control[0]["verdict"] == "biased"
    assert control[0]["exponent"] > 0.8
    assert control[0]["bias"] < -5.0 * control[0]["bias_error"]


@pytest.mark.slow
def test_hk_of_kowalevski_by_long_windows() -> None:
    """No integral is exact, all oscillate by 1e-3 and more, and yet round-off is seen, and seen to be smaller."""
    experiment = roundoff_experiment("hk", None, ["h=0.08"])
    assert experiment.name == "kowalevski_generic_hk"
    study = roundoff_study(experiment, 1_300_000, 4)
    assert study["claimed"] is False
    plain, better = (form["invariants"][0] for form in study["forms"])
    assert plain["name"] == "gamma_sq"
    assert plain["max_deviation"] == pytest.approx(0.00622, rel=0.05)
    assert 2e-14 < plain["drift"] < 4e-13  # typically 9e-14, the end of a random walk of four copies
    assert better["drift"] < 0.2 * plain["drift"]  # typically a twentieth
    assert plain["verdict"] == "random walk"
    assert abs(plain["bias"]) < 5.0 * plain["bias_error"]
    assert better["bias"] is None  # what all copies have in common cannot be distinguished from the map's own motion


def test_drifts_are_root_mean_squares_and_maxima_over_the_copies() -> None:
    """Of an exact invariant from its first value, of others from the mean of the copies."""
    means = np.zeros((1, 3, 16))
    means[0, 0, -1], means[0, 1, -1], means[0, 1, 5] = 3e-16, -1e-16, -7e-16
    copies = Copies(Ending(Outcome.COMPLETED, 1, 1.0), means, np.array([9e-16]), np.array([2.0]))
    (row,) = _rows([made_of(lambda y: y[:, 0])], True, Sampling(16, 4, 5), copies, np.zeros((1, 16)))
    assert row["drift"] == pytest.approx(math.sqrt((9.0 + 1.0) / 3.0) * 1e-16, rel=1e-12, abs=0.0)
    assert (row["max_drift"], row["max_deviation"], row["scale"]) == (7e-16, 9e-16, 2.0)
    assert row["bias"] == pytest.approx((3e-16 - 1e-16) / 3.0 / 15.0 / 20.0, rel=1e-12, abs=0.0)
    assert row["steps"] == [40, 80, 160]
    (row,) = _rows([made_of(lambda y: y[:, 0])], False, Sampling(16, 4, 5), copies, means.mean(axis=1))
    spread = float(np.std([3e-16, -1e-16, 0.0], ddof=1))
    assert row["drift"] == pytest.approx(spread, rel=1e-12, abs=0.0)
    assert row["bias"] is None


def test_experiments_are_chosen() -> None:
    assert roundoff_experiment("hk+kahan-li8", "lagrange_hk").scheme.name == "hk+kahan-li8"
    assert roundoff_experiment("bs", None).top.form == "lagrange/inertial"
    assert roundoff_experiment("bs-implicit", None).top.kind == "euler"
    assert roundoff_experiment("hybrid", None).name == "kowalevski_hk"
    resolved = roundoff_experiment("midpoint", None, ["scheme.compensated=true"])
    assert [one.options.model_dump()["compensated"] for one in forms_of(resolved).values()] == [False, True]


@pytest.mark.parametrize(
    ("scheme", "steps", "copies", "message"),
    table_of("""
exact   10_000      2  closed form
hybrid  100         2  --steps 100: too few for a fit of the growth; give at least 256
hk      100_000     3  windows of length 4000 need at least 6400000 steps at h = 0.01
hybrid  10_000      1  --copies 1: must be at least 2
hk      10_000_000  2  --copies 2: must be at least 3
"""),
)
def test_unsuitable_experiments_are_refused(scheme: str, steps: int, copies: int, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        roundoff_study(roundoff_experiment(scheme, None), steps, copies)


@pytest.mark.slow
def test_command_reports_both_forms(cli, tmp_path: Path) -> None:
    said = cli("roundoff", "midpoint", "--steps", "1e5", "--copies", "2", "--plot", "--out", "f")
    assert said.code == 0
    rows = [line.split()[:2] for line in said.out.splitlines()[-6:]]
    assert rows == [[symbol, form] for symbol in ("γ²", "2l", "E") for form in ("plain", "compensated")]
    assert sorted(path.suffix for path in (tmp_path / "f").iterdir()) == [".parquet", ".pdf", ".png"]
    drawn = pq.read_table(tmp_path / "f" / "roundoff_midpoint_kowalevski_hk.parquet")
    report = cli("roundoff", "midpoint", "--steps", "1e5", "--copies", "2", "--json").json()
    assert (report["command"], report["copies"], report["violations"]) == ("roundoff", 2, [])
    assert report["forms"][1]["options"] == {"compensated": True, "project": 0}
    for form in report["forms"]:
        for row in form["invariants"]:
            assert row["verdict"] == ("flat" if form["form"] == "compensated" else "random walk")
            assert drawn.column("steps").to_pylist() == row["steps"]
            assert drawn.column(f"{row['name']}:{form['form']}").to_pylist() == row["rms"]


@pytest.mark.slow
def test_tolerances_judge_the_compensated_form(cli) -> None:
    """HK of the Euler top drifts by 7e-15 to 2e-13 with plain sums, and by 1e-16 to 3e-15 with compensated ones.

    A tolerance between the two is met, one below a part of the compensated drifts names those alone.
    """
    asked = ("roundoff", "hk", "--config", "euler_hk", "--set", "h=0.01", "--steps", "2e4", "--copies", "2")

    def judged(*options: str) -> tuple[int, list[str], dict[str, dict[str, dict[str, float]]]]:
        said = cli(*asked, *options, "--json")
        found = said.json()
        forms = {form["form"]: {row["name"]: row for row in form["invariants"]} for form in found["forms"]}
        return said.code, found["violations"], forms

    code, violations, forms = judged("--max-drift", "5e-15", "--max-exponent", "0.3")
    plain, better = forms["plain"], forms["compensated"]
    assert min(row["max_drift"] for row in plain.values()) > 5e-15 > max(row["max_drift"] for row in better.values())
    assert (code, violations) == (0, [])
    ordered = sorted(row["max_drift"] for row in better.values())
    limit = math.sqrt(ordered[1] * ordered[2])
    code, violations, forms = judged("--max-drift", repr(limit))
    beyond = {name for name, row in forms["compensated"].items() if row["max_drift"] > limit}
    assert code == 4
    assert {line.partition(" of hk with compensated sums: drift ")[0] for line in violations} == beyond
    assert len(beyond) == len(ordered) - 2
    code, violations, forms = judged("--max-exponent", "-1")
    assert (code, len(violations)) == (4, len(better))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    table_of("""
hybird                2  did you mean 'hybrid'
hybrid --steps 0      2  --steps 0: must be a whole number
hybrid --steps 1.5e0  2  --steps 1.5e0: must be a whole number
rk4 --config heavy_hk --set h=4 --steps 1e6 --copies 3  1  error: rk4 with plain sums: blew up at step
"""),
)
def test_command_names_what_is_wrong(cli, arguments: str, code: int, message: str) -> None:
    said = cli("roundoff", *arguments.split())
    assert said.code == code
    assert message in said.err
