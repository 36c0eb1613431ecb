"""Every column of a report's table is the stored field that it is named after, on data where all fields differ."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import topcli
from shown import distinct, named_differently
from stored_results import BASE
from topcli.show.report import Report, StudyReport
from topcli.studies.compare import COMPARE
from topcli.studies.order import ORDER
from topcli.studies.stress.study import STRESS
from topcli.studies.study import Result

CONFIG = {**BASE, "name": "one", "scheme": "hk"}


def values_of(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table with its index, as plain data; missing numbers are None."""
    rows = table.reset_index().to_dict("records")
    plain = [
        {key: value.item() if isinstance(value, np.generic) else value for key, value in row.items()} for row in rows
    ]
    return [{k: None if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()} for row in plain]


def point(h: float, error: float | None, end: float) -> dict[str, Any]:
    return {"h": h, "error": error, "end_error": end}


ORDERS = {
    "name": "n",
    "top": "t",
    "config": None,
    "duration": 7.0,
    "schemes": [
        {
            "scheme": "hk", "declared_order": 2, "order": 1.98, "fitted": [0.1, 0.2], "plateau": 3e-13, "onset": 0.0123,
            "verdict": "as declared", "ended": "why hk", "broken": None, "failed": [],
            "points": [point(0.4, 1e-2, 7.0), point(0.2, 2e-5, 8.0), point(0.1, 3e-3, 9.0), point(0.05, None, 6.0)],
        },
        {
            "scheme": "rk4", "declared_order": 4, "order": None, "fitted": [], "plateau": None, "onset": None,
            "verdict": None, "ended": "why rk4", "broken": "cannot be compiled", "failed": [], "points": [],
        },
        {
            "scheme": "bs", "declared_order": 1, "order": 1.02, "fitted": [0.3], "plateau": 5e-12, "onset": 0.5,
            "verdict": "undecided", "ended": "why bs", "broken": None, "failed": [],
            "points": [point(0.4, None, 1.0), point(0.2, 4e-3, 2.0), point(0.1, 6e-3, 3.0)],
        },
    ],
    "left_out": [],
}  # fmt: skip
"""The smallest error is neither the first nor the last; one scheme has no point."""


def test_orders_have_their_own_errors_and_steps() -> None:
    report = StudyReport(ORDER, Result(ORDERS))
    best = {"hk": (2e-5, 0.2), "rk4": (None, None), "bs": (4e-3, 0.2)}
    fields = ("declared_order", "order", "verdict", "plateau", "onset", "ended", "broken")
    assert values_of(report.table) == [
        {"scheme": row["scheme"], **{key: row[key] for key in fields}}
        | dict(zip(("smallest_error", "at_h"), best[row["scheme"]], strict=True))
        for row in ORDERS["schemes"]
    ]
    assert report.errors.index.tolist() == [0.4, 0.2, 0.1, 0.05]
    np.testing.assert_array_equal(report.errors["hk"], [1e-2, 2e-5, 3e-3, math.nan])
    np.testing.assert_array_equal(report.errors["bs"], [math.nan, 4e-3, 6e-3, math.nan])
    assert report.errors["rk4"].isna().all()


def test_a_comparison_has_the_figures_of_each_entry() -> None:
    found = topcli.compare("hk", "hk:h=0.02", "exact", config=CONFIG)
    figures = named_differently(distinct(found.figures, 3, keep=("power", "N")), ("verdict", "model"))
    rows = values_of(StudyReport(COMPARE, Result(figures)).table)
    for row, one in zip(rows, figures["schemes"], strict=True):
        assert row.pop("entry") == one["label"]
        assert (row.pop("reversal_defect"), row.pop("reversal_order")) == (
            one["reversal"]["defect"],
            one["reversal"]["order"],
        )
        for invariant in (*one["invariants"], *one["modified"]):
            for key in ("max_deviation", "drift", "drift_error", "model", "verdict"):
                assert row.pop(f"{invariant['name']}_{key}", invariant[key]) == invariant[key]
        assert set(row) == {
            "scheme", "h", "N", "outcome", "message", "max_error", "end_error", "swing_spacing", "nanoseconds_per_step"
        }  # fmt: skip
        assert row == {key: one[key] for key in row}


def test_trials_have_their_own_fields() -> None:
    keys = ("scheme", "top", "case", "outcome", "step", "why", "verdict", "limit")
    trials = [
        dict(zip(keys, (f"{key}{i}" for key in keys), strict=True)) | {"step": i, "seconds": 0.5 + i} for i in (1, 2)
    ]
    table = StudyReport(STRESS, Result({"trials": trials})).table
    assert set(table.columns) == {*keys, "seconds"}
    assert values_of(table) == [
        {"index": i, **{key: one[key] for key in table.columns}} for i, one in enumerate(trials)
    ]


