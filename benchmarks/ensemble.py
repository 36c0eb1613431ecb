"""Ensembles: the time of one trajectory-step and core, against single trajectories, and what a second thread adds.

    python benchmarks/ensemble.py [--json] [--repetitions 41]

The baseline is one step of the straightforward HK scheme (block elimination, ``tests/twins.py``) in the engine's time
loop, as in ``benchmarks/steps.py``; the second ratio is against the same scheme's own step in that loop. Repetitions
are interleaved; every figure is the median over them of the ratio, with the ratio of the least times beside it. Nothing
is recorded. Two threads need two idle CPUs: on a busy machine only the best of many short runs tells anything.
``vector`` is the widest register in the machine code of the loop over the lanes; narrower vectors are measured with
NUMBA_CPU_FEATURES set to what an older machine has, such as +sse,+sse2,+sse3,+ssse3,+sse4.1,+sse4.2,+avx,+avx2.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "src")]

from conftest import GEN, random_states  # noqa: E402
from topcli.contracts import Stepper  # noqa: E402
from topcli.engine import native as compiler  # noqa: E402
from topcli.engine.driver import loop_of  # noqa: E402
from topcli.engine.ensemble import GROUP, TILE, EnsembleRun  # noqa: E402
from topcli.engine.lanes import SIGNATURE, plain_lanes, stages_of  # noqa: E402
from topcli.engine.native import native  # noqa: E402
from topcli.schemes.registry import find_scheme  # noqa: E402
from topcli.tops import TOPS  # noqa: E402
from twins import hk_block  # noqa: E402

H, STEPS = 0.01, 2000
CASES = (
    ("hk", "kowalevski"),
    ("hk+suzuki4", "kowalevski"),
    ("hybrid", "kowalevski"),
    ("hybrid-xi", "kowalevski"),
    ("rk4", "kowalevski"),
    ("midpoint", "kowalevski"),
    ("hk", "euler"),
    ("bs", "euler"),
    ("bs", "lagrange/inertial"),
    ("hk", "lagrange"),
    ("hk", "heavy"),
)


def vector(lanes: Any) -> str:
    """The widest vector register that the loop over the lanes uses for arithmetic."""
    ir = compiler._compile(lanes, SIGNATURE, True).inspect_llvm()
    llvm, _ = compiler._machine()
    code = compiler._target_machine().emit_assembly(llvm.parse_assembly(ir))
    for name, bits in (("zmm", 512), ("ymm", 256), ("xmm", 128)):
        if re.search(rf"v?(mul|add|sub|div)pd[^\n]*{name}", code):
            return f"{bits} bits"
    return "none"


class Case:
    """One scheme, ready to be timed alone and in lanes."""

    def __init__(self, name: str, form: str) -> None:
        self.name, self.form = name, form
        self.top = TOPS[form].new()
        scheme = find_scheme(name, form)
        method = scheme.build(self.top, scheme.options())
        assert isinstance(method, Stepper)
        self.method, d, p = method, len(self.top.components), self.top.constants()
        self.p = np.array([*p, *stages_of(method)[1]])
        self.loop = loop_of(method, d, len(p))
        plain = plain_lanes(method, d, len(p), TILE)
        self.lanes, self.vector = native(plain, SIGNATURE), vector(plain)
        self.out = np.empty(d * TILE)
        self.y0 = random_states(2 * GROUP * TILE, 3)[:, :d]
        self.work = np.zeros((method.width + 1, TILE))
        one = np.zeros(method.width)
        for j in range(TILE):
            self.loop.enter(self.y0[j], one, self.p, H)
            self.work[:-1, j] = one

    def alone(self) -> float:
        """Nanoseconds per step of one trajectory."""
        work, steps = self.work[:-1, 0].copy(), STEPS
        start = time.perf_counter_ns()
        self.loop.drive(work, self.out, self.p, H, steps, steps + 1, steps + 1)
        return (time.perf_counter_ns() - start) / steps

    def together(self) -> float:
        """Nanoseconds per trajectory-step of a tile."""
        work = self.work.copy()
        start = time.perf_counter_ns()
        self.lanes(work, self.out, self.p, H, STEPS, STEPS + 1, STEPS + 1, 0)
        spent = (time.perf_counter_ns() - start) / STEPS / TILE
        if not np.isfinite(work).all():
            raise RuntimeError(f"{self.name}: a trajectory left the fast path; its time would tell nothing")
        return spent

    def threaded(self, threads: int, steps: int) -> float:
        """Seconds for two groups of tiles on so many threads, through the engine's front door."""
        run = EnsembleRun(self.top, self.method, self.y0, H, steps, steps, made=lambda piece: None, threads=threads)
        for _ in run:
            pass
        return run.run_seconds


def ratio(times: list[float], others: list[float]) -> dict[str, float]:
    """The median of the ratios, and the ratio of the least times."""
    return {
        "median": statistics.median([a / b for a, b in zip(times, others, strict=True)]),
        "least": min(times) / min(others),
    }


def measure(repetitions: int) -> list[dict[str, Any]]:
    """The table."""
    straightforward = loop_of(Stepper(hk_block, 6), 6, 1)
    out, p = np.empty(6), np.ones(1)

    def baseline() -> float:
        work, steps = np.array(GEN), STEPS
        start = time.perf_counter_ns()
        straightforward.drive(work, out, p, H, steps, steps + 1, steps + 1)
        return (time.perf_counter_ns() - start) / steps

    cases = [Case(*case) for case in CASES]
    spent: list[tuple[list[float], list[float], list[float]]] = [([], [], []) for _ in cases]
    for repetition in range(repetitions + 1):
        for case, (base, alone, together) in zip(cases, spent, strict=True):
            times = baseline(), case.alone(), case.together()
            if repetition:  # the first one warms up
                for kept, value in zip((base, alone, together), times, strict=True):
                    kept.append(value)
    rows = []
    for case, (base, alone, together) in zip(cases, spent, strict=True):
        steps = max(1, int(3e7 / (min(together) * len(case.y0))))
        pairs = [(case.threaded(1, steps), case.threaded(2, steps)) for _ in range(repetitions)]
        rows.append(
            {
                "scheme": case.name,
                "top": case.form,
                "vector": case.vector,
                "ns": min(together),
                "to_straightforward_hk": ratio(together, base),
                "to_itself_alone": ratio(together, alone),
                "two_threads": ratio([one for one, _ in pairs], [two for _, two in pairs]),
            }
        )
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=41)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled afresh, and the user's cache left alone
        rows = measure(arguments.repetitions)
    if arguments.json:
        print(json.dumps({"schema_version": 1, "cpus": os.cpu_count(), "ensembles": rows}, indent=1))
        return
    header = ("ns", "to straightforward HK (least)", "to itself alone (least)", "two threads (best)", "vector")
    print(f"{'per trajectory-step and core':<32}" + "  ".join(header))
    for row in rows:
        base, own, two = row["to_straightforward_hk"], row["to_itself_alone"], row["two_threads"]
        print(
            f"{row['scheme'] + ' / ' + row['top']:<30}{row['ns']:>4.1f}"
            f"{base['median']:>21.3f} ({base['least']:.3f}){own['median']:>16.3f} ({own['least']:.3f})"
            f"{two['median']:>13.2f} ({two['least']:.2f})  {row['vector']}"
        )


if __name__ == "__main__":
    main()
