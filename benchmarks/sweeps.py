"""Rows per second and memory of sweeps as they grow, and gain by a second thread.

    python benchmarks/sweeps.py [--rows 1000 10000 100000] [--repetitions 5]

Each sweep is a process of its own. Light rows of a hundred steps differ in their initial states: a row must take less
than 0.3 ms, and 100,000 rows less than 1 GB. Heavy rows of 50,000 steps have a step size each.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys

import numpy as np

BASE = {
    "top": "kowalevski",
    "initial": {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]},
    "scheme": "hk",
}
MEASURES = ["max_deviation.energy", "drift.energy"]
SWEEP = """
import json, resource, sys, tempfile, time
import topcli
begin, cpu = time.perf_counter(), time.process_time()
with tempfile.TemporaryDirectory() as out:
    topcli.sweep(json.loads(sys.argv[1]), out, threads=int(sys.argv[2]), progress=False)
spent = time.perf_counter() - begin, time.process_time() - cpu
print(json.dumps([*spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))
"""


def light(count: int) -> dict[str, object]:
    """Sweep of rows that differ in their initial states."""
    base = BASE | {"h": 0.01, "N": 100, "output": {"every": 10}}
    random = {"count": count, "seed": 1, "omega": {"sphere": 1}, "gamma": "sphere"}
    return {"name": "light", "base": base, "random": random, "measure": MEASURES}


def heavy(count: int) -> dict[str, object]:
    """Sweep of rows that differ in their step sizes."""
    base = BASE | {"N": 50_000, "output": {"every": 500}}
    grid = {"h": {"from": 0.001, "to": 0.01, "count": count}}
    return {"name": "heavy", "base": base, "grid": grid, "measure": MEASURES}


def swept(sweep: dict[str, object], threads: int) -> list[float]:
    """Wall-clock and processor seconds of a sweep, and the largest memory of its process in MB."""
    command = [sys.executable, "-c", SWEEP, json.dumps(sweep), str(threads)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, nargs="*", default=[1000, 10_000, 100_000])
    parser.add_argument("--repetitions", type=int, default=5)
    arguments = parser.parse_args()
    swept(light(100), 1)  # compiles
    for count in arguments.rows:
        _, cpu, peak = swept(light(count), 1)
        print(f"{count} light rows: {cpu / count * 1e3:.3f} ms each, {peak:.0f} MB at most", flush=True)
    gains = [swept(heavy(1000), 1)[0] / swept(heavy(1000), 2)[0] for _ in range(arguments.repetitions)]
    print(f"1000 heavy rows: two threads are {np.median(gains):.2f} times as fast as one (at most {max(gains):.2f})")


if __name__ == "__main__":
    main()
