"""Time of commands in a new process, with everything cached, over that of importing packages that they need.

    python benchmarks/startup.py [--pairs 11]

A command and its baseline run in turn; the ratio is the median over the pairs, with its range. The bar is 1.8.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time

RUN = ["run", "kowalevski_hybrid", "--force", "--quiet", "--out"]


def seconds(*arguments: str) -> float:
    """Time of a new Python process."""
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=11)
    pairs = parser.parse_args().pairs
    with tempfile.TemporaryDirectory() as out:
        for title, arguments, baseline in (
            ("topcli run, 50000 steps, Parquet, report", [*RUN, out], "import numpy, numba"),
            ("topcli --help", ["--help"], "import typer, rich"),
        ):
            timed = [(seconds("-m", "topcli", *arguments), seconds("-c", baseline)) for _ in range(pairs + 1)][1:]
            ratios = sorted(a / b for a, b in timed)
            print(
                f"{title}: {statistics.median(a for a, _ in timed):.3f} s = {statistics.median(ratios):.2f} "
                f'({ratios[0]:.2f} to {ratios[-1]:.2f}) times python -c "{baseline}"'
            )


if __name__ == "__main__":
    main()
