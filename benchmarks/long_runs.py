"""Memory of runs of 1e7 and of 1e9 steps, and cost of rows and checkpoints beside the steps.

    python benchmarks/long_runs.py [--steps 1e8] [--repetitions 5]

Memory must not grow with the number of steps. A run with a row every 1e6 steps and the default checkpoints is compared
with the time loop in one call; what a run of one row takes is subtracted. The bar is 1.02.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from topcli.config.load import load_experiment
from topcli.engine.loops import loop_of
from topcli.runs.run import run_experiment

SCENE = "kowalevski_hk"
PEAK = """
import resource, sys, tempfile
import topcli
with tempfile.TemporaryDirectory() as out:
    topcli.run(sys.argv[1], out, N=int(sys.argv[2]), output={"every": int(sys.argv[2]) // 1000}, progress=False)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def peak(steps: int) -> float:
    """Largest resident memory in MB of a process that runs the scene with 1000 rows."""
    command = [sys.executable, "-c", PEAK, SCENE, str(steps)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def overhead(steps: int) -> float:
    """Time of a run with rows and checkpoints over that of the time loop."""
    experiment = load_experiment(SCENE, [f"N={steps}", "output.every=1000000"])
    brief = load_experiment(SCENE, ["N=1"])
    loop, p = loop_of(experiment.method(), 6, 1), np.array(experiment.top.constants())
    work, out = np.zeros(loop.width), np.zeros(6)
    loop.enter(np.array(experiment.y0), work, p, experiment.h)
    marks = [time.perf_counter()]
    assert loop.take_steps(work, out, p, experiment.h, steps, steps + 1, steps + 1) == steps
    marks.append(time.perf_counter())
    for each in (experiment, brief):
        with tempfile.TemporaryDirectory() as folder:
            run_experiment(each, Path(folder))
        marks.append(time.perf_counter())
    bare, whole, fixed = np.diff(marks)
    return (whole - fixed) / bare


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--steps", type=float, default=1e8)
    arguments = parser.parse_args()
    for steps in (10**7, 10**9):
        print(f"{steps:.0e} steps, 1000 rows: {peak(steps):.0f} MB at most", flush=True)
    ratios = [overhead(int(arguments.steps)) for _ in range(arguments.repetitions + 1)][1:]
    print(f"rows and checkpoints: {np.median(ratios):.3f} (least {min(ratios):.3f}) times the time loop")


if __name__ == "__main__":
    main()
