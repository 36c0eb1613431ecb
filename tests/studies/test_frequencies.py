"""Frequencies against the exact ones of integrable tops, convergence of weighted averages, and the study of both."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import topcli
from conftest import Said
from sweeping import measured
from topcli.analysis.frequencies import agreement_digits, rotation_number, strongest_line, weighted_mean
from topcli.config.load import load_experiment
from topcli.errors import UsageError

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
NAN = math.nan


def config(kind: str, scheme: str, N: int, omega: list[float], **more: Any) -> dict[str, Any]:
    initial = {"omega": omega, "gamma": [0.6, 0.0, 0.8]}
    return {"name": "orbit", "top": {"kind": kind, **more}, "initial": initial, "scheme": scheme, "h": 0.25, "N": N}


def columns_of(**options: Any) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in topcli.frequencies(**options).study["columns"]}


# the functions


@pytest.mark.parametrize("frequency", [0.1 * GOLDEN, 0.5 * GOLDEN, 0.4 + 1e-3 * GOLDEN])
def test_frequency_and_amplitude_of_a_line_among_weaker_ones(frequency: float) -> None:
    n = np.arange(4001)
    rows = 5.0 + 3.0 * np.cos(2.0 * np.pi * frequency * n + 1.0) + 2.0 * np.sin(2.0 * np.pi * 0.2371 * n)
    line = strongest_line(rows)
    assert line.frequency == pytest.approx(frequency, abs=1e-15)
    assert line.amplitude == pytest.approx(3.0, rel=1e-12)


@pytest.mark.parametrize(
    ("rows", "frequency"),
    [
        (np.full(100, 0.1), 0.0),
        (0.1 + 1e-17 * (-1.0) ** np.arange(100) * np.arange(100), 0.0),
        (np.zeros(100), 0.0),
        (np.arange(15.0), NAN),
        (np.r_[np.arange(99.0), NAN], NAN),
    ],
    ids=["constant", "round-off", "zero", "short", "nan"],
)
def test_columns_without_a_line(rows: np.ndarray, frequency: float) -> None:
    assert strongest_line(rows).frequency == pytest.approx(frequency, nan_ok=True)
    expected = 16.0 if frequency == 0.0 else NAN
    assert float(agreement_digits(rows)) == pytest.approx(expected, nan_ok=True)


def test_weighted_average_converges_faster_than_any_power() -> None:
    """The mean of cos over a turn is 0, and that of exp(cos) is I0(1)."""

    def error(m: int) -> float:
        return abs(float(weighted_mean(np.exp(np.cos(GOLDEN * np.arange(m) + 0.3)))) - float(np.i0(1.0)))

    assert error(100) > 1e-7
    assert error(4000) < 3e-15
    plain = np.exp(np.cos(GOLDEN * np.arange(4000) + 0.3)).mean() - np.i0(1.0)
    assert abs(plain) > 1e-5  # the ordinary mean


def test_digits_count_the_agreement_of_the_halves() -> None:
    """Relative to the amplitude: neither the unit of a column nor its zero matter."""
    wave = np.cos(2.0 * np.pi * 0.1 * GOLDEN * np.arange(2000))
    jump = np.arange(2000) >= 1000
    rows = np.stack([wave, wave + 1e-5 * jump, wave + 1e-9 * jump, 1.0 * jump])
    assert agreement_digits(rows)[1:] == pytest.approx([5.0, 9.0, 0.0], abs=0.05)
    assert agreement_digits(rows)[0] > 12.0
    for factor, offset in ((1e8, 0.0), (1.0, 10.0), (1.0, -1e4), (1e-3, 5.0)):
        assert agreement_digits(factor * rows + offset)[1:3] == pytest.approx([5.0, 9.0], abs=0.05)
    assert math.isnan(agreement_digits(np.append(wave, math.inf)))


@pytest.mark.parametrize("cycles", [0.05, 0.3, 0.7, 1.0, 1.4, 1.9, 2.3, 2.6, 3.0, 5.0, 12.0])
def test_a_frequency_is_right_or_none(cycles: float) -> None:
    """Of slow waves the spectrum has its peak at 1.2 cycles over the rows or more, whatever their frequency."""
    m, random = 1000, np.random.default_rng(23)
    for phase, offset in zip(random.uniform(0.0, 7.0, 20), random.normal(size=20), strict=True):
        line = strongest_line(offset + np.cos(2.0 * np.pi * cycles * np.arange(m) / m + phase))
        if cycles < 2.4:
            assert math.isnan(line.frequency)
            assert math.isnan(line.amplitude)
        else:
            assert line.frequency * m == pytest.approx(cycles, rel=0.01)  # 0.003 at 2.6 cycles
            assert line.amplitude == pytest.approx(1.0, rel=0.01)
    assert math.isnan(strongest_line(np.linspace(0.0, 1.0, m)).frequency)


def test_rotation_number_has_the_sense_of_the_rotation() -> None:
    angle = 2.0 * np.pi * 0.1 * GOLDEN * np.arange(2001)
    angle += 0.3 * np.sin(angle)  # an uneven rotation has the same mean
    for sign in (1, -1):
        assert rotation_number(np.cos(angle), np.sin(sign * angle)) == pytest.approx(sign * 0.1 * GOLDEN, abs=1e-15)
    assert math.isnan(rotation_number(np.r_[np.ones(99), math.inf], np.ones(100)))
    assert math.isnan(rotation_number(np.ones(16), np.ones(16)))


# exact frequencies


def test_frequencies_of_the_euler_top() -> None:
    orbit = config("euler", "exact", 1 << 14, [1.0, 0.5, 1.0], A=2.0, B=3.0, C=4.0)
    exact = topcli.motion(orbit)["frequency"]
    rows = columns_of(config=orbit, component=["omega1", "omega2", "omega3"], angle=["omega1,omega2"])
    assert rows["omega1"]["frequency"] == pytest.approx(exact, rel=1e-12)
    assert rows["omega2"]["frequency"] == pytest.approx(exact, rel=1e-12)
    assert rows["omega3"]["frequency"] == pytest.approx(2.0 * exact, rel=1e-12)
    assert abs(rows["angle of omega1, omega2"]["frequency"]) == pytest.approx(exact, rel=1e-12)
    assert min(row["digits"] for row in rows.values()) > 14.0


def test_frequencies_of_the_lagrange_top() -> None:
    initial = {"m": [0.3, 0.5, 2.0], "a": [0.6, 0.0, 0.8]}
    orbit = {**config("lagrange", "exact", 1 << 14, []), "top": "lagrange", "initial": initial}
    exact = topcli.motion(orbit)
    rows = columns_of(config=orbit, component=["a3"], angle=["a1,a2"])
    assert rows["a3"]["frequency"] == pytest.approx(exact["frequency.nutation"], rel=1e-12)
    assert rows["angle of a1, a2"]["frequency"] == pytest.approx(exact["frequency.precession"], rel=1e-12)


@pytest.mark.parametrize(
    ("omega", "lines"),
    [
        ([2.0, 1.0, 1.0], {"omega1": (0, 1), "gamma2": (0, 1), "gamma3": (1, 1)}),
        ([0.3, 0.2, 1.5], {"omega3": (0, 1), "gamma1": (1, 2), "gamma3": (1, 1)}),
        ([1.1, 0.5, 0.7], {"omega1": (0, 2), "omega2": (0, 1), "gamma3": (1, 1)}),
    ],
)
def test_frequencies_of_the_kowalevski_top(omega: list[float], lines: dict[str, tuple[int, int]]) -> None:
    """Every line is a sum of multiples of the two frequencies of the torus."""
    orbit = config("kowalevski", "taylor", 1 << 16, omega)
    exact = topcli.motion(orbit)
    rows = columns_of(config=orbit, component=list(lines))
    for name, (first, second) in lines.items():
        expected = first * exact["frequency.1"] + second * exact["frequency.2"]
        assert rows[name]["frequency"] == pytest.approx(expected, rel=1e-12), name


# the study and the measures


BLOWS_UP = ("--set", "scheme=rk2", "--set", "h=3", "--set", "N=2000")


def test_an_orbit_that_blows_up_has_no_frequencies(cli: Callable[..., Said]) -> None:
    arguments = ("frequencies", "kowalevski_hk", *BLOWS_UP, "--component", "omega1", "--angle", "gamma1,gamma2")
    said = cli(*arguments)
    assert said.code == 1
    assert "error: no frequencies: the run blew up at step 9" in said.err
    assert said.out.count("–") == 10
    said = cli(*arguments, "--json")
    assert said.code == 1
    assert said.json()["outcome"] == "blew_up"
    for row in said.json()["columns"]:
        assert set(row.values()) == {row["name"], None}


def test_command_prints_what_the_function_returns(cli: Callable[..., Said]) -> None:
    """Twelve digits of a frequency, and a quantity that is not a number."""
    formula = "output.quantities={bad: log(omega1 - 10), twice: 2*omega2}"
    arguments = ("frequencies", "euler_hk", "--set", "scheme=exact", "--set", formula)
    rows = {row["name"]: row for row in cli(*arguments, "--json").json()["columns"]}
    assert list(rows)[-2:] == ["bad", "twice"]
    assert rows["bad"]["frequency"] is None
    assert rows["twice"]["frequency"] == pytest.approx(rows["omega2"]["frequency"], rel=1e-12)
    said = cli(*arguments)
    assert said.code == 0
    lines = (line.split() for line in said.out.splitlines())
    printed = {line[0]: line[1] for line in lines if line and line[0] in rows}
    assert printed == {name: f"{row['frequency']:.12g}" if row["frequency"] else "–" for name, row in rows.items()}


def test_columns_that_are_too_slow_are_named(cli: Callable[..., Said]) -> None:
    """Waves of 1, 4 and 40 cycles in the run: no frequency, no change, and both."""
    waves = ", ".join(
        f"{name}: sin({2.0 * math.pi * cycles / 100.0!r}*t)" for name, cycles in (("a", 1), ("b", 4), ("c", 40))
    )
    options = ("--set", f"output.quantities={{{waves}}}", "--set", "h=0.1", "--set", "N=1000")
    options = ("--set", "scheme=exact", *options)
    arguments = ("frequencies", "euler_hk", *options, *(part for name in "abc" for part in ("--component", name)))
    rows = {row["name"]: row for row in cli(*arguments, "--json").json()["columns"]}
    assert (rows["a"]["frequency"], rows["a"]["change"], rows["b"]["change"]) == (None, None, None)
    assert rows["b"]["frequency"] == pytest.approx(0.04, rel=1e-3)
    assert abs(rows["c"]["change"]) < 1e-8
    said = cli(*arguments)
    assert said.code == 0
    assert "no frequency for a: fewer than 2.5 cycles in the run; take a longer one" in said.err
    assert "no change for a, b: fewer than 5 cycles in the run; take a longer one" in said.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"component": ["omega7"]}, "no column 'omega7'"),
        ({"angle": ["gamma1"]}, "--angle 'gamma1': write two columns"),
        ({"overrides": ["N=20"]}, "21 recorded rows: too few"),
        ({"overrides": ["N=100000000", "output.every=1"]}, "do not fit in memory; take 24 or more"),
    ],
)
def test_what_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        topcli.frequencies("euler_hk", **options)


def test_change_is_that_from_the_first_half_to_the_second() -> None:
    """The angle 0.3t + at² has the mean rate 0.3 + 2at at the middle of each half."""
    a, T = 1e-4, 4000 * 0.25
    formulas = {"x": f"cos(0.3*t + {a}*t**2)", "y": f"sin(0.3*t + {a}*t**2)"}
    orbit = {**config("kowalevski", "hk", 4000, [2.0, 1.0, 1.0]), "output": {"quantities": formulas}}
    rows = columns_of(config=orbit, component=["x"], angle=["x,y"])
    assert rows["angle of x, y"]["frequency"] == pytest.approx((0.3 + a * T) / (2.0 * np.pi), rel=1e-12)
    assert rows["angle of x, y"]["change"] == pytest.approx(a * T / (2.0 * np.pi), rel=1e-12)
    assert rows["x"]["change"] == pytest.approx(a * T / (2.0 * np.pi), rel=0.3)


def test_measures_are_those_of_the_study() -> None:
    orbit = {**config("kowalevski", "hk", 4000, [2.0, 1.0, 1.0]), "output": {"every": 2}}
    names = ["frequency.omega1", "digits.omega1"]
    row = columns_of(config=orbit, component=["omega1"])["omega1"]
    found = measured(load_experiment(orbit), names)
    assert [found[name][0] for name in names] == [row["frequency"], row["digits"]]
