"""Crossings of Poincaré sections: where they are, which they are, and how they are recorded."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

import topcli
from topcli.config.load import load, load_experiment
from topcli.contracts import Stepper, same_state
from topcli.errors import ConfigError, UsageError
from topcli.runs.run import run_experiment
from topcli.store import identity
from topcli.store.identity import identity_of

KOWALEVSKI: dict[str, Any] = {
    "top": "kowalevski",
    "initial": {"omega": [0.3, 0.2, 1.1], "gamma": [0.6, 0.0, 0.8]},
    "scheme": "hk",
    "h": 0.05,
    "N": 1000,
}
EULER: dict[str, Any] = {
    "top": {"kind": "euler", "A": 3.0, "B": 2.0, "C": 1.0},
    "initial": {"omega": [0.7, 0.0, 1.3]},
    "h": 0.05,
    "N": 1000,
}
LAGRANGE: dict[str, Any] = {
    "top": "lagrange",
    "initial": {"m": [0.3, -0.5, 1.2], "a": [0.6, 0.0, 0.8]},
    "h": 0.05,
    "N": 1000,
}


def section(**changes: Any) -> dict[str, Any]:
    return {"section": {"component": "gamma2", **changes}}


def half_period(moments: tuple[float, float, float], omega: tuple[float, float, float]) -> float:
    """Time between zeros of omega of the middle axis, from Landau and Lifshitz, Mechanics, section 37."""
    i1, i2, i3 = sorted(moments)
    energy = sum(i * w * w for i, w in zip(moments, omega, strict=True))  # twice the energy
    square = sum((i * w) ** 2 for i, w in zip(moments, omega, strict=True))
    if square < energy * i2:
        i1, i3 = i3, i1
    rate = math.sqrt((i3 - i2) * (square - energy * i1) / (i1 * i2 * i3))
    m = (i2 - i1) * (energy * i3 - square) / ((i3 - i2) * (square - energy * i1))
    a, b = 1.0, math.sqrt(1.0 - m)
    for _ in range(8):
        a, b = (a + b) / 2.0, math.sqrt(a * b)
    return math.pi / a / rate


@pytest.mark.parametrize("scheme", ["exact", "taylor"])
@pytest.mark.parametrize(
    ("direction", "which"), [("both", slice(0, None)), ("up", slice(0, None, 2)), ("down", slice(1, None, 2))]
)
def test_crossings_of_a_free_body_have_the_times_of_its_period(scheme: str, direction: str, which: slice) -> None:
    """From omega2 = 0, which is not a crossing, omega2 falls: (C - A) omega3 omega1 < 0."""
    expected = half_period((3.0, 2.0, 1.0), (0.7, 0.0, 1.3)) * np.arange(1, 100)
    expected = expected[expected < 50.0][which]
    found = topcli.simulate(EULER, scheme=scheme, section={"component": "omega2", "direction": direction})
    assert len(found) == len(expected)
    assert abs(found.t - expected).max() < 1e-13 * 50.0
    assert abs(found["omega2"]).max() < 1e-14


@pytest.mark.parametrize("config", [EULER, LAGRANGE, KOWALEVSKI], ids=["euler", "lagrange", "kowalevski"])
def test_taylor_and_exact_cross_at_the_same_places(config: dict[str, Any]) -> None:
    formula = {"omega": "omega1*omega2", "a": "a1 + a2 - 0.1", "gamma": "gamma1*gamma2"}[[*config["initial"]][-1]]
    for h in (0.05, -0.05):
        found = [
            topcli.simulate(config, scheme=scheme, h=h, section={"quantity": formula, "direction": "both"})
            for scheme in ("exact", "taylor")
        ]
        assert len(found[0]) == len(found[1]) > 5
        assert abs(found[0].t - found[1].t).max() < 2e-12
        assert abs(found[0].t - found[1].t)[:5].max() < 1e-13
        assert abs(found[0].states - found[1].states)[:5].max() < 1e-13


def parts_of_steps(config: dict[str, Any], before: NDArray[Any], component: int) -> tuple[float, NDArray[Any]]:
    """Fraction of a step and state with a zero of a component, by bisection with the step as plain Python."""
    experiment = load_experiment({"name": "x", **config})
    method, p = experiment.method(), tuple(experiment.top.constants())
    assert isinstance(method, Stepper)
    p = method.parameters(experiment.top)

    def state(theta: float) -> NDArray[Any]:
        h = theta * experiment.h
        work = (method.enter or same_state)(tuple(before.tolist()), h, p)
        return np.array((method.leave or same_state)(method.step(work, h, p), h, p))

    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if state(middle)[component] < 0.0 else (low, middle)
    return high, state(high)


@pytest.mark.parametrize("scheme", ["hk", "rk4", "hk+suzuki4"])
def test_maps_cross_where_a_shorter_step_of_their_own_reaches_the_section(scheme: str) -> None:
    rows = topcli.simulate(KOWALEVSKI, scheme=scheme)
    found = topcli.simulate(KOWALEVSKI, scheme=scheme, **section())
    value = rows["gamma2"]
    begins = np.flatnonzero((value[:-1] < 0.0) & (value[1:] >= 0.0))
    assert found["n"].tolist() == begins.tolist()
    assert len(begins) > 5
    for k, n in enumerate(begins.tolist()):
        theta, state = parts_of_steps({**KOWALEVSKI, "scheme": scheme}, rows.states[n], 4)
        assert found.t[k] == pytest.approx((n + theta) * 0.05, abs=1e-13)
        assert abs(found.states[k] - state).max() < 1e-14


def test_a_pole_or_a_jump_is_no_crossing() -> None:
    for formula in ("1/gamma2", "gamma2/abs(gamma2)"):
        assert len(topcli.simulate(KOWALEVSKI, section={"quantity": formula, "direction": "both"})) == 0


RUN = {"name": "crossings", **KOWALEVSKI, "h": 0.1, "N": 300_000, **section(direction="both")}


def figures(values: NDArray[Any]) -> dict[str, float]:
    """Figures of the column of a quantity; nan without rows."""
    if not len(values):
        return dict.fromkeys(("first", "last", "min", "max", "mean"), math.nan)
    return {
        "first": values[0],
        "last": values[-1],
        "min": values.min(),
        "max": values.max(),
        "mean": math.fsum(values) / len(values),
    }


def test_a_run_records_crossings_alone(tmp_path: Path) -> None:
    observed = {**RUN, "output": {"quantities": {"q": "t*omega1", "g": "gamma2"}}}
    whole = run_experiment(load(observed), tmp_path / "whole")
    rows = pd.read_parquet(whole.stored.series)
    assert list(rows)[:3] == ["n", "t", "omega1"]
    assert abs(rows["gamma2"]).max() < 1e-15
    assert ((rows["t"] > rows["n"] * 0.1) & (rows["t"] <= (rows["n"] + 1) * 0.1 * (1 + 1e-15))).all()
    memory = topcli.simulate(RUN)
    assert np.array_equal(rows["t"], memory.t)
    assert np.array_equal(rows[list(memory.top.components)], memory.states)
    assert whole.report["section"] == {"crossings": len(rows), "never_crossed": 0}
    assert whole.report["message"].endswith(f"; {len(rows)} crossings of the section gamma2 = 0")
    for row in whole.report["quantities"]:
        assert {name: row[name] for name in ("first", "last", "min", "max", "mean")} == pytest.approx(
            figures(rows[row["name"]].to_numpy()), rel=1e-12, abs=1e-25
        )


def test_an_ensemble_records_the_crossings_of_each_trajectory(tmp_path: Path) -> None:
    ensemble = {"random": {"count": 70, "seed": 3, "gamma": "sphere"}}
    both = {
        **RUN,
        "N": 2000,
        "section": {"component": "gamma3", "value": 0.99},
        "output": {"quantities": {"q": "t*omega1"}},
    }
    result = run_experiment(load({**both, "ensemble": ensemble}), tmp_path)
    rows = pd.read_parquet(result.stored.series)
    starts = pd.read_parquet(result.stored.folder / "trajectories.parquet")
    never = 0
    for i in range(70):
        state = starts.loc[i, [name for name in starts if name.startswith("initial_")]].tolist()
        single = topcli.simulate({**both, "initial": {"omega": state[:3], "gamma": state[3:]}})
        own = rows[rows["trajectory"] == i]
        assert np.array_equal(own["t"], single.t)
        assert np.array_equal(own[list(single.top.components)], single.states)
        never += not len(own)
        for name, value in figures(single["q"]).items():
            assert starts.loc[i, f"{name}.q"] == pytest.approx(value, rel=1e-12, nan_ok=True)
    assert 0 < never < 70
    crossed = starts[starts["n"].notna() & starts["first.q"].notna()]
    together = result.report["quantities"][0]
    assert (together["min"], together["max"]) == (rows["q"].min(), rows["q"].max())
    for name in ("first", "last", "mean"):
        assert together[name] == pytest.approx(crossed[f"{name}.q"].mean(), rel=1e-12)
    assert result.report["section"] == {"crossings": len(rows), "never_crossed": never}
    assert result.report["message"].endswith(f"; {never} of 70 trajectories have not crossed it")


def test_a_section_that_is_never_crossed_is_reported(tmp_path: Path) -> None:
    never = {**RUN, "N": 100, "section": {"component": "gamma2", "value": 3.0}, "output": {"quantities": {"q": "t"}}}
    result = run_experiment(load(never), tmp_path)
    assert result.report["message"] == "completed 100 steps (t = 10); no crossing of the section gamma2 = 3 (up)"
    assert len(pd.read_parquet(result.stored.series)) == 0
    assert result.report["quantities"] == [{"name": "q", "formula": "t", **dict.fromkeys(figures(np.empty(0)))}]
    assert len(topcli.simulate(never)) == 0
    assert len(topcli.simulate(never).invariants()) == 0


def test_what_records_no_crossings_refuses_a_section(tmp_path: Path) -> None:
    drawn = {"random": {"count": 3, "gamma": "sphere"}}
    with pytest.raises(ConfigError, match=r"ensemble\.store: a section records"):
        load({**RUN, "ensemble": {**drawn, "store": "final"}})
    with pytest.raises(UsageError, match="topcli run"):
        topcli.simulate(RUN, ensemble=drawn)
    with pytest.raises(ConfigError, match=r"base\.section: cannot be in base"):
        topcli.sweep({"base": {k: v for k, v in RUN.items() if k != "name"}, "grid": {"h": [0.1]}})


def test_the_code_that_finds_crossings_belongs_to_the_identity_of_a_section_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def codes() -> list[str]:
        identity._module.cache_clear()
        identity.source_digest.cache_clear()
        scene = "kowalevski_generic_hk"
        return [identity_of(load(scene, more)).code for more in ([], ["section.component=gamma2"])]

    before, read = codes(), Path.read_text

    def edited(path: Path, **options: Any) -> str:
        return read(path, **options) + "# edited\n" * (path.name == "crossings.py")

    monkeypatch.setattr(Path, "read_text", edited)
    after = codes()
    monkeypatch.undo()
    assert (after[0] == before[0], after[1] == before[1]) == (True, False)
    assert codes() == before
