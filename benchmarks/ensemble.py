"""Ensembles: the time of one trajectory-step and core, against single trajectories, and what a second thread adds.

    python benchmarks/ensemble.py [--json] [--repetitions 41]

The baseline is one step of the straightforward HK scheme (block elimination, ``hk_block``) in the engine's time
loop, as in ``benchmarks/steps.py``; the second ratio is against the same scheme's own step in that loop. Repetitions
are interleaved; every figure is the median over them of the ratio, with the ratio of the least times beside it. Nothing
is recorded. Two threads need two idle CPUs: on a busy machine only the best of many short runs is meaningful.
``vector`` is the widest register in the machine code of the loop over the lanes, ``products`` how many vector
multiplications, fused ones too, are in it, and ``of limit`` the time of as many multiplications alone,
measured in the same process, over the loop's: near 1, only fewer products help. Divisions and roots, which take up
the same units, are not in it. Narrower vectors are measured with NUMBA_CPU_NAME and NUMBA_CPU_FEATURES set to an older
machine's: haswell and +sse,+sse2,+sse3,+ssse3,+sse4.1,+sse4.2,+avx,+avx2,+fma.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / part) for part in ("tests", "tests/support", "src")]

from plain_steps import hk_block  # noqa: E402

from conftest import GEN, random_states  # noqa: E402
from topcli.contracts import Stepper  # noqa: E402
from topcli.engine import native as compiler  # noqa: E402
from topcli.engine.ensemble import GROUP, TILE, EnsembleRun, Execution  # noqa: E402
from topcli.engine.loop import loop_of, more_parameters  # noqa: E402
from topcli.engine.native import native  # noqa: E402
from topcli.engine.tile import LANES_SIGNATURE, plain_lanes  # noqa: E402
from topcli.schemes.registry import find_scheme  # noqa: E402
from topcli.tops import TOPS  # noqa: E402

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
    ("splitting", "kowalevski"),
    ("splitting", "heavy"),
    ("dmv", "heavy"),
)


@dataclass(frozen=True)
class Code:
    """The loop over the lanes in machine code: bits of its widest register, vector products in it."""

    bits: int
    products: int


def code_of(lanes: Any, rows: int) -> Code:
    """Counts of operations in the machine code of the loop over the lanes.

    The loop is taken to be its longest stretch without a label. If that treats several vectors in turn, it stores
    several times to each of the ``rows`` of the work.
    """
    ir = compiler._compile(lanes, LANES_SIGNATURE, True).inspect_llvm()
    llvm, _ = compiler._machine()
    text = compiler._target_machine().emit_assembly(llvm.parse_assembly(ir))
    stretches = re.split(r"^\.?\w+:", text, flags=re.MULTILINE)
    for name, bits in (("zmm", 512), ("ymm", 256), ("xmm", 128)):
        product = rf"v?(?:mul|fn?m(?:add|sub)\d*)pd[^\n]*{name}"
        products, stretch = max((len(re.findall(product, stretch)), stretch) for stretch in stretches)
        if products:
            stores = len(re.findall(rf"mov[au]p[ds]\s+%{name}\d+, [^\n]*\((?!%rsp)", stretch))
            return Code(bits, round(products * rows / max(stores, rows)))
    return Code(0, 0)


CHAIN = 12


def products_alone(s: Any, h: float, p: Any) -> Any:
    """A step of nothing but 6 CHAIN products, of which CHAIN wait for each other."""
    x1, x2, x3, x4, x5, x6 = s
    for _ in range(CHAIN):
        x1, x2, x3, x4, x5, x6 = x1 * h, x2 * h, x3 * h, x4 * h, x5 * h, x6 * h
    return (x1, x2, x3, x4, x5, x6)


class Limit:
    """The processor's time for a vector product."""

    def __init__(self) -> None:
        plain = plain_lanes(Stepper(products_alone, 6), 6, 1, TILE)
        self.lanes = native(plain, LANES_SIGNATURE)

    def product(self) -> float:
        """Nanoseconds per product of one trajectory."""
        work, out, params = np.ones((7, TILE)), np.empty(6), np.ones(2)
        start = time.perf_counter_ns()
        self.lanes(work, out, params, 1.0, STEPS, STEPS + 1, STEPS + 1, 0)
        return (time.perf_counter_ns() - start) / STEPS / TILE / (6 * CHAIN)


