"""Entries of a comparison: schemes with options and steps of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import topcli
from cases import table_of
from topcli.config.load import load_experiment
from topcli.errors import UsageError
from topcli.studies.compare_runs import compare_schemes
from topcli.studies.entries import Entry, read_entries
from topcli.studies.study import Result

SCENE = "kowalevski_generic_hk"


MIXED = ("hk", "hk:h=0.02", "hybrid:branch=sign", "hk+kahan-li6:h=0.04")


def entries(*texts: str, sets: tuple[str, ...] = (), options: dict[str, Any] | None = None) -> tuple[Entry, ...]:
    return read_entries(load_experiment(SCENE, ["h=0.01", "N=2000", *sets]), texts, options)


@pytest.fixture(scope="module")
def mixed() -> Result:
    return compare_schemes(load_experiment(SCENE, ["h=0.01", "N=2000"]), MIXED)


@pytest.mark.parametrize(
    ("text", "label", "options", "h", "N"),
    table_of("""
hybrid                         hybrid                     {"branch": "nearest"}  0.01  2000
Hybrid: branch=sign , h=2e-2   hybrid:branch=sign,h=0.02  {"branch": "sign"}     0.02  1000
hk+Kahan-Li6:h=4e-02           hk+kahan-li6:h=0.04        {}                     0.04  500
"""),
)
def test_an_entry_has_its_own_options_and_step(
    text: str, label: str, options: dict[str, str], h: float, N: int
) -> None:
    (found,) = entries(text)
    assert (found.label, found.experiment.h, found.experiment.N) == (label, h, N)
    assert options.items() <= found.experiment.options.model_dump().items()


def test_own_options_come_before_those_of_all() -> None:
    found = entries("hybrid", "hybrid:branch=nearest", "hk", options={"branch": "sign"})
    assert [one.experiment.options.model_dump().get("branch") for one in found] == ["sign", "nearest", None]


def test_entries_of_the_same_step_keep_the_rows_of_the_experiment() -> None:
    for one in entries("hk", "hybrid", sets=("output.every=7",)):
        assert (one.experiment.N, one.experiment.output.every, one.stride, one.rows_apart) == (2000, 7, 7, 1)


@pytest.mark.parametrize(
    ("texts", "every", "strides", "recorded"),
    table_of("""
hk hk:h=0.02             1     [2, 1]        [2, 1]
hk hk:h=0.02 hk:h=0.04   1     [4, 2, 1]     [4, 2, 1]
hk hk:h=0.02             5     [4, 2]        [4, 2]
hk hk:h=0.05             1000  [1000, 200]   [1000, 200]
hk hk:h=0.016666666666666666   1  [5, 3]        [5, 3]
hk hk:h=0.010666666666666666   1  [16, 15]      [4, 5]
hk hk:h=0.010005002501250625   1  [2000, 1999]  [5, 1]
"""),
)
def test_rows_are_recorded_at_common_times(texts: str, every: int, strides: list[int], recorded: list[int]) -> None:
    """300 rows or more: 2000 steps share 400 with 1200, but only 125 with 1875, so that there are rows between."""
    found = entries(*texts.split(), sets=(f"output.every={every}",))
    assert [one.stride for one in found] == strides
    assert [one.experiment.output.every for one in found] == recorded
    times = [np.arange(0, one.experiment.N + 1, one.stride) * one.experiment.h for one in found]
    for one in times:
        np.testing.assert_allclose(one, times[0], rtol=1e-14)
        assert one[-1] == pytest.approx(20.0, rel=1e-14)


@pytest.mark.parametrize(
    ("texts", "message"),
    table_of("""
