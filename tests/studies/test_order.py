"""``topcli order``: schemes and scenes chosen, errors that are those of plain runs, orders, the stored study."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from conftest import GEN
from topcli.analysis.reference import reference_states
from topcli.engine.loop import Run
from topcli.errors import UsageError
from topcli.schemes.registry import find_scheme
from topcli.studies.order import DEFAULT, ladders, order_source, order_study
from topcli.tops.kowalevski import Kowalevski


def names(what: Any) -> list[str]:
    return [scheme.name for scheme in what.schemes]


def test_the_default_is_the_generic_motion_under_six_schemes() -> None:
    what = ladders(())
    assert names(what) == list(DEFAULT)
    assert what.problem.experiment.y0 == pytest.approx(GEN)
    assert (what.problem.duration, what.left_out, what.sizes) == (10.0, (), ())


@pytest.mark.parametrize(
    ("schemes", "form"),
    [
        (["hk"], "kowalevski"),
        (["bs"], "lagrange/inertial"),
        (["HK", "bohlin-a"], "kowalevski"),
        (["hk", "bs"], "euler"),
        (["hk+kahan-li8"], "kowalevski"),
    ],
)
def test_the_scene_is_that_of_a_top_which_all_schemes_fit(schemes: list[str], form: str) -> None:
    what = ladders(schemes)
    assert what.problem.top.form == form
    assert names(what) == [name.lower() for name in schemes]


@pytest.mark.slow
def test_top_and_config_choose_the_scene_and_the_duration() -> None:
    euler = ladders((), top="EULER")
    assert euler.problem.top.form == "euler"
    assert {"hk", "rk4", "bs"} <= set(names(euler))
    assert not {"dop853", "taylor", "exact"} & set(names(euler))
    own = ladders(["hk"], config="kowalevski_hk", sets=["N=100", "h=0.25"])
    assert own.problem.duration == 25.0
    assert ladders(["hk"], config="kowalevski_hk", duration=3.0).problem.duration == 3.0
    assert ladders(["hk"], top="heavy").problem.top.form == "heavy"


@pytest.mark.parametrize(
    ("schemes", "options", "message"),
    [
        (["hkk"], {}, "unknown scheme 'hkk'; did you mean 'hk'"),
        (["bs"], {"top": "kowalevski"}, "scheme 'bs' does not fit top 'kowalevski'"),
        (["bohlin-a", "bs"], {}, "does not fit top 'kowalevski'"),
        (["hk"], {"top": "eulr"}, "--top: no scene for the top 'eulr'; did you mean 'euler'"),
        (["hk"], {"top": "euler", "config": "euler_hk"}, "--top and --config both choose the scene"),
        (["dop853"], {}, "no scheme with an order to observe: dop853: its steps follow a tolerance, not h"),
        (["exact"], {"top": "euler"}, "exact: is a closed form"),
        (["hk", "hk"], {}, "scheme 'hk' is named twice"),
        (["hk"], {"sizes": [0.0]}, "--h 0: must be positive and at most 0.5"),
        (["hk"], {"sizes": [0.6]}, "--h 0.6: must be positive and at most 0.5"),
        (["hk"], {"sizes": [math.nan]}, "--h nan: must be positive"),
        (["hk"], {"duration": -1.0}, "the duration -1 must be positive"),
        (["hk"], {"config": "kowalevski_hk", "sets": ["h=-0.1"]}, "must be positive; give another with --duration"),
    ],
)
def test_wrong_choices_are_named(schemes: list[str], options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        ladders(schemes, **options)


def test_a_scheme_without_an_order_is_left_out_beside_others() -> None:
    what = ladders(["hk", "dop853"])
    assert names(what) == ["hk"]
    assert what.left_out == (("dop853", "its steps follow a tolerance, not h"),)


def test_given_sizes_become_steps_that_divide_the_interval() -> None:
    what = ladders(["hk"], sizes=[0.05, 0.03, 0.5, 0.0501])
    assert [rung.value for rung in what.rungs] == [0.5, 0.05, 0.5 / 17]
    assert [rung.steps for rung in what.rungs] == [1, 10, 17]


def test_errors_are_those_of_plain_runs() -> None:
    what = ladders(["hk", "rk4"], sizes=[0.1, 0.05, 0.025], duration=4.0)
    study = order_study(what)
    top = Kowalevski()
    times = np.linspace(0.0, 4.0, 21)
    exact = reference_states(top, what.problem.experiment.y0, times)
    for row, order in zip(study["schemes"], (2, 4), strict=True):
        scheme = find_scheme(row["scheme"], "kowalevski")
        assert [one["h"] for one in row["points"]] == [0.1, 0.05, 0.025]
        for one in row["points"]:
            stride = round(0.2 / one["h"])
            run = Run(
                top, scheme.build(top, scheme.options()), what.problem.experiment.y0, 0.2 / stride, 20 * stride, stride
            )
            states = np.vstack([chunk.states for chunk in run])
            off = np.sqrt(((states - exact) ** 2).sum(axis=1))
            assert one["error"] == pytest.approx(off.max(), rel=1e-9)
            assert one["end_error"] == pytest.approx(off[-1], rel=1e-9)
        logs = np.log([[one["h"], one["error"]] for one in row["points"]])
        slope = np.polyfit(logs[:, 0], logs[:, 1], 1)[0]
        assert row["order"] == pytest.approx(slope, rel=1e-12)
        assert row["order"] == pytest.approx(order, abs=0.1)
        assert row["declared_order"] == order


@pytest.mark.slow
def test_ladders_reach_order_and_round_off() -> None:
    """Observed 4.00, 5.99 and 7.95 with plateaus of 3e-14 to 2e-13."""
    study = order_study(ladders(["rk4", "hk+kahan-li6", "hk+kahan-li8"], steps=100_000))
    for row, order in zip(study["schemes"], (4, 6, 8), strict=True):
        assert row["order"] == pytest.approx(order, abs=0.1)
        assert 1e-15 < row["plateau"] < 1e-12
        assert row["fitted"][0] > row["onset"]
        assert row["ended"].startswith("round-off")
        assert max(one["h"] for one in row["points"]) == 0.5


def test_a_ladder_ends_at_the_number_of_steps() -> None:
    (row,) = order_study(ladders(["hk"], steps=650))["schemes"]
    assert [one["h"] for one in row["points"]] == [0.5 / 2**k for k in range(6)]
    assert (row["plateau"], row["onset"]) == (None, None)


def test_the_source_names_everything_that_a_study_depends_on() -> None:
    first = ladders(["hk", "rk4"])
    others = [
        ladders(["hk"]),
        ladders(["rk4", "hk"]),
        ladders(["hk", "rk4"], duration=9.0),
        ladders(["hk", "rk4"], steps=100),
        ladders(["hk", "rk4"], sizes=[0.1]),
        ladders(["hk", "rk4"], config="kowalevski_hk", duration=10.0),
        dataclasses.replace(first, problem=dataclasses.replace(first.problem, intervals=10)),
    ]
    sources = [order_source(what) for what in (first, *others)]
    assert len(set(sources)) == len(sources)
    assert order_source(ladders(["hk", "rk4"])) == sources[0]


def fake_study(*arguments: object) -> dict[str, Any]:
    points = [{"h": 0.1 / 2**k, "error": 0.01 / 4**k, "end_error": 0.1} for k in range(4)]
    row = {"scheme": "hk", "declared_order": 2, "order": 2.0, "fitted": [0.0125, 0.025, 0.05], "plateau": None}
    row |= {"verdict": "as declared", "why": ""}
    row |= {"onset": None, "ended": "", "broken": None, "failed": [], "points": points}
    return {"schema_version": 1, "name": "n", "top": "t", "duration": 1.0, "schemes": [row], "left_out": []}


@pytest.mark.slow
def test_only_the_default_study_is_stored(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.studies.order.order_study", fake_study)
    for arguments in (("hk",), ("--duration", "5"), ("--h", "0.1"), ("--steps", "100"), ("--top", "kowalevski")):
        assert cli("order", *arguments).code == 0
        assert not Path("results").exists()
    said = cli("order")
    assert said.err == "wrote results/order/order.json\n"
    stored = json.loads(Path("results/order/order.json").read_text())
    assert stored["schemes"] == fake_study()["schemes"]
    assert stored["source"] == order_source(ladders(()))
    Path("results/order/order.json").write_text("{")
    damaged = cli("plot", "order")
    assert damaged.code == 1
    assert "order.json: cannot be read" in damaged.err
    assert "run topcli order again" in damaged.err


def test_failures_and_changed_sizes_are_reported(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    study = fake_study()
    monkeypatch.setattr("topcli.studies.order.order_study", lambda *arguments: study)
    said = cli("order", "hk", "--h", "0.03", "--h", "0.05")
    assert said.err == "h = 0.03 becomes 0.0294118, which divides the time between comparisons\n"
    study["schemes"][0]["failed"] = [{"h": 0.2, "reason": "fails at step 3 of 50"}]
    study["schemes"][0]["points"][0]["error"] = None
    study["left_out"] = [{"scheme": "dop853", "reason": "has no h"}]
    said = cli("order", "hk")
    assert said.code == 0
    assert said.err.splitlines() == [
        "dop853 is left out: has no h",
        "hk: 1 of its step sizes gave no result; h = 0.2 fails at step 3 of 50",
    ]
    assert said.out.splitlines()[-4].split() == ["0.1", "nan"]
    study["schemes"][0]["points"] = []
    assert cli("order", "hk").code == 1
    study["schemes"][0]["broken"] = "cannot be compiled"
    said = cli("order", "hk")
    assert (said.code, said.err.splitlines()[-1]) == (2, "error: hk: cannot be compiled")


@pytest.mark.slow
def test_the_picture_is_drawn_beside_the_table(cli: Callable[..., Any]) -> None:
    command = ("order", "hk", "rk4", "--top", "euler", "--steps", "3000", "--plot", "--json")
    found = cli(*command).json()
    assert found["files"] == [f"results/figures/order_euler_hk.{end}" for end in ("png", "pdf", "parquet")]
    pages = [Path(file).read_bytes() for file in found["files"]]
    assert [page[:4] for page in pages] == [b"\x89PNG", b"%PDF", b"PAR1"]
    drawn = pq.read_table(found["files"][2])
    for row in found["schemes"]:
        for kind, key in (("x", "h"), ("y", "error")):
            values = drawn.column(f"{row['scheme']}:{kind}").to_numpy()
            assert values[np.isfinite(values)].tolist() == [one[key] for one in row["points"]]