class Case:
    """One scheme, ready to be timed alone and in lanes."""

    def __init__(self, name: str, form: str) -> None:
        self.name, self.form = name, form
        self.top = TOPS[form].new()
        scheme = find_scheme(name, form)
        method = scheme.build(self.top, scheme.options())
        assert isinstance(method, Stepper)
        self.method, d, p = method, len(self.top.components), self.top.constants()
        self.p, self.more = np.array(p), np.array([*p, *more_parameters(method)])
        self.loop = loop_of(method, d, len(p))
        plain = plain_lanes(method, d, len(p), TILE)
        self.lanes, self.code = native(plain, LANES_SIGNATURE), code_of(plain, method.width + 1)
        self.products = self.code.products * (len(method.stages[1]) if method.stages else 1)
        self.out = np.empty(d * TILE)
        self.y0 = random_states(2 * GROUP * TILE, 3)[:, :d]
        self.work = np.zeros((method.width + 1, TILE))
        one = np.zeros(method.width)
        for j in range(TILE):
            self.loop.enter(self.y0[j], one, self.p, H)
            self.work[:-1, j] = one

    def alone(self) -> float:
        """Nanoseconds per step of one trajectory."""
        work, steps = self.work[:-1, 0].copy(), 10 * STEPS
        start = time.perf_counter_ns()
        self.loop.drive(work, self.out, self.p, H, steps, steps + 1, steps + 1)
        return (time.perf_counter_ns() - start) / steps

    def together(self) -> float:
        """Nanoseconds per trajectory-step of a tile."""
        work = self.work.copy()
        start = time.perf_counter_ns()
        self.lanes(work, self.out, self.more, H, STEPS, STEPS + 1, STEPS + 1, 0)
        spent = (time.perf_counter_ns() - start) / STEPS / TILE
        if not np.isfinite(work).all():
            raise RuntimeError(f"{self.name}: a trajectory left the fast path; its time would tell nothing")
        return spent

    def threaded(self, threads: int, steps: int) -> float:
        """Seconds for two groups of tiles on this many threads, through the engine's front door."""
        run = EnsembleRun(
            self.top,
            self.method,
            self.y0,
            H,
            steps,
            steps,
            on_piece=lambda piece: None,
            execution=Execution(threads=threads),
        )
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
        work, steps = np.array(GEN), 10 * STEPS
        start = time.perf_counter_ns()
        straightforward.drive(work, out, p, H, steps, steps + 1, steps + 1)
        return (time.perf_counter_ns() - start) / steps

    cases, limit = [Case(*case) for case in CASES], Limit()
    spent: list[tuple[list[float], list[float], list[float]]] = [([], [], []) for _ in cases]
    product = math.inf
    for repetition in range(repetitions + 1):
        product = min(product, limit.product())
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
                "vector": case.code.bits,
                "products": case.products,
                "ns": min(together),
                "of_limit": case.products * product / min(together) if case.code.bits else None,
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
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled again; the user's cache is not touched
        rows = measure(arguments.repetitions)
    if arguments.json:
        print(json.dumps({"schema_version": 1, "cpus": os.cpu_count(), "ensembles": rows}, indent=1))
        return
    header = (
        "ns",
        "to straightforward HK (least)",
        "to itself alone (least)",
        "two threads (best)",
        "vector",
        "products",
        "of limit",
    )
    print(f"{'per trajectory-step and core':<32}" + "  ".join(header))
    for row in rows:
        base, own, two = row["to_straightforward_hk"], row["to_itself_alone"], row["two_threads"]
        print(
            f"{row['scheme'] + ' / ' + row['top']:<30}{row['ns']:>4.1f}"
            f"{base['median']:>21.3f} ({base['least']:.3f}){own['median']:>16.3f} ({own['least']:.3f})"
            f"{two['median']:>13.2f} ({two['least']:.2f}){row['vector']:>9}{row['products']:>10}"
            + (f"{row['of_limit']:>10.2f}" if row["of_limit"] else "")
        )


if __name__ == "__main__":
    main()
