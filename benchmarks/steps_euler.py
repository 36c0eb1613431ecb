"""One HK step of the Euler top in the engine against the same algebra in C, as gcc compiles it.

    python benchmarks/steps_euler.py [--json] [--repetitions 41]

The repetitions are interleaved; every figure is the median over them of the engine's time divided by C's of the same
repetition, with the quartiles. The bar is 1.1.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from c_peer import compiled
from ratios import ratio_rows, show_rows

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src")]

from topcli.engine.loop import loop_of  # noqa: E402
from topcli.schemes.registry import find_scheme  # noqa: E402
from topcli.tops.euler import Euler  # noqa: E402

START = (0.7, -0.4, 1.3)
H, STEPS = 0.01, 200_000
TOP = Euler(A=1.3, B=2.0, C=0.9)

Run = Callable[[np.ndarray, int], None]
"""Advances a state in place by a number of steps."""


def in_engine() -> Run:
    """The engine's loop with its finite check, nothing recorded."""
    p = np.array(TOP.constants())
    loop = loop_of(find_scheme("hk", "euler").build(TOP, None), 3, len(p))
    work, out = np.zeros(loop.width), np.empty(3)

    def run(y: np.ndarray, n: int) -> None:
        loop.enter(y, work, p, H)
        if loop.drive(work, out, p, H, n, n + 1, n + 1) != n:
            raise RuntimeError("blew up")
        y[:] = work[:3]

    return run


def in_c(folder: Path) -> dict[str, Run]:
    """The loop of steps_euler.c by compiler flags; none where there is no gcc."""
    p = np.array(TOP.constants())
    calls, _ = compiled("steps_euler.c", ("hk",), "ppdq", folder)
    return {way: lambda y, n, call=call: call(y.ctypes.data, p.ctypes.data, H, n) for (_, way), call in calls.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=41)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled again; the user's cache is not touched
        forms = {"topcli": in_engine(), **in_c(Path(folder))}
        ends = {}
        for name, run in forms.items():
            ends[name] = np.array(START)
            run(ends[name], 1000)
        for name, end in ends.items():
            same = np.array_equal if name.endswith("off") else np.allclose
            if not same(end, ends["topcli"]):
                raise RuntimeError(f"{name} computes something else: {end} against {ends['topcli']}")
        spent: dict[str, list[float]] = {name: [] for name in forms}
        for repetition in range(arguments.repetitions + 1):
            for name in (list(forms) * 2)[repetition % len(forms) :][: len(forms)]:
                y = np.array(START)
                start = time.perf_counter_ns()
                forms[name](y, STEPS)
                if repetition:  # the first one warms up
                    spent[name].append((time.perf_counter_ns() - start) / STEPS)
    rows = ratio_rows(spent, "topcli")
    if arguments.json:
        print(json.dumps({"schema_version": 1, "scheme": "hk", "top": "euler", "forms": rows}, indent=1))
        return
    if len(rows) == 1:
        print("gcc: not found; the comparison with C is left out")
    print(f"{'hk, euler':<28}{'ns/step':>9}   topcli's time over this (quartiles)")
    show_rows(rows)


if __name__ == "__main__":
    main()
