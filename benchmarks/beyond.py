"""One step of the Kowalevski schemes beyond the paper: its cost in HK steps, and what it keeps and errs at PAPER.

    python benchmarks/beyond.py [--json] [--processes 5]
    python benchmarks/beyond.py --drift [--json]

Nanoseconds per step are medians in each of several processes, and the least of these counts: where the compiler's
spills lie in memory is decided again in every process and costs up to a factor of two.

With --drift instead, for three states and h = 0.01: the slope of every integral over t = 1e5, its standard error, the
largest deviation, and the verdict of the report that every run makes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src")]

from topcli.analysis.reference import reference_states  # noqa: E402
from topcli.analysis.tally import InvariantTally  # noqa: E402
from topcli.engine.run import Run, nanoseconds_per_step  # noqa: E402
from topcli.schemes.registry import find_scheme  # noqa: E402
from topcli.tops.kowalevski import Kowalevski  # noqa: E402

GEN = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
PAPER = (2.0, 0.0, 0.0, (1.0 - 1e-6) ** 0.5, 0.0, 1e-3)
NAMES = (
    "hk",
    "hybrid",
    "hybrid-xi",
    "hybrid-sym",
    "midpoint",
    "hk-projected",
    "hk-symproj",
    "dg4",
    "midpoint4",
    "backlund",
)
SIZES = (0.001, 0.01, 0.1)
LONG = ("hybrid", "hybrid-sym", "hk-symproj", "dg4", "midpoint4", "backlund")
STATES = {
    "generic": GEN,
    "paper": PAPER,
    "fast": (-1.1, 1.7, 0.6, -0.48, 0.6, 0.64),
}


def method(name: str) -> Any:
    scheme = find_scheme(name, "kowalevski")
    return scheme.build(Kowalevski(), scheme.options())


def nanoseconds() -> dict[str, list[float]]:
    """For every scheme the time of a step at every size, in this process."""
    top = Kowalevski()
    # short repetitions: most of them then fall between two interruptions by others on the machine
    columns = [nanoseconds_per_step([(top, method(name), GEN, h) for name in NAMES], 8000, 31) for h in SIZES]
    return {name: [column[i] for column in columns] for i, name in enumerate(NAMES)}


def in_processes(count: int) -> dict[str, list[float]]:
    """Least times over ``count`` processes."""
    seen = []
    for _ in range(count):
        done = subprocess.run([sys.executable, __file__, "--one"], capture_output=True, text=True, check=True)
        seen.append(json.loads(done.stdout))
    return {name: np.min([one[name] for one in seen], axis=0).tolist() for name in NAMES}


def at_paper(name: str, h: float = 0.05, t: float = 50.0) -> dict[str, Any]:
    """The error (largest component) at t, and the largest deviations of the integrals up to there."""
    top = Kowalevski()
    states = Run(top, method(name), PAPER, h, round(t / h)).collect().states
    exact = reference_states(top, PAPER, np.array([t]))[0]
    kept = {i.name: float(np.abs(i.value(states) - i.value(states[:1])).max()) for i in top.invariants()}
    return {"error": float(np.abs(states[-1] - exact).max()), "deviations": kept}


def drifts(h: float = 0.01, t: float = 1e5) -> list[dict[str, Any]]:
    """Deviations of the integrals over that time."""
    top, rows = Kowalevski(), []
    for scene, y0 in STATES.items():
        for name in LONG:
            tally = InvariantTally(top.invariants(), h)
            for chunk in Run(top, method(name), y0, h, round(t / h), 50):
                tally.add(chunk.n, chunk.states)
            keys = ("name", "drift", "drift_error", "max_deviation", "verdict")
            rows += [
                {"state": scene, "scheme": name} | {key: getattr(row, key) for key in keys} for row in tally.report()
            ]
    return rows


def print_drifts(as_json: bool) -> None:
    """The long record."""
    rows = drifts()
    if as_json:
        print(json.dumps({"schema_version": 1, "h": 0.01, "t": 1e5, "drifts": rows}, indent=1))
        return
    for row in rows:
        slope = f"slope {row['drift']:9.1e} ± {row['drift_error']:.1e} per unit time"
        print(
            f"{row['state']:<8} {row['scheme']:<11} {row['name']:<9} {slope}, at most {row['max_deviation']:.1e} off,",
            end="",
        )
        print(f" {row['verdict']}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--drift", action="store_true", help="the long record instead: t = 1e5, about two minutes")
    arguments = parser.parse_args()
    if arguments.drift:
        print_drifts(arguments.json)
        return
    if arguments.one:
        print(json.dumps(nanoseconds()))
        return
    times = in_processes(arguments.processes)
    rows = [
        {"scheme": name, "ns": times[name], "hk_steps": [a / b for a, b in zip(times[name], times["hk"], strict=True)]}
        | at_paper(name)
        for name in NAMES
    ]
    if arguments.json:
        print(json.dumps({"schema_version": 1, "h": SIZES, "schemes": rows}, indent=1))
        return
    print(f"{'':14}cost in HK steps at h = {SIZES};  at PAPER, h = 0.05, t = 50: error, deviations")
    for row in rows:
        cost = " ".join(f"{x:6.2f}" for x in row["hk_steps"])
        kept = " ".join(f"{name} {value:.0e}" for name, value in row["deviations"].items())
        print(f"{row['scheme']:<14}{cost}   {row['error']:.1e}   {kept}")


if __name__ == "__main__":
    main()
