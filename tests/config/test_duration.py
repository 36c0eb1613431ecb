"""A time T in the place of the number of steps: N = T/h, or what T would have to be."""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import topcli
from topcli.config.load import load, load_experiment
from topcli.config.ranges import steps_of, steps_over
from topcli.errors import ConfigError, UsageError


@pytest.mark.parametrize("h", ["0.001", "0.1", "0.007", "1e-4", "0.3", "3", "-0.05"])
@pytest.mark.parametrize("N", [1, 3, 7, 5000, 123_457, 10**9 + 7, 10**12])
def test_a_decimal_multiple_of_h_is_a_number_of_steps(N: int, h: str) -> None:
    """T is the decimal number N*h, rounded once; T/h is then off by at most 1.5 ulp."""
    assert steps_of(float(Fraction(h) * N), float(h)) == N


def test_the_tolerance_is_four_ulp() -> None:
    """Relative to T/h: 4 ulp are round-off, 5 ulp are not."""
    assert steps_of(1024.0 * (1.0 + 4 * 2.0**-52), 1.0) == 1024
    with pytest.raises(UsageError, match="not a whole number"):
        steps_of(1024.0 * (1.0 + 5 * 2.0**-52), 1.0)


@pytest.mark.parametrize(("T", "h"), [(50.0, 0.007), (1.0, 0.3), (2.0, 1 / 3 + 1e-9), (-1.0, -0.3), (1e-4, 1e-3)])
def test_the_nearest_times_are_on_both_sides_and_fit(T: float, h: float) -> None:
    with pytest.raises(UsageError) as refused:
        steps_of(T, h)
    found = [(float(T), int(N)) for T, N in re.findall(r"T = (\S+) \(N = (\d+)\)", str(refused.value))]
    assert [N for _, N in found] == [N for N in (int(T / h), int(T / h) + 1) if N]
    assert all(steps_of(T, h) == N for T, N in found)


def test_the_nearest_steps_for_a_given_time() -> None:
    with pytest.raises(UsageError) as refused:
        steps_over(1.0, 0.3)
    found = [(float(h), int(N)) for h, N in re.findall(r"h = (\S+) \(N = (\d+)\)", str(refused.value))]
    assert [N for _, N in found] == [4, 3]
    assert all(steps_over(1.0, h) == N for h, N in found)


@pytest.mark.parametrize(("T", "h", "message"), [(-1.0, 0.1, "the sign of h"), (1e9, 1e-4, "at most 1000000000000")])
def test_times_that_no_number_of_steps_fits(T: float, h: float, message: str) -> None:
    for function in (steps_of, steps_over):
        with pytest.raises(UsageError, match=message):
            function(T, h)


def test_a_config_with_a_time_resolves_to_the_number_of_steps(tmp_path: Path) -> None:
    text = "top: kowalevski\ninitial: {omega: [2, 0, 0], gamma: [auto, 0, 1e-3]}\nscheme: hk\nh: 0.01\nT: 50\n"
    path = tmp_path / "timed.yaml"
    path.write_text(text)
    counted = tmp_path / "counted.yaml"
    counted.write_text(text.replace("T: 50", "N: 5000"))
    timed = load_experiment(path)
    assert timed.resolved() == {**load_experiment(counted).resolved(), "name": "timed"}
    assert "T" not in timed.resolved()
    assert load_experiment(path, ["h=0.02"]).N == 2500
    assert load_experiment(path, ["N=7"]).N == 7
    assert load_experiment(counted, ["T=3"]).N == 300
    assert topcli.simulate(path, h=0.05, output={"every": 1000}).t[-1] == 1000 * 0.05
    path.write_text(text + "N: 5000\n")
    with pytest.raises(ConfigError, match=re.escape(f"{path}:5: T: N is given too ({path}:6); keep one of them")):
        load_experiment(path)


def test_overrides_and_keywords_replace_the_number_of_steps() -> None:
    assert load_experiment("kowalevski_hk", ["T=2", "h=0.01"]).N == 200
    assert load("kowalevski_ensemble", ["h=0.01", "T=2"]).resolved()["N"] == 200
    message = "--set T=2: T: N is given too (--set N=3); keep one of them"
    with pytest.raises(ConfigError, match=re.escape(message)):
        load_experiment("kowalevski_hk", ["T=2", "N=3"])
    assert len(topcli.simulate("kowalevski_hk", h=0.01, T=2)) == 201
    given = load_experiment("kowalevski_hk").resolved()
    assert len(topcli.simulate(given, h=0.01, T=2)) == 201
    assert len(topcli.simulate(given, overrides=["h=0.01", "T=2"])) == 201
    starts = np.array([load_experiment("kowalevski_hk").y0] * 2)
    assert topcli.simulate_ensemble("kowalevski_hk", states=starts, h=0.01, T=2).n[-1] == 200
    assert topcli.simulate_ensemble(given, states=starts, h=0.01, T=2).n[-1] == 200


def test_a_wrong_keyword_is_named_without_a_place() -> None:
    with pytest.raises(ConfigError, match=r"^h: must not be zero"):
        topcli.simulate("kowalevski_hk", h=0)


def test_keywords_replace_keys_of_a_mapping_which_stays_as_it_is() -> None:
    """In the Python call: the last word is that of an override, then a keyword, then the mapping, a file or a scene."""
    given: dict[str, Any] = load_experiment("kowalevski_hk", ["N=20", "h=0.01"]).resolved()
    before = copy.deepcopy(given)

    def ran(config: Any, overrides: Sequence[str] = (), **changes: Any) -> tuple[str, int, float]:
        found = topcli.simulate(config, overrides=overrides, **changes)
        return found.scheme, len(found) - 1, float(found.t[-1])

    assert ran(given) == ("hk", 20, 0.2)
    assert ran(given, h=0.5) == ran(None, **{**given, "h": 0.5}) == ("hk", 20, 10.0)
    assert ran(given, scheme="rk4", N=30) == ("rk4", 30, 0.3)
    assert ran(given, ["h=0.25"], h=0.5, N=4) == ("hk", 4, 1.0)
    assert ran("kowalevski_hk", ["h=0.25"], h=0.5, N=4) == ("hk", 4, 1.0)
    assert ran(given, initial={"omega": [1, 0, 0], "gamma": [0, 0, 1]}, N=1) == ("hk", 1, 0.01)
    assert given == before
    same = topcli.simulate(given, h=0.5)
    assert same.states.tobytes() == topcli.simulate({**given, "h": 0.5}).states.tobytes()
    assert same.states.tobytes() == topcli.simulate("kowalevski_hk", h=0.5, N=20).states.tobytes()
    starts = np.array([load_experiment("kowalevski_hk").y0] * 2)
    assert topcli.simulate_ensemble(given, states=starts, N=30).n[-1] == 30
    with pytest.raises(ConfigError, match="hh"):
        topcli.simulate(given, hh=0.5)
