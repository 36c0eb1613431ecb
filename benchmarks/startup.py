"""Fresh processes, everything cached and warm: how long a command takes against a named baseline.

The commands run in turn with their baselines, and the ratios are formed pair by pair, so that a machine whose
speed drifts still gives a fair ratio.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
HYBRID = str(ROOT / "configs" / "kowalevski_hybrid.yaml")


def _seconds(command: list[str]) -> float:
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT)
    return time.perf_counter() - start


def _cases(out: str) -> list[tuple[str, list[str], str, float]]:
    python = sys.executable
    run = [python, "-m", "topcli", "run", HYBRID, "--force", "--out", out]
    return [
        ("topcli run, 50000 steps, Parquet, reports", run, "import numpy, numba", 1.8),
        ("topcli --help", [python, "-m", "topcli", "--help"], "import typer, rich", 1.8),
    ]


def measure(pairs: int) -> list[dict[str, object]]:
    """For each case: median seconds, the baseline's, the median of the paired ratios and their range."""
    results = []
    with tempfile.TemporaryDirectory() as out:
        for name, command, baseline, bar in _cases(out):
            base_command = [sys.executable, "-c", baseline]
            _seconds(command), _seconds(base_command)
            timed = [(_seconds(command), _seconds(base_command)) for _ in range(pairs)]
            ratios = sorted(a / b for a, b in timed)
            results.append(
                {
                    "case": name,
                    "seconds": statistics.median(a for a, _ in timed),
                    "baseline": f'python -c "{baseline}"',
                    "baseline_seconds": statistics.median(b for _, b in timed),
                    "ratio": statistics.median(ratios),
                    "ratio_range": [ratios[0], ratios[-1]],
                    "bar": bar,
                }
            )
    return results


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=11)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    results = measure(arguments.pairs)
    if arguments.json:
        print(json.dumps({"schema_version": 1, "startup": results}, indent=1))
        return
    for r in results:
        low, high = r["ratio_range"]  # type: ignore[misc]
        print(
            f"{r['case']}: {r['seconds']:.3f} s = {r['ratio']:.2f} ({low:.2f} to {high:.2f}) "
            f"times {r['baseline']} ({r['baseline_seconds']:.3f} s); bar {r['bar']}"
        )


if __name__ == "__main__":
    main()
