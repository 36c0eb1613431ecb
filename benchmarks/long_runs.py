"""Long runs: the largest memory of 1e7 and of 1e9 steps, and what recording and checkpoints cost beside the steps."""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.load import load_experiment
from topcli.engine.loop import loop_of
from topcli.runs.run import run_experiment

ROOT = Path(__file__).resolve().parents[1]
HK = str(ROOT / "configs" / "kowalevski_hk.yaml")


def _seconds() -> tuple[float, float]:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return time.perf_counter(), used.ru_utime + used.ru_stime


def memory(steps: int) -> dict[str, Any]:
    """Largest resident memory, in MB, and seconds of ``topcli run`` with 1000 rows and the default checkpoints."""
    code = (
        "import resource, sys; from topcli.__main__ import main\n"
        "try:\n    main()\nexcept SystemExit as leaving:\n    assert not leaving.code, leaving.code\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    )
    with tempfile.TemporaryDirectory() as out:
        arguments = [
            "run",
            HK,
            "--out",
            out,
            "--quiet",
            "--set",
            f"N={steps}",
            "--set",
            f"output.every={steps // 1000}",
        ]
        start = time.perf_counter()
        done = subprocess.run([sys.executable, "-c", code, *arguments], check=True, capture_output=True, text=True)
        return {"steps": steps, "mb": float(done.stdout.split()[-1]), "seconds": time.perf_counter() - start}


def overhead(steps: int, repetitions: int) -> dict[str, Any]:
    """``run_experiment``, a row every 1e6 steps and the default checkpoints, relative to the bare loop in one call.

    Ratios of wall-clock and of processor seconds, pair by pair. What a run of one row takes, which does not grow with
    the number of steps, is measured each time and taken off.
    """
    experiment = load_experiment(HK, [f"N={steps}", "output.every=1000000"])
    brief = load_experiment(HK, ["N=1", "name=brief"])
    loop = loop_of(experiment.method(), 6, 1)
    p, y0 = np.array(experiment.top.constants()), np.array(experiment.y0)
    work, out = np.zeros(loop.width), np.zeros(6)
    ratios = []
    for repetition in range(repetitions + 1):
        with tempfile.TemporaryDirectory() as folder:
            marks = [_seconds()]
            loop.enter(y0, work, p, experiment.h)
            assert loop.drive(work, out, p, experiment.h, steps, steps + 1, steps + 1) == steps
            marks.append(_seconds())
            run_experiment(experiment, Path(folder))
            marks.append(_seconds())
            run_experiment(brief, Path(folder))
            marks.append(_seconds())
        bare, whole, fixed = np.diff(np.array(marks), axis=0)
        if repetition:
            ratios.append((whole - fixed) / bare)
    (wall, processor), (wall_least, processor_least) = np.median(ratios, axis=0), np.min(ratios, axis=0)
    return {
        "steps": steps,
        "wall_ratio": float(wall),
        "wall_ratio_least": float(wall_least),
        "processor_ratio": float(processor),
        "processor_ratio_least": float(processor_least),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--steps", type=int, default=100_000_000)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    short, long = memory(10**7), memory(10**9)
    cost = overhead(arguments.steps, arguments.repetitions)
    if arguments.json:
        print(json.dumps({"schema_version": 1, "memory": [short, long], "overhead": cost}, indent=1))
        return
    for one in (short, long):
        print(f"{one['steps']:.0e} HK steps, 1000 rows: {one['mb']:.1f} MB resident at most, {one['seconds']:.1f} s")
    print(
        f"{cost['steps']:.0e} steps with rows and checkpoints: {cost['wall_ratio']:.3f} (least "
        f"{cost['wall_ratio_least']:.3f}) times the bare loop, {cost['processor_ratio']:.3f} (least "
        f"{cost['processor_ratio_least']:.3f}) in processor time; bar 1.02"
    )


if __name__ == "__main__":
    main()
