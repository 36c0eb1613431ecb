"""Frequencies against the exact ones of integrable tops, convergence of weighted averages, and the study of both."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import topcli
from conftest import Said
from topcli.analysis.frequencies import agreement_digits, strongest_line

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def config(kind: str, scheme: str, N: int, omega: list[float], **more: Any) -> dict[str, Any]:
    initial = {"omega": omega, "gamma": [0.6, 0.0, 0.8]}
    return {"name": "orbit", "top": {"kind": kind, **more}, "initial": initial, "scheme": scheme, "h": 0.25, "N": N}


def columns_of(**options: Any) -> dict[str, dict[str, Any]]:
    return {row["column"]: dict(row) for row in topcli.frequencies(**options).tables[0].rows}


# the functions


def test_digits_count_the_agreement_of_the_halves() -> None:
    """Relative to the amplitude: neither the unit of a column nor its zero matter."""
    wave = np.cos(2.0 * np.pi * 0.1 * GOLDEN * np.arange(2000))
    jump = np.arange(2000) >= 1000
    rows = np.stack([wave, wave + 1e-5 * jump, wave + 1e-9 * jump, 1.0 * jump])
    assert agreement_digits(rows)[1:] == pytest.approx([5.0, 9.0, 0.0], abs=0.05)
    assert agreement_digits(rows)[0] > 12.0
    assert agreement_digits(1e-3 * rows + 5.0)[1:3] == pytest.approx([5.0, 9.0], abs=0.05)


@pytest.mark.parametrize("cycles", [0.05, 0.7, 1.4, 2.3, 2.6, 5.0])
def test_a_frequency_is_right_or_none(cycles: float) -> None:
    """Of slow waves the spectrum has its peak at 1.2 cycles over the rows or more, whatever their frequency."""
    m, random = 1000, np.random.default_rng(23)
    for phase, offset in zip(random.uniform(0.0, 7.0, 20), random.normal(size=20), strict=True):
        line = strongest_line(offset + np.cos(2.0 * np.pi * cycles * np.arange(m) / m + phase))
        expected = (math.nan, math.nan) if cycles < 2.4 else (cycles, 1.0)
        assert (line.frequency * m, line.amplitude) == pytest.approx(expected, rel=0.01, nan_ok=True)


# exact frequencies


def test_frequencies_of_the_euler_top() -> None:
    orbit = config("euler", "exact", 1 << 14, [1.0, 0.5, 1.0], A=2.0, B=3.0, C=4.0)
    exact = topcli.motion(orbit)["frequency"]
    rows = columns_of(config=orbit, component=["omega1", "omega3"])
    assert rows["omega1"]["frequency"] == pytest.approx(exact, rel=1e-12)
    assert rows["omega3"]["frequency"] == pytest.approx(2.0 * exact, rel=1e-12)
    assert min(row["digits"] for row in rows.values()) > 14.0


def test_the_limits_of_an_orbit_are_said() -> None:
    *_, note = topcli.frequencies("euler_hk", overrides=["N=4000", "h=0.01"], component=["omega1"]).notes
    assert "4001 rows over T = 40: a frequency above 50 appears" in note
    assert "closer than about 1.8 disturb" in note


def test_frequencies_of_the_kowalevski_top() -> None:
    """Every line is a sum of multiples of the two frequencies of the torus."""
    orbit, lines = config("kowalevski", "taylor", 1 << 14, [1.1, 0.5, 0.7]), {"omega1": (0, 2), "gamma3": (1, 1)}
    exact = topcli.motion(orbit)
    rows = columns_of(config=orbit, component=list(lines))
    for name, (first, second) in lines.items():
        expected = first * exact["frequency.1"] + second * exact["frequency.2"]
        assert rows[name]["frequency"] == pytest.approx(expected, rel=1e-12), name


# the study and the measures


def test_an_orbit_that_blows_up_has_no_frequencies() -> None:
    report = topcli.frequencies("kowalevski_hk", ["scheme=rk2", "h=3", "N=2000"], component=["omega1"])
    assert (report.code, report.tables[0].rows) == (1, [])
    assert report.errors[0].startswith("no frequencies: the run blew up at step 9")


def test_columns_that_are_no_numbers_or_too_slow_are_named(cli: Callable[..., Said]) -> None:
    """Waves of 1, 4 and 40 cycles in the run: no frequency, no change, and both."""
    waves = {name: f"sin({2.0 * math.pi * cycles / 100.0!r}*t)" for name, cycles in (("a", 1), ("b", 4), ("c", 40))}
    quantities = ", ".join(f"{name}: {text}" for name, text in {**waves, "bad": "log(omega1 - 10)"}.items())
    options = ("--set", f"output.quantities={{{quantities}}}", "--set", "h=0.1", "--set", "N=1000")
    components = (part for name in ("a", "b", "c", "bad") for part in ("--component", name))
    arguments = ("frequencies", "euler_hk", "--set", "scheme=exact", *options, *components)
    rows = {row["column"]: row for row in cli(*arguments, "--json").json()["tables"][0]["rows"]}
    assert (rows["a"]["frequency"], rows["a"]["change"], rows["b"]["change"]) == (None, None, None)
    assert set(rows["bad"].values()) == {"bad", None}
    assert rows["b"]["frequency"] == pytest.approx(0.04, rel=1e-3)
    assert abs(rows["c"]["change"]) < 1e-8
    said = cli(*arguments)
    assert said.code == 0
    assert "no frequency for a: fewer than 2.5 cycles in the run; take a longer one" in said.err
    assert "no change for a, b: fewer than 5 cycles in the run; take a longer one" in said.err
    assert re.search(rf"^c +{rows['c']['frequency']:.12g} ", said.out, re.MULTILINE)


def test_change_is_that_from_the_first_half_to_the_second() -> None:
    """The angle 0.3t + at² has the mean rate 0.3 + 2at at the middle of each half."""
    a, T = 1e-4, 4000 * 0.25
    formulas = {"x": f"cos(0.3*t + {a}*t**2)"}
    orbit = {**config("kowalevski", "hk", 4000, [2.0, 1.0, 1.0]), "output": {"quantities": formulas}}
    rows = columns_of(config=orbit, component=["x"])
    assert rows["x"]["change"] == pytest.approx(a * T / (2.0 * np.pi), rel=0.3)