hk:h=0.03                     "hk:h=0.03: T/h = 20/0.03 = 666.666667 is not a whole number of steps; nearest: h = "
hybrid:brunch=sign            hybrid:brunch=sign: scheme 'hybrid' has no option 'brunch'; did you mean 'branch'?
hybrid:branch=sing            hybrid:branch=sing: scheme.branch: must be 'nearest' or 'sign'
hkk:h=0.02                    hkk:h=0.02: unknown scheme 'hkk'; did you mean 'hk'?
hk:h                          hk:h: 'h': expected key=value, such as h=0.01
hk:h=0.02,h=0.04              hk:h=0.02,h=0.04: sets h twice; set it once
hk:h=0                        hk:h=0: h must be a finite number other than zero, not 0
hk:h=-0.02                    hk:h=-0.02: h = -0.02 must have the sign of 0.01, the step of the experiment
hk hk:h=1e-2                  hk:h=0.01: computes the same as hk; keep one of them
hybrid:branch=nearest hybrid  hybrid: computes the same as hybrid:branch=nearest; keep one of them
hk:h=0.02 HK:h=2e-2           hk:h=0.02 is named twice
hk HK                         scheme 'hk' is named twice
"""),
)
def test_errors_name_the_entry(texts: str, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        entries(*texts.split())
    assert str(refused.value).startswith(message)


@pytest.mark.slow
def test_errors_of_mixed_steps_are_those_of_single_runs(mixed: Result) -> None:
    """Each entry is compared at t = 0, 0.04, ..., 20; here with a Taylor series in double precision."""
    labels = [one["label"] for one in mixed.data["schemes"]]
    assert labels == list(MIXED)
    assert mixed.data["rows"] == len(mixed.arrays["t"]) == 501
    assert not mixed.data["few_rows"]
    fine = topcli.simulate(SCENE, scheme="taylor", h=0.04, N=500)
    for one in mixed.data["schemes"]:
        run = topcli.simulate(SCENE, scheme={"name": one["scheme"], **one["options"]}, h=one["h"], N=one["N"])
        states = run.states[:: one["N"] // 500]
        wanted = np.linalg.norm(states - fine.states, axis=1)
        assert one["max_error"] == pytest.approx(wanted.max(), rel=1e-6)
        assert one["final_error"] == pytest.approx(wanted[-1], rel=1e-6)
        np.testing.assert_allclose(mixed.arrays[f"error:{one['label']}"], wanted, rtol=1e-5, atol=1e-11)


def test_a_plain_comparison_has_the_same_figures_as_an_entry_alone() -> None:
    """A step given by an entry changes nothing but the label."""
    own = compare_schemes(load_experiment(SCENE, ["h=0.01", "N=1000"]), ["hk:h=0.02"])
    given = compare_schemes(load_experiment(SCENE, ["h=0.02", "N=500"]), ["hk"])
    outside = ("label", "own", "nanoseconds_per_step", "compile_seconds")
    first, second = ({k: v for k, v in one.data["schemes"][0].items() if k not in outside} for one in (own, given))
    assert first == second
    assert np.array_equal(own.arrays["error:hk:h=0.02"], given.arrays["error:hk"])


def test_a_failure_names_the_entry(cli: Any) -> None:
    said = cli("compare", "rk4", "rk4:h=2", "--config", SCENE, "--set", "h=0.01", "--set", "N=20000")
    assert said.code == 1
    assert "error: rk4:h=2: " in said.err
    assert "error: rk4: " not in said.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    table_of("""
hk hk:h=0.03                 error: hk:h=0.03: T/h = 50/0.03
hk hkk                       unknown scheme 'hkk'; did you mean 'hk'?
hk --set scheme.brunch=sign  --set scheme.brunch: none of the schemes has this option
"""),
)
def test_mistakes_are_refused_before_anything_runs(cli: Any, arguments: str, message: str) -> None:
    said = cli("compare", *arguments.split(), "--config", "kowalevski_hk")
    assert (said.code, said.out) == (2, "")
    assert message in said.err


def test_an_ensemble_is_refused(cli: Any) -> None:
    said = cli("compare", "hk", "--config", "kowalevski_ensemble")
    assert (said.code, said.out) == (2, "")
    assert "an ensemble of 1000 trajectories" in said.err
    assert "`topcli sweep` compares schemes on many states" in said.err
