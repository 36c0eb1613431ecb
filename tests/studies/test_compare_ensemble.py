"""Comparisons on ensembles: quantiles over the trajectories that reached the end, against the single comparisons."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from topcli.config.ensemble import EnsembleExperiment
from topcli.config.load import load
from topcli.studies.compare import compare_schemes
from topcli.studies.compare_ensemble import compare_ensemble

SEVEN = ["ensemble={random: {count: 7, seed: 3, gamma: sphere, omega: {sphere: 2}}}", "h=0.02", "N=1500"]
ENTRIES = ["hk", "hybrid:branch=sign", "hk:h=0.04"]


def ensemble(*overrides: str) -> EnsembleExperiment:
    found = load("kowalevski_generic_hk", overrides)
    assert isinstance(found, EnsembleExperiment)
    return found


def quantile(values: list[float], percent: int) -> float:
    """Smallest value with at least this part of the values below or at it."""
    return sorted(values)[-(-len(values) * percent // 100) - 1]


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    return compare_ensemble(ensemble(*SEVEN), ENTRIES)


@pytest.mark.slow
def test_quantiles_are_those_of_single_comparisons(figures: dict[str, Any]) -> None:
    many = ensemble(*SEVEN)
    single = [compare_schemes(many.member(i), ENTRIES).data["schemes"] for i in range(7)]
    assert [one["label"] for one in figures["schemes"]] == ENTRIES
    for at, found in enumerate(figures["schemes"]):
        assert (found["reached_end"], found["outcomes"], found["faults"]) == (7, {"completed": 7}, {})
        each = [schemes[at] for schemes in single]
        wanted = {
            "error.max": [one["max_error"] for one in each],
            "error.end": [one["end_error"] for one in each],
            "swing_spacing.first": [one["swing_spacing"] for one in each],
        }
        for i, row in enumerate(each[0]["invariants"]):
            wanted[f"deviation.{row['name']}"] = [one["invariants"][i]["max_deviation"] for one in each]
            wanted[f"drift.{row['name']}"] = [one["invariants"][i]["drift"] for one in each]
        assert set(found["measures"]) == {*wanted, "reversal"}
        for name, values in wanted.items():
            measured = found["measures"][name]
            assert measured["count"] == 7
            for label, percent in (("10 %", 10), ("median", 50), ("90 %", 90)):
                assert measured[label] == pytest.approx(quantile(values, percent), rel=1e-9, abs=1e-18), name


def test_the_step_of_an_entry_scales_its_errors(figures: dict[str, Any]) -> None:
    """An error of second order grows fourfold from h = 0.02 to h = 0.04, and HK alone is reversible to round-off."""
    hk, hybrid, coarse = (one["measures"] for one in figures["schemes"])
    assert coarse["error.max"]["median"] / hk["error.max"]["median"] == pytest.approx(4.0, rel=0.1)
    assert hk["reversal"]["90 %"] < 1e-14 < hybrid["reversal"]["median"]
    assert figures["rows"] == 751


def test_batches_do_not_change_the_figures(figures: dict[str, Any]) -> None:
    done = []
    found = compare_ensemble(ensemble(*SEVEN), ENTRIES, on_progress=lambda *at: done.append(at), most=2)
    for one, other in zip(found["schemes"], figures["schemes"], strict=True):
        assert one["measures"] == other["measures"]
    total = 7 * (1500 + 1500 + 750)
    assert done[-1] == (total, total)
    assert len(done) == 4 * 3


def test_the_tops_of_a_grid_are_those_of_its_members() -> None:
    grid = ["ensemble={grid: {top.B: [1.5, 2.5], omega1: [0.1, 0.2]}}", "initial.omega=[0, 1, 0]", "N=200", "h=0.02"]
    many = load("euler_hk", grid)
    assert isinstance(many, EnsembleExperiment)
    found = compare_ensemble(many, ["hk"])["schemes"][0]["measures"]["deviation.m_sq"]
    values = [compare_schemes(many.member(i), ["hk"]).data["schemes"][0]["invariants"][0] for i in range(4)]
    assert values[0]["name"] == "m_sq"
    assert found["median"] == pytest.approx(quantile([one["max_deviation"] for one in values], 50), rel=1e-12)


MIXED = ["ensemble={states: [{omega: [1, 0, 0]}, {omega: [0.5, 1, 0]}, {omega: [300, 200, 100]}]}", "h=0.05", "N=400"]


def test_failures_are_counted_and_left_out() -> None:
    found = compare_ensemble(ensemble(*MIXED), ["rk4", "hk"])["schemes"][0]
    whole = compare_ensemble(ensemble(MIXED[0].replace(", {omega: [300, 200, 100]}", ""), *MIXED[1:]), ["rk4"])
    assert found["reached_end"] == 2
    assert found["outcomes"] == {"completed": 2, "blew_up": 1}
    assert [one["trajectory"] for one in found["failures"]] == [2]
    assert found["measures"] == whole["schemes"][0]["measures"]


def test_the_command_counts_failures_and_says_what_the_lines_are(cli: Any) -> None:
    sets = [word for text in MIXED for word in ("--set", text)]
    said = cli("compare", "rk4", "hk:h=0.1", "--config", "kowalevski_generic_hk", *sets)
    assert said.code == 3
    title, header, *lines = said.out.splitlines()
    assert title.endswith(
        "t from 0 to 20, 3 trajectories; median, 10 % and 90 % quantiles of those that reached the end"
    )
    assert header.split() == ["rk4", "hk:h=0.1"]
    cells = {line.split("  ")[0]: line.split()[-2:] for line in lines if line[0] != " "}
    assert cells["h"] == ["0.05", "0.1"]
    assert cells["reached the end"][0] == "2"
    assert "error: rk4: of 3 trajectories 2 completed, 1 blew up" in said.err
    data = cli("compare", "rk4", "hk:h=0.1", "--config", "kowalevski_generic_hk", *sets, "--json").json()
    measured = data["schemes"][0]["measures"]
    assert data["quantiles"] == {"10 %": 0.1, "median": 0.5, "90 %": 0.9}
    assert float(cells["max error, median"][0]) == pytest.approx(measured["error.max"]["median"], rel=0.05)
    assert {"deviation.energy", "drift.energy", "reversal", "swing_spacing.first"} <= measured.keys()


@pytest.mark.slow
def test_every_line_of_the_table_shows_its_measure(cli: Any) -> None:
    arguments = ("compare", "hk", "rk4", "--config", "euler_ensemble", "--set", "N=60", "--set", "h=0.1")
    lines = iter(cli(*arguments).out.splitlines()[2:])
    schemes = cli(*arguments, "--json").json()["schemes"]
    assert next(lines).split() == ["reached", "the", "end", "243", "243"]
    symbols = {row["name"]: row["symbol"] for one in schemes for row in one["invariants"]}
    labels = {"error.max": "max error", "error.end": "error at the end"}
    for name, symbol in symbols.items():
        labels |= {f"deviation.{name}": f"{symbol} max deviation", f"drift.{name}": f"{symbol} drift per unit time"}
    labels |= {"reversal": "reversal defect at h = 0.1", "swing_spacing.first": "spacing of omega2 minima"}
    for name, label in labels.items():
        each = [one["measures"].get(name) for one in schemes]
        for quantile_name in ("median", "10 %", "90 %"):
            line = next(lines)
            start = f"{label}, median " if quantile_name == "median" else f"  {quantile_name} "
            assert line.startswith(start), (line, start)
            for cell, one in zip(line.split()[-2:], each, strict=True):
                if one is None or one[quantile_name] is None:
                    assert cell == "–"
                else:
                    assert float(cell) == pytest.approx(one[quantile_name], rel=0.06, abs=1e-300)
        if any(one and one["count"] < 243 for one in each):
            line = next(lines)
            assert line.startswith("  trajectories with a value ")
            assert line.split()[-2:] == ["–" if one is None else str(one["count"]) for one in each]
    assert next(lines).startswith("ns per step, all threads ")
    assert next(lines).startswith("Errors are norms ")
    assert next(lines, None) is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("hk", "--plot"), "error: --plot draws one trajectory, and kowalevski_ensemble is an ensemble of 1000"),
        (("hk", "hk:h=0.03"), "error: hk:h=0.03: T/h = 100/0.03"),
        (("hk", "hkk"), "unknown scheme 'hkk'; did you mean 'hk'?"),
        (("hk", "--set", "scheme.brunch=sign"), "--set scheme.brunch: none of the schemes has this option"),
    ],
)
def test_mistakes_are_refused_before_anything_runs(cli: Any, arguments: tuple[str, ...], message: str) -> None:
    said = cli("compare", *arguments, "--config", "kowalevski_ensemble")
    assert (said.code, said.out) == (2, "")
    assert message in said.err


def test_a_value_that_is_missing_is_explained(cli: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reference that cannot be computed leaves the other measures, and the other trajectories, as they are."""
    from topcli.errors import RunError
    from topcli.runs.references import SharedReferences

    original = SharedReferences.states

    def fails(self: Any, top: Any, kind: str, y0: np.ndarray, h: float, n: np.ndarray) -> np.ndarray:
        if y0[0] == 0.5:
            raise RunError("the motion cannot be followed")
        return original(self, top, kind, y0, h, n)

    monkeypatch.setattr(SharedReferences, "states", fails)
    (scheme,) = compare_ensemble(ensemble(MIXED[0], "N=40"), ["hk"], most=1)["schemes"]
    assert scheme["faults"]["error.max"] == {"count": 1, "trajectory": 1, "reason": "the motion cannot be followed"}
    said = cli(
        "compare", "hk", "--config", "kowalevski_generic_hk", *(w for s in (MIXED[0], "N=40") for w in ("--set", s))
    )
    assert "warning: hk: error.max: no value for 1 of 3 trajectories; trajectory 1: the motion cannot" in said.err
    assert "  trajectories with a value" in said.out
