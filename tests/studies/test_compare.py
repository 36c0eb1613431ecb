"""Comparisons: entries with options and steps of their own, errors against an independent reference."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import topcli
from cases import table_of
from conftest import Said
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.errors import UsageError
from topcli.studies.entries import common_strides, entries_of
from topcli.tops.kowalevski import Kowalevski

Cli = Callable[..., Said]
SCENE = "kowalevski_generic_hk"
MIXED = ("hk", "hk:h=0.02", "hybrid:branch=sign", "hk+kahan-li6:h=0.04")
FIVE = ("hk", "bohlin-a", "bohlin-b", "bohlin-c", "hybrid")
FREE_RUN = {
    "name": "free",
    "top": {"kind": "euler", "A": 3.0, "B": 2.0, "C": 1.0},
    "initial": {"omega": [0.3, 0.4, 1.5]},
    "scheme": "hk",
    "h": 0.1,
    "N": 300,
}


def test_schemes_of_the_paper_swing_drift_and_reverse_as_measured() -> None:
    """Half the period is sqrt 2 ln(8 sqrt 7/eps) to leading order in eps = gamma3(0).

    The paper calls the hybrid reversible: it misses by O(h⁴). Bohlin's schemes miss by O(h²), HK not at all.
    """
    paper = topcli.compare(*FIVE)
    spacing = float(next(note for note in paper.notes if "spacing" in note).split()[-1][:-1])
    assert spacing / 2 == pytest.approx(math.sqrt(2) * math.log(8 * math.sqrt(7) / 1e-3), abs=2e-3)
    table = paper.table
    orders = {scheme: table["its_order"][scheme] for scheme in FIVE}
    assert np.isnan(orders["hk"])
    assert table["reversal_defect"]["hk"] < 1e-15
    assert orders["hybrid"] == pytest.approx(4.0, abs=0.1)
    assert [orders[scheme] for scheme in FIVE[1:4]] == pytest.approx([2.0] * 3, abs=0.1)
    verdicts = {(row["scheme"], row["invariant"]): row["verdict"] for row in paper.tables[3].rows}
    assert {verdicts["hk", symbol] for symbol in ("γ²", "2l", "E", "k²")} == {"no drift seen"}
    assert {verdicts[scheme, symbol] for scheme in FIVE[1:] for symbol in ("γ²", "k²")} == {"exact"}
    assert {verdicts[scheme, symbol] for scheme in ("bohlin-a", "bohlin-c") for symbol in ("E", "2l")} == {"drifting"}
    assert paper.tables[2].rows[1]["γ²"] == "exact"


@pytest.mark.slow
def test_errors_of_mixed_steps_are_those_of_single_runs() -> None:
    """Each entry is compared with a Taylor series at t = 0, 0.04, ..., 20."""
    report = topcli.compare(*MIXED, config=SCENE, overrides=["h=0.01", "N=2000"])
    t = report.columns["t"]
    assert len(t) == 501
    np.testing.assert_array_equal(report.columns["swing:hk"], topcli.simulate(SCENE, h=0.01, N=2000)["gamma1"][::4])
    np.testing.assert_allclose(report.columns["swing:reference"], report.columns["swing:hk"], atol=0.1)
    assert [row["scheme"] for row in report.tables[0].rows] == list(MIXED)
    for row in report.tables[0].rows:
        name, _, _ = row["scheme"].partition(":")
        options = {"branch": "sign"} if name == "hybrid" else {}
        run = topcli.simulate(SCENE, scheme={"name": name, **options}, h=row["h"], N=row["N"])
        states = run.states[:: row["N"] // 500]
        errors = np.linalg.norm(states - reference_states(Kowalevski(), run.states[0], t), axis=1)
        assert row["max_error"] == pytest.approx(errors.max(), rel=1e-6)
        assert row["final_error"] == pytest.approx(errors[-1], rel=1e-6)
        np.testing.assert_allclose(report.columns[f"error:{row['scheme']}"], errors, rtol=1e-5, atol=1e-11)
        deviations = {each["invariant"]: each for each in report.tables[3].rows if each["scheme"] == row["scheme"]}
        assert deviations["k²"]["max_deviation"] == np.abs(run["k_sq"] - run["k_sq"][0])[:: row["N"] // 500].max()


@pytest.mark.parametrize(
    ("texts", "every", "strides"),
    table_of("""
hk hybrid                7     [7, 7]
hk hk:h=0.02             1     [2, 1]
hk hk:h=0.02 hk:h=0.04   1     [4, 2, 1]
hk hk:h=0.02             5     [8, 4]
hk hk:h=0.05             1000  [1000, 200]
hk hk:h=0.010666666666666666   1  [16, 15]
"""),
)
def test_rows_are_recorded_at_common_times(texts: str, every: int, strides: list[int]) -> None:
    base = load_experiment(SCENE, ["h=0.01", "N=2000", f"output.every={every}"])
    assert common_strides(base, list(entries_of(base, texts.split()).values())) == strides


@pytest.mark.parametrize(
    ("entries", "message"),
    table_of("""
""                     name at least one scheme
hk:h=0.03              "hk:h=0.03: --set T=20.0: T: T/h = 20/0.03 = 666.666667 is not a whole number of steps"
hk:h=-0.02             "hk:h=-0.02: --set T=20.0: T: T/h = 20/-0.02 = -1000 steps"
hk:h=0                 hk:h=0: --set h=0
hybrid:brunch=sign     hybrid:brunch=sign: --set scheme.brunch=sign: scheme.brunch: unknown key
hybrid:branch=sing     "hybrid:branch=sing: --set scheme.branch=sing: scheme.branch: must be 'nearest' or 'sign'"
hk hk:h=1e-2           hk:h=1e-2: computes the same as hk; keep one of them
hk:h=0.01 hk:h=0.0125 hk:h=0.016   the step sizes share only 50 times after the start
"""),
)
def test_errors_name_the_entry(entries: str, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        topcli.compare(*entries.split(), config=SCENE, overrides=["h=0.01", "N=2000"])
    assert str(refused.value).startswith(message)


def test_a_run_that_ends_early_is_compared_as_far_as_it_went(cli: Cli) -> None:
    sets = ["initial.omega=[0.01, 0, 3]", "initial.gamma=[1e-8, 0, -auto]", "h=0.1", "N=500"]
    report = topcli.compare("bohlin-b", "hk", overrides=sets)
    broken, other = report.tables[0].rows
    assert (broken["outcome"], other["outcome"], report.code) == ("blew_up", "completed", 1)
    assert broken["final_error"] is None
    assert np.isnan(report.columns["error:bohlin-b"][-1])
    assert report.errors[0].startswith("bohlin-b: blew up at step")


@pytest.mark.parametrize("kind", ["taylor", "exact"])
def test_errors_are_against_the_reference_that_is_asked_for(kind: Any) -> None:
    """The scheme ``exact`` differs from the series, and not from itself, so that it shows which reference was used."""
    report = topcli.compare("hk", "exact", config=FREE_RUN, reference=kind)
    itself = report.table["max_error"]["exact"]
    assert (itself <= 2.0**-53) == (kind == "exact")  # row 0 is the initial state itself
    assert itself < 1e-13
    assert 50.0 < report.table["ns_per_step"]["exact"] < 1e5  # no state costs 4 ns
    method = {"taylor": "Taylor series in double-double arithmetic", "exact": "closed form (scheme exact)"}[kind]
    assert report.notes[-1].startswith(f"Errors are norms of the difference of states from the reference, a {method}.")
