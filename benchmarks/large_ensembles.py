"""Run folders of large ensembles: processor time and peak memory of a process, for growing numbers of members.

    python benchmarks/large_ensembles.py [--json] [--members 10000 100000 1000000] [--steps 1000]

Each measurement is a process of its own on one thread, which runs the scene kowalevski_ensemble with ``store:
statistics`` or ``final``; the machine code is compiled before. ``loop`` is the bare loop over the lanes as in
``benchmarks/ensemble.py``; ``ns`` everything: drawing, tallying, writing the tables and starting Python, in processor
time per trajectory-step. ``us each`` is what a member costs beyond the bare loop, in microseconds. The peak of memory
must not grow with the members, and ``us each`` must not either once Python's start is a small part of it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "benchmarks"), str(ROOT / "src")]

SCHEME = "hybrid"


def worker(members: int, steps: int, store: str) -> None:
    """Run one ensemble; print its figures as JSON."""
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.load import load
    from topcli.runs.decision import RunOptions
    from topcli.runs.run import run_experiment

    settings = {"ensemble.random.count": members, "ensemble.store": store, "N": steps, "output.every": steps}
    found = load("kowalevski_ensemble", [f"scheme={SCHEME}", *(f"{key}={value}" for key, value in settings.items())])
    assert isinstance(found, EnsembleExperiment)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        run_experiment(found, Path(folder), RunOptions(threads=1))
    unit = 1 if sys.platform == "darwin" else 1024
    figures = {
        "wall_seconds": time.perf_counter() - start,
        "cpu_seconds": time.process_time(),
        "peak_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit,
    }
    print(json.dumps(figures))


def measured(members: int, steps: int, store: str) -> dict[str, Any]:
    """The figures of an ensemble in a process of its own."""
    command = [sys.executable, __file__, "--worker", store, "--members", str(members), "--steps", str(steps)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    return {"members": members, "steps": steps, "store": store, **json.loads(done.stdout)}


def bare_loop(repetitions: int = 9) -> float:
    """Nanoseconds per trajectory-step of the loop over the lanes."""
    from ensemble import Case

    case = Case(SCHEME, "kowalevski")
    return min(case.together() for _ in range(repetitions))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--worker", choices=["statistics", "final"], help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        worker(arguments.members[0], arguments.steps, arguments.worker)
        return
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled here, and the user's cache left alone
        loop = bare_loop()
        rows = []
        for store in ("statistics", "final"):
            measured(100, arguments.steps, store)  # compiles
            rows += [measured(members, arguments.steps, store) for members in arguments.members]
    for row in rows:
        row["loop_ns"] = loop
        row["ns"] = row["cpu_seconds"] * 1e9 / row["members"] / row["steps"]
        row["us_each"] = (row["ns"] - loop) * row["steps"] / 1000.0
    if arguments.json:
        print(json.dumps({"schema_version": 1, "cpus": os.cpu_count(), "ensembles": rows}, indent=1))
        return
    print(
        f"{'members':>9}{'steps':>7}  {'store':<11}{'wall s':>8}{'cpu s':>8}{'MB':>6}{'ns':>7}{'loop':>7}{'us each':>9}"
    )
    for row in rows:
        print(
            f"{row['members']:>9}{row['steps']:>7}  {row['store']:<11}{row['wall_seconds']:>8.2f}"
            f"{row['cpu_seconds']:>8.2f}{row['peak_bytes'] / 1e6:>6.0f}{row['ns']:>7.2f}{row['loop_ns']:>7.2f}"
            f"{row['us_each']:>9.2f}"
        )


if __name__ == "__main__":
    main()
