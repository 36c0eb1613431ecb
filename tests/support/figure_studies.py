"""Results of studies that take minutes, made up in their typical magnitudes: enough to lay out the figures of them."""

from __future__ import annotations

import itertools
import math
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure

from conftest import ROOT
from drawn_artists import drawn
from sweep_rows import write_rows
from topcli.figures import period
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Loaded, Request
from topcli.figures.growth import SCHEMES
from topcli.studies.stress.cases import CASES
from topcli.studies.stress.trials import chosen

ORDERS = {"bohlin-a": 1, "bohlin-b": 1, "bohlin-c": 1, "rk4": 4, "hk+kahan-li6": 6, "hk+kahan-li8": 8}


ORDERED = ("bohlin-a", "hk", "hybrid", "rk4", "hk+kahan-li6", "hk+kahan-li8")
SIZES = [0.5 * 2.0**-k for k in range(18)]


def size(scheme: str, h: float) -> float:
    """An error of the scheme's order down to a plateau; each scheme has its own factor."""
    exact = scheme in ("taylor", "exact", "dop853")
    factor = 1.0 + zlib.crc32(scheme.encode()) % 1009 / 60.0
    return max(0.0 if exact else factor * h ** ORDERS.get(scheme, 2), 1e-15 * factor)


def measured(measure: str, scheme: str, h: float) -> float:
    """A value of a measure, different for each measure and scheme."""
    value = size(scheme, h) * (1.0 + 0.01 * len(measure))
    return 20.0 + 3.0 * math.log10(value) if "swing" in measure else value


def _orders(patch: pytest.MonkeyPatch, folder: Path) -> None:
    def study(what: Any, on_progress: object) -> dict[str, Any]:
        rows = [
            {"scheme": name, "points": [{"h": h, "error": size(name, h)} for h in SIZES], "declared_order": 2}
            for name in ORDERED
        ]
        return {
            "schema_version": 1,
            "name": "kowalevski_generic_hk",
            "top": "Kowalevski top (A)",
            "duration": 10.0,
            "schemes": rows,
        }

    patch.setattr("topcli.studies.order_ladders.order_study", study)


def _spaced(values: Any) -> list[Any]:
    """Values of a key of a sweep; those of a range as powers of ten."""
    if isinstance(values, list):
        return values
    ends = np.log10([float(values["from"]), float(values["to"])])
    return [float(f"{10.0**power:.6g}") for power in np.linspace(*ends, values["count"])]


def _sweep(name: str) -> Callable[[pytest.MonkeyPatch, Path], None]:
    def prepare(patch: pytest.MonkeyPatch, folder: Path) -> None:
        sweep = yaml.safe_load((ROOT / "configs" / "sweeps" / f"{name}.yaml").read_text(encoding="utf-8"))
        grid = {key: _spaced(values) for key, values in sweep["grid"].items()}
        grid |= {"random": [1, 2, 3, 4]} if "random" in sweep else {}
        rows = list(itertools.product(*grid.values()))
        keys = {key: [row[i] for row in rows] for i, key in enumerate(grid)}
        keys |= {key: [float(value) for value in keys[key]] for key in keys if key != "scheme"}
        entries = list(zip(keys["scheme"], keys.get("h", [0.01] * len(rows)), strict=True))
        measures = {one: [measured(one, *entry) for entry in entries] for one in sweep["measure"]}
        for one in (name for name in measures if "drift" in name and "random" in sweep):
            measures[one] = [value if i % 3 else -value for i, value in enumerate(measures[one])]
        written = write_rows(folder / name, keys, measures, log=["h"])
        result = SimpleNamespace(folder=written, outcomes={"completed": len(rows)})
        patch.setattr("topcli.sweeps.run.run_sweep", lambda *arguments, **options: result)

    return prepare


TIMES = 0.1 * 2.0 ** np.arange(20)


def energies(scene: str, scheme: str) -> np.ndarray:
    """Energy errors that differ between schemes and scenes."""
    return len(scene) * size(scheme, 0.05) * TIMES**0.1


def _energies(patch: pytest.MonkeyPatch, folder: Path) -> None:
    data = {f"t:{scene}": TIMES for scene in SCHEMES}
    data |= {f"{scene}:{name}": energies(scene, name) for scene, names in SCHEMES.items() for name in names}
    patch.setattr("topcli.figures.growth.energy_columns", lambda: data)


STEPS = 2.0 ** np.arange(10, 19)
POWERS = {"a_sq:matrix": (1e-16, 1.0), "a_sq:plain": (6e-17, 0.5), "a_sq:compensated": (2e-18, 0.4)}
POWERS |= {"k_sq:hybrid": (3e-16, 0.5), "k_sq:hybrid-xi": (2e-16, 0.0)}


def _growth(patch: pytest.MonkeyPatch, folder: Path) -> None:
    data = {"steps": STEPS} | {name: least * STEPS**power for name, (least, power) in POWERS.items()}
    patch.setattr("topcli.figures.growth.growth_columns", lambda: data)


