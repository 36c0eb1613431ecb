"""Every further step in the engine against the same algebra in C, with the growth of its round-off beside its speed.

    python benchmarks/steps_more.py [--json] [--repetitions 25] [--steps 1e6] [SCHEME/TOP...]

Repetitions are interleaved and timed by the thread's own clock, which other work on the machine stretches less; ratios
are those of the least times to the least time of C, in the faster of its two forms and in the one that rounds as topcli
does; the bar is 1.1. The C forms take the same working state; the one that rounds
every operation by itself must end on the same bits. Growth is that of ``topcli roundoff`` on a scene of the top, of
the invariant that grows fastest.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from c_peer import FLAGS, HERE, compiled

sys.path[:0] = [str(HERE.parent / "src")]

from topcli.config.load import load_experiment  # noqa: E402
from topcli.config.models import Experiment  # noqa: E402
from topcli.contracts import Stepper  # noqa: E402
from topcli.engine.loop import loop_of  # noqa: E402
from topcli.studies.entries import under_scheme  # noqa: E402
from topcli.studies.roundoff_copies import roundoff_study  # noqa: E402

BAR = 1.1
SAME_ROUNDING = "gcc -ffp-contract=off"
STEPS = 100_000
H = 0.01
GENERIC = "kowalevski_generic_hk"

CASES: dict[str, tuple[str, str, dict[str, bool]]] = {
    "hk_compensated": ("hk", GENERIC, {"compensated": True}),
    "hybrid_xi": ("hybrid-xi", GENERIC, {}),
    "hybrid_xi_compensated": ("hybrid-xi", GENERIC, {"compensated": True}),
    "backlund": ("backlund", GENERIC, {}),
    "bohlin_a": ("bohlin-a", GENERIC, {}),
    "bohlin_b": ("bohlin-b", GENERIC, {}),
    "bohlin_c": ("bohlin-c", GENERIC, {}),
    "hk_heavy": ("hk", "heavy_hk", {}),
    "midpoint": ("midpoint", "heavy_midpoint", {}),
    "hk_lagrange": ("hk", "lagrange_hk", {}),
    "hk_euler_gamma": ("hk", "euler_gamma", {}),
    "splitting_closed": ("splitting", GENERIC, {}),
    "splitting_axes": ("splitting", "heavy_hk", {}),
    "dmv": ("dmv", "heavy_hk", {}),
}
"""The C functions by name: scheme, scene, options."""

SPLIT = ("splitting_closed", "splitting_axes", "dmv")
SOURCES = {"steps_more.c": [name for name in CASES if name not in SPLIT], "steps_splitting.c": list(SPLIT)}

Run = Callable[[np.ndarray, int], None]
"""Advances a working state in place by a number of steps."""


def experiment_of(case: str) -> Experiment:
    scheme, scene, options = CASES[case]
    return under_scheme(load_experiment(scene, [f"h={H}"]), scheme, options)


def forms_of(case: str, c_calls: dict[Any, Any]) -> tuple[np.ndarray, dict[str, Run]]:
    """The working state at the start, and the ways to advance it."""
    experiment = experiment_of(case)
    method, p = experiment.method(), np.array(experiment.top.constants())
    assert isinstance(method, Stepper)
    loop = loop_of(method, len(experiment.y0), len(p))
    start = np.zeros(loop.width)
    loop.enter(np.array(experiment.y0), start, p, H)
    nothing = np.empty(0)

    def engine(work: np.ndarray, n: int) -> None:
        if loop.drive(work, nothing, p, H, n, n + 1, n + 1) != n:
            raise RuntimeError(f"{case}: blew up")

    forms: dict[str, Run] = {"topcli": engine}
    for way in FLAGS:
        if (case, way) in c_calls:
            call = c_calls[case, way]
            forms[way] = lambda work, n, call=call: call(work.ctypes.data, p.ctypes.data, H, n)
    return start, forms


def check(case: str, start: np.ndarray, forms: dict[str, Run]) -> None:
    """Raise RuntimeError where a form computes something else."""
    ends = {}
    for name, run in forms.items():
        ends[name] = start.copy()
        run(ends[name], 50)
    for name, end in ends.items():
        d = 6 if name == "gcc" else len(end)
        same = np.allclose(end[:d], ends["topcli"][:d], rtol=0, atol=1e-11) if name == "gcc" else None
        if not (np.array_equal(end, ends["topcli"], equal_nan=True) if same is None else same):
            raise RuntimeError(f"{case}: {name} computes something else: {end} against {ends['topcli']}")


def timed(start: np.ndarray, forms: dict[str, Run], repetitions: int) -> dict[str, list[float]]:
    """Nanoseconds per step of every form in every repetition, in an order that rotates."""
    names, spent = list(forms), {name: [] for name in forms}
    for repetition in range(repetitions + 1):
        for name in names[repetition % len(names) :] + names[: repetition % len(names)]:
            work = start.copy()
            begin = time.thread_time_ns()
            forms[name](work, STEPS)
            spent[name].append((time.thread_time_ns() - begin) / STEPS)
    return {name: values[1:] for name, values in spent.items()}  # the first repetition warms up


def growth_of(case: str, steps: int) -> dict[str, Any] | None:
    """The fastest growth among the invariants, or None where the scheme claims none and long windows are needed."""
    experiment = experiment_of(case)
    compensated = CASES[case][2].get("compensated", False)
    if not experiment.scheme.conserves and not experiment.modified:
        return None
    form = roundoff_study(experiment, steps, 8)["forms"][1 if compensated else 0]
    rows = [row for row in form["invariants"] if row["exponent"] is not None]
    return max(rows, key=lambda row: row["exponent"])


def measured(case: str, c_calls: dict[Any, Any], repetitions: int, steps: int) -> dict[str, Any]:
    start, forms = forms_of(case, c_calls)
    check(case, start, forms)
    spent = timed(start, forms, repetitions)
    least = {name: min(values) for name, values in spent.items()}
    in_c = {name: value for name, value in least.items() if name != "topcli"}
    return {
        "case": case,
        "ns": least,
        "median_ns": {name: statistics.median(values) for name, values in spent.items()},
        "over_faster_c": least["topcli"] / min(in_c.values()) if in_c else None,
        "over_same_rounding": least["topcli"] / in_c[SAME_ROUNDING] if in_c else None,
        "round_off": growth_of(case, steps),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", default=list(CASES), metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--repetitions", type=int, default=25)
    parser.add_argument("--steps", type=float, default=1e6, help="steps of the fit of round-off's growth")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled again; the user's cache is not touched
        c_calls: dict[Any, Any] = {}
        reason = None
        for source, names in SOURCES.items():
            calls, missing = compiled(source, names, "ppdq", Path(folder))
            c_calls |= calls
            reason = reason or missing
        rows = [
            measured(case, c_calls, arguments.repetitions, int(arguments.steps)) for case in arguments.cases or CASES
        ]
    if arguments.json:
        print(json.dumps({"schema_version": 1, "skipped": [reason] if reason else [], "bar": BAR, "cases": rows}))
        return
    if reason:
        print(f"skipped: {reason}")
    print(f"{'step':<24}{'ns/step':>9}{'gcc':>9}{'no FMA':>9}  over the faster, over no FMA (bar {BAR})  round-off")
    for row in rows:
        ns = [row["ns"].get(name, float("nan")) for name in ("topcli", *FLAGS)]
        grown = row["round_off"]
        exponent = f"N^{grown['exponent']:.2f} ± {grown['exponent_error']:.2f} ({grown['name']})" if grown else "–"
        ratios = [row["over_faster_c"], row["over_same_rounding"]]
        over = "".join(f"{'–':>12}" if ratio is None else f"{ratio:>12.3f}" for ratio in ratios)
        print(f"{row['case']:<24}" + "".join(f"{x:>9.2f}" for x in ns) + over + " " * 18 + exponent)


if __name__ == "__main__":
    main()
