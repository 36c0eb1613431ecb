"""Cost of a composed step: its time over the base's, beside its number of stages.

    python benchmarks/compose.py [--json] [--repetitions 51]

Every scheme of the Kowalevski top that can be composed, through the engine's own loop. The repetitions are
interleaved; every figure is the median over them of the time divided by the base's of the same repetition, with the
quartiles. Fused, a composed step should cost what its stages cost, and no more.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "benchmarks"), str(ROOT / "src")]

from ratios import quartiles  # noqa: E402

from topcli.contracts import Scheme  # noqa: E402
from topcli.engine.loop import loop_of  # noqa: E402
from topcli.schemes.compose import COMPOSITIONS, compose  # noqa: E402
from topcli.schemes.registry import composable_names, find_scheme  # noqa: E402
from topcli.tops.kowalevski import Kowalevski  # noqa: E402

GEN = np.array((0.7, -0.4, 1.3, 0.6, 0.48, 0.64))
H, STAGES = 0.01, 34_000


def timed(schemes: dict[str, tuple[Scheme, int]], repetitions: int) -> dict[str, list[float]]:
    """Nanoseconds per step of every scheme in every repetition, each over about ``STAGES`` steps of the base."""
    top = Kowalevski()
    p, out = np.array(top.constants()), np.empty(6)
    loops = {name: loop_of(found.build(top, found.options()), 6, len(p)) for name, (found, _) in schemes.items()}
    names, spent = list(schemes), {name: [] for name in schemes}
    for repetition in range(repetitions + 1):
        for name in names[repetition % len(names) :] + names[: repetition % len(names)]:
            loop, steps = loops[name], STAGES // schemes[name][1]
            work = np.zeros(loop.width)
            loop.enter(GEN, work, p, H)
            start = time.perf_counter_ns()
            if loop.drive(work, out, p, H, steps, steps + 1, steps + 1) != steps:
                raise RuntimeError(f"{name} blew up")
            spent[name].append((time.perf_counter_ns() - start) / steps)
    return {name: values[1:] for name, values in spent.items()}  # the first repetition warms up


def measure(base: str, repetitions: int) -> list[dict[str, Any]]:
    """A row for the base and for each of its compositions."""
    found = find_scheme(base, "kowalevski")
    schemes = {base: (found, 1)} | {
        f"{base}+{c.name}": (compose(found, c.name), c.stages) for c in COMPOSITIONS.values()
    }
    spent = timed(schemes, repetitions)
    rows = []
    for name, (_, stages) in schemes.items():
        low, middle, high = quartiles([a / b for a, b in zip(spent[name], spent[base], strict=True)])
        ns = statistics.median(spent[name])
        rows.append({"scheme": name, "stages": stages, "ns": ns, "ratio": middle, "quartiles": [low, high]})
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=51)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled again; the user's cache is not touched
        rows = [row for base in composable_names("kowalevski") for row in measure(base, arguments.repetitions)]
    if arguments.json:
        print(json.dumps({"schema_version": 1, "compositions": rows}, indent=1))
        return
    print(f"{'composition':<24}{'ns/step':>9}{'stages':>8}   time over the base's (quartiles)   per stage")
    for row in rows:
        low, high = row["quartiles"]
        over_base = f"{row['ratio']:.2f} ({low:.2f} to {high:.2f})"
        per_stage = row["ratio"] / row["stages"]
        print(f"{row['scheme']:<24}{row['ns']:>9.1f}{row['stages']:>8}   {over_base:<32} {per_stage:.3f}")


if __name__ == "__main__":
    main()