@pytest.mark.parametrize("verdict", ["ok", "limit", "unexplained", "outlived limit"])
def test_unexplained_are_breaks_without_a_limit_and_limits_without_a_break(verdict: str) -> None:
    trial = dict.fromkeys(("scheme", "top", "case", "outcome", "step", "why", "limit", "seconds")) | {
        "verdict": verdict
    }
    assert len(StudyReport(STRESS, Result({"trials": [trial]})).unexplained) == (
        verdict in ("unexplained", "outlived limit")
    )


def test_a_table_of_an_ensemble_has_every_quantile(tmp_path: Path) -> None:
    config = {**CONFIG, "name": "many", "N": 50, "ensemble": {"random": {"count": 9, "gamma": "sphere"}}}
    found = topcli.run(config, tmp_path)
    stored = json.loads((found.folder / "report.json").read_text())["invariants"]
    result = replace(found.result, report={**found.result.report, "invariants": distinct(stored, 4)})
    rows = values_of(replace(found, result=result).table)
    for row, one in zip(rows, result.report["invariants"], strict=True):
        quantiles = {key: value for key, value in one.items() if isinstance(value, dict)}
        assert set(quantiles) == {"max_deviation", "rms_deviation", "final_deviation"}
        expected = {key: value for key, value in one.items() if key not in quantiles}
        expected |= {f"{key}, {name}": value for key, those in quantiles.items() for name, value in those.items()}
        assert row == expected
    table = pq.read_table(found.folder / "trajectories.parquet").to_pydict()
    for one, name in itertools.product(stored, ("max_deviation", "rms_deviation", "final_deviation")):
        values = sorted(map(abs, table[f"{one['name']}_{name}"]))
        assert (one[name]["min"], one[name]["median"], one[name]["max"]) == (values[0], values[4], values[8])


def test_a_table_of_a_sweep_is_its_file(tmp_path: Path) -> None:
    base = {key: value for key, value in CONFIG.items() if key not in ("name", "h", "N")} | {"T": 0.4}
    grid = {"h": [0.04, 0.02], "scheme": ["hk", "rk4"]}
    measures = ["deviation.energy", "error.max"]
    found = topcli.sweep({"name": "s", "base": base, "grid": grid, "measure": measures}, tmp_path)
    rows = pq.read_table(tmp_path / "s" / "rows.parquet").to_pylist()
    assert [row.pop("current") for row in rows] == [True] * 4
    assert values_of(found.table) == rows
    assert found.as_dict()["rows"] == rows


REPORTS: dict[str, Any] = {
    "orders": lambda: StudyReport(ORDER, Result(ORDERS)),
    "motion": lambda: topcli.motion("kowalevski_generic_hk"),
    "claims": lambda: topcli.claims(["matrix-m", "hk-heavy-equation"]),
}


@pytest.mark.parametrize("name", REPORTS)
def test_files_hold_the_table_and_the_plain_data(name: str, tmp_path: Path) -> None:
    report: Report = REPORTS[name]()
    expected = values_of(report.table)
    pd.testing.assert_frame_equal(pd.read_parquet(report.save(tmp_path / "a.parquet")), report.table)
    read = values_of(
        pd.read_csv(report.save(tmp_path / "a.csv"), keep_default_na=False).set_index(report.table.index.name)
    )
    assert [list(row) for row in read] == [list(row) for row in expected]
    for row, other in zip(read, expected, strict=True):
        for key, value in other.items():
            if isinstance(value, int | float):
                assert float(row[key]) == value, key
            else:
                assert str(row[key]) == ("" if value is None else value), key
    assert json.loads(report.save(tmp_path / "a.json").read_text()) == report.as_dict()


def test_a_table_of_a_motion_has_its_quantities_and_one_of_claims_the_ledger() -> None:
    motion = topcli.motion("kowalevski_generic_hk")
    data = motion.as_dict()
    found = values_of(motion.table)
    assert {row["name"]: row["value"] for row in found} == data["quantities"]
    assert {row["name"]: row["meaning"] for row in found} == data["meanings"]
    claims = topcli.claims(["matrix-m", "hk-heavy-equation"])
    listed = claims.as_dict()["claims"]
    for row, one in zip(values_of(claims.table), listed, strict=True):
        assert row.pop("bound") == one["bound_text"]
        assert row == {key: one[key] for key in row}
        assert {"statement", "source", "experiment", "figure", "verdict"} <= set(row)
