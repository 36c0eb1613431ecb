"""Results of runs, and analyses of made-up series, compared with recorded ones."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import golden
from made_up import report_on
from test_golden_tables import measured
from topcli.analysis.order import convergence
from topcli.analysis.swings import first_swing_spacing, minima_times
from topcli.studies.roundoff import growth

UNREPEATABLE = (
    "second",
    "cost",
    "environment",
    "quartile",
    "process",
    "version",
    "started",
    "ended",
    "file",
    "folder",
    "sha",
    "cpu",
    "digest",
    "code",
)


def repeatable(data: Any) -> Any:
    """Results without times and places; round-off as zero, other numbers to six digits."""
    if isinstance(data, dict):
        return {k: repeatable(v) for k, v in data.items() if not any(word in k for word in UNREPEATABLE)}
    if isinstance(data, list):
        return [repeatable(item) for item in data]
    if isinstance(data, float) and math.isfinite(data):
        return 0.0 if abs(data) < 1e-11 else float(f"{data:.6g}")
    return data


@pytest.mark.parametrize("name", ["run", "ensemble"])
def test_results(name: str, tmp_path: Path) -> None:
    data = json.loads(json.dumps(measured(name, tmp_path).as_dict()).replace(str(tmp_path), "OUT"))
    data.pop("series", None)
    golden.check(f"values_{name}", repeatable(data), rel=2e-5)


N = 4001
T = 0.01 * np.arange(N)
NOISE = np.random.default_rng(1).normal(size=N)
SERIES = {
    "still": 0.0 * T,
    "line": 1e-4 * T,
    "wave": 1e-3 * np.sin(3.0 * T),
    "beat": 1e-3 * np.sin(0.1 * T) + 4e-3 * np.sin(40 * T),
    "noise": 1e-3 * NOISE,
    "walk": 1e-6 * np.cumsum(NOISE),
    "steep": 1e-3 * NOISE + 1e-3 * T,
    "round-off": 2e-16 * np.cumsum(NOISE),
    "lost": 0.3 * np.sin(T),
    "short": 1e-3 * NOISE[:9],
    "few": 1e-3 * NOISE[:7],
    "jump": np.where(T > 20, 1e-9, 0.0),
    "bad": np.where(T > 30, np.inf, 0.0),
}


@pytest.mark.parametrize("h", [0.01, -0.02])
def test_drift(h: float) -> None:
    reports = {}
    for name, values in SERIES.items():
        motion = np.cos(2 * np.pi * 30 * T[: len(values)] / T[-1])
        reports[name] = repeatable(report_on(1.0 + values, motion, h, np.full(len(values), 3.0)).as_dict())
    golden.check(f"drift_{h}", reports, rel=1e-5)


def test_growth_orders_and_swings() -> None:
    random = np.random.default_rng(2)
    walks = {
        str(bias): 1e-16 * (np.cumsum(random.normal(size=(8, 256)), axis=1) + bias * np.arange(256))
        for bias in (0.0, 0.3, 1.0, 3.0)
    }
    walks["noise"] = 1e-16 * random.normal(size=(8, 256))
    fits: dict[str, Any] = {
        "growth": {
            k: [
                str(x) if not isinstance(x, float) else float(f"{x:.5g}")
                for x in dataclasses.astuple(growth(v, 100, 1.0))
            ]
            for k, v in walks.items()
        }
    }
    h = 0.5 * 2.0 ** -np.arange(14)
    laws = {
        "2": 7 * h**2,
        "4": h**4 + 1e-13,
        "bent": h**2 + 5 * h**4,
        "flat": 0 * h + 0.3,
        "floor": np.maximum(h**8, 3e-14),
        "holes": np.where(h < 0.01, np.nan, h**2),
    }
    fits["orders"] = {k: str(convergence(list(h), list(v))) for k, v in laws.items()}
    dips = -np.exp(-((T[:, None] - np.array([3.0, 9.0, 14.0, 22.5])) ** 2) / 0.2).sum(axis=1)
    swings = {"dips": dips, "cosine": np.cos(T), "short": np.cos(T) * (1 + 0.5 * np.sin(T / 3)), "line": T}
    fits["swings"] = {
        k: [*(float(f"{x:.9g}") for x in minima_times(T, v)), str(first_swing_spacing(minima_times(T, v)))[:12]]
        for k, v in swings.items()
    }
    golden.check("analyses", fits, rel=1e-6)