PEERS = ("scipy dop853", "scipy dop853 numba", "heyoka", "heyoka high-accuracy", "diffrax Dopri8", "diffrax Tsit5")
SET_UP = "backlund:nodes=exact"
LONGEST = "dmv:moments=preprocessed,order=10"
OURS = (SET_UP, "taylor", "rk4", "hk+kahan-li6", "hk+kahan-li8", LONGEST, "splitting+kahan-li8")
TITLES = ("Kowalevski top, generic", "Kowalevski top, near the homoclinic orbit", "Euler top", "Lagrange top")


def benched(name: str) -> list[tuple[float, float]]:
    """Errors and seconds of a competitor, the more accurate the later."""
    i = (*OURS, *PEERS).index(name)
    errors = [10.0 ** (-k - 0.1 * i) for k in range(1, 12)]
    return [(error, (1.0 + i) * 1e-6 * error**-0.1) for error in errors]


def _benches(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Results of which each competitor has two points that are not drawn: too inaccurate, and beaten in both."""

    def points(name: str) -> list[dict[str, Any]]:
        rest = {"value": 0.1, "drift": 0.0, "quartiles": [1.0, 2.0], "invariants": {}}
        found = [*benched(name), (3.0, 1e-9), (0.2, 1.0)]
        return [{"error": e, "seconds": seconds, "final_error": e / 7.0, **rest} for e, seconds in found]

    competitors = [
        {"name": name, "kind": "peer" if name in PEERS else "topcli", "parameter": "h", "points": points(name)}
        | {"setup_seconds": 5e-3 if name == SET_UP else 0.0}
        for name in (*OURS, *PEERS)
    ]
    run = SimpleNamespace(manifest=dict.fromkeys(("name", "digest", "code", "ended"), ""))
    reports = [{"name": title, "title": title, "competitors": competitors} for title in TITLES]
    patch.setattr("topcli.figures.comparison.stored_benches", lambda out: [(run, one) for one in reports])


def _stress(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """All schemes in all cases: those of their limits broke, some others were degraded or not tried."""
    schemes, _ = chosen((), (), None)
    trials = [
        {
            "top": scheme.top,
            "scheme": scheme.name,
            "case": case.name,
            "outcome": "broke" if case.name in scheme.limits else ("not tried" if case.name == "drift" else "held"),
            "step": 10 ** (len(scheme.name) % 6),
            "verdict": "ok",
        }
        for scheme in schemes
        for case in CASES
        if case.form == scheme.top
    ]
    patch.setattr("topcli.figures.outcomes.current_study", lambda *arguments: {"trials": trials})


def spacings(name: str, sizes: np.ndarray) -> np.ndarray:
    """Times between swings for step ``sizes``, other ones for each scheme."""
    slope = 1.4 if name == "bohlin-a" else 0.1 + 0.001 * len(name)
    return 28.17 - slope * np.log(sizes / sizes[0])


def _period(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Motions that swing at 14 and 42; spacings that fall with ln h from those of the law."""
    t, sizes = np.linspace(0.0, 50.0, 1001), 10.0 ** np.arange(-7.0, 0.0)

    def columns(on_progress: object) -> dict[str, np.ndarray]:
        data = {"t": t, "swings": np.array([14.0, 42.0, np.nan])}  # of the same length in the file
        motions = (period.motion_column(name, h) for name, h in period.SHOWN)
        data |= {name: 1.0 - (2.0 - 0.01 * i) / np.cosh((t - 14.0) % 28.0) for i, name in enumerate(motions)}
        for name in (scheme.name for scheme in period.SCHEMES):
            data |= {f"h:{name}": sizes, f"spacing:{name}": spacings(name, sizes)}
        return data

    patch.setattr("topcli.figures.period.period_columns", columns)


PREPARE: dict[str, Callable[[pytest.MonkeyPatch, Path], None]] = {
    "order": _orders,
    "swings": _sweep("kowalevski_swings"),
    "errors": _sweep("kowalevski_errors"),
    "heavy-drift": _sweep("heavy_drift"),
    "period": _period,
    "integrable": _energies,
    "roundoff": _growth,
    "work-precision": _benches,
    "stress": _stress,
}
"""How the results of figures are made up. Figures without an entry are made from their own results."""


def loaded_named(name: str, results: Path, patch: pytest.MonkeyPatch, **options: object) -> Loaded:
    """What a figure of the catalogue loads; results that take minutes are made up."""
    if name in PREPARE:
        PREPARE[name](patch, results)
    return FIGURES[name].load(Request(results, ROOT / "configs", **options))  # type: ignore[arg-type]


def figure_named(name: str, results: Path, patch: pytest.MonkeyPatch) -> Figure:
    """The figure of what it loads."""
    return drawn(loaded_named(name, results, patch))
