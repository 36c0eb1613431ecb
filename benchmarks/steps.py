"""One step of HK and of the hybrid: against their straightforward forms, against C, and their round-off.

    python benchmarks/steps.py [--json] [--repetitions 41] [--round-off]

All forms go through the engine's own loop and compiler. The repetitions are interleaved, and every figure is the
median over them of the time divided by the baseline's of the same repetition, with the quartiles. ``--round-off``
adds the growth of gamma²'s round-off; it takes a minute or two.

HK does not conserve gamma², which oscillates by far more than round-off. A weighted mean over a long window, with
a weight that vanishes with all its derivatives at both ends, removes a quasi-periodic oscillation down to round-off;
the rest is the drift, whose root mean square over a lag of N steps is fitted by a power of N.
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
from typing import Any

import numpy as np
from c_peer import compiled
from plain_steps import hk_block, hybrid_cmath, hybrid_polar
from ratios import ratio_rows, show_rows

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / part) for part in ("tests", "tests/support", "src")]

from topcli.contracts import Stepper  # noqa: E402
from topcli.engine.loop import loop_of  # noqa: E402
from topcli.engine.native import native  # noqa: E402
from topcli.schemes.registry import find_scheme  # noqa: E402
from topcli.tops.kowalevski import Kowalevski  # noqa: E402

GEN = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
H, STEPS = 0.01, 100_000

Run = Callable[[np.ndarray, float, int], None]
"""Advances a state in place by a number of steps of size h, with c = 1."""


def in_engine(stepper: Stepper) -> Run:
    """The engine's loop, nothing recorded."""
    loop = loop_of(stepper, 6, 1)
    work, out, params = np.zeros(loop.width), np.empty(6), np.ones(1)

    def run(y: np.ndarray, h: float, n: int) -> None:
        loop.enter(y, work, params, h)
        if loop.drive(work, out, params, h, n, n + 1, n + 1) != n:
            raise RuntimeError("blew up")
        y[:] = work[:6]

    return run


BEGUN = {  # a state and its counters, by the number of both
    6: lambda y: (y[0], y[1], y[2], y[3], y[4], y[5]),
    7: lambda y: (y[0], y[1], y[2], y[3], y[4], y[5], 0.0),
    8: lambda y: (y[0], y[1], y[2], y[3], y[4], y[5], 0.0, 0.0),
}


def without_check(stepper: Stepper) -> Run:
    """A bare loop: what the engine's finite check and recording cost."""
    step, begun = stepper.step, BEGUN[stepper.width]

    def loop(y, params, h, n):
        s = begun(y)
        p = (params[0],)
        for _ in range(n):
            s = step(s, h, p)
        y[0], y[1], y[2], y[3], y[4], y[5] = s[:6]
        return 0

    compiled, params = native(loop, "ppdq"), np.ones(1)
    return lambda y, h, n: compiled(y, params, h, n) and None


def in_c(folder: Path) -> tuple[dict[tuple[str, str], Run], str | None]:
    """The forms of steps.c by (scheme, compiler), or the reason why there are none."""
    calls, reason = compiled("steps.c", ("hk", "hybrid"), "pddq", folder)
    return {key: lambda y, h, n, call=call: call(y.ctypes.data, h, 1.0, n) for key, call in calls.items()}, reason


def last(run: Run, h: float, n: int) -> np.ndarray:
    y = np.array(GEN)
    run(y, h, n)
    return y


def timed(forms: dict[str, Run], repetitions: int) -> dict[str, list[float]]:
    """Nanoseconds per step of every form in every repetition, in an order that rotates."""
    names, spent = list(forms), {name: [] for name in forms}
    for repetition in range(repetitions + 1):
        for name in names[repetition % len(names) :] + names[: repetition % len(names)]:
            y = np.array(GEN)
            start = time.perf_counter_ns()
            forms[name](y, H, STEPS)
            spent[name].append((time.perf_counter_ns() - start) / STEPS)
    return {name: values[1:] for name, values in spent.items()}  # the first repetition warms up


def compare(
    scheme: str, twins: dict[str, Any], c_forms: dict[tuple[str, str], Run], repetitions: int
) -> dict[str, Any]:
    """Times of the scheme and of its other forms; ratios are the scheme's time over theirs."""
    top = Kowalevski()
    found = find_scheme(scheme, top.kind)
    stepper = found.build(top, found.options())
    forms = {scheme: in_engine(stepper), "without the finite check": without_check(stepper)}
    forms |= {name: in_engine(Stepper(step, 6)) for name, step in twins.items()}
    forms |= {name: run for (which, name), run in c_forms.items() if which == scheme}
    ends = {name: last(run, 0.1, 20) for name, run in forms.items()}
    for name, end in ends.items():
        exact = name == "without the finite check" or name.endswith("contract=off")
        if not (np.array_equal(end, ends[scheme]) if exact else np.allclose(end, ends[scheme], rtol=0, atol=1e-12)):
            raise RuntimeError(f"{scheme}: {name} computes something else: {end} against {ends[scheme]}")
    spent = timed(forms, repetitions)
    return {"scheme": scheme, "baseline": next(iter(twins)), "forms": ratio_rows(spent, scheme)}


def window_means(stepper: Stepper, y0: np.ndarray, h: float, windows: int, length: int) -> np.ndarray:
    """Weighted means of gamma² - 1 over consecutive windows of ``length`` steps."""
    drive = loop_of(stepper, 6, 1).drive
    x = (np.arange(length) + 1) / (length + 1)
    weight = np.exp(-1.0 / (x * (1.0 - x)))
    weight /= weight.sum()
    work, out, params, means = y0.copy(), np.empty((length, 6)), np.ones(1), np.empty(windows)
    for i in range(windows):
        drive(work, out.reshape(-1), params, h, length, 1, 1)
        means[i] = np.sum(weight * (np.square(out[:, 3:]).sum(axis=1) - 1.0))
    return means


def growth(stepper: Stepper, h: float, orbits: int, windows: int, duration: float) -> dict[str, Any]:
    """Growth of the round-off of gamma²: rms over lags, median over random orbits, exponent of the fitted power."""
    random = np.random.default_rng(2)
    length = round(duration / h)
    lags = np.unique(np.geomspace(1, windows // 4, 8).astype(int))
    rms = []
    for _ in range(orbits):
        gamma = random.normal(size=3)
        y0 = np.concatenate([random.normal(size=3), gamma / np.linalg.norm(gamma)])
        means = window_means(stepper, y0, h, windows, length)
        rms.append([np.sqrt(np.mean((means[k:] - means[:-k]) ** 2)) for k in lags])
    middle = np.median(rms, axis=0)
    exponent = np.polyfit(np.log(lags), np.log(middle), 1)[0]
    return {
        "h": h,
        "steps": windows * length,
        "orbits": orbits,
        "lag_steps": [int(k * length) for k in lags],
        "rms": [float(x) for x in middle],
        "exponent": float(exponent),
    }


def round_off() -> list[dict[str, Any]]:
    """Growth for HK and for its twin at several step sizes."""
    found = find_scheme("hk", "kowalevski")
    fast, twin = found.build(Kowalevski(), found.options()), Stepper(hk_block, 6)
    return [
        {"form": name} | growth(stepper, h, 9, 64, 4000.0)
        for h in (0.04, 0.02, 0.01)
        for name, stepper in (("hk", fast), ("block elimination", twin))
    ]


def show(results: dict[str, Any]) -> None:
    """The table."""
    for name in results["skipped"]:
        print(f"skipped: {name}")
    for table in results["steps"]:
        print(f"\n{table['scheme']:<28}{'ns/step':>9}   {table['scheme']}'s time over this (quartiles)")
        show_rows(table["forms"])
    for row in results["round_off"]:
        print(
            f"round-off of gamma², {row['form']}, h = {row['h']}: {row['rms'][0]:.1e} after {row['lag_steps'][0]:.0e} "
            f"steps, {row['rms'][-1]:.1e} after {row['lag_steps'][-1]:.0e}; grows as N^{row['exponent']:.2f}"
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=41)
    parser.add_argument("--round-off", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled again; the user's cache is not touched
        c_forms, reason = in_c(Path(folder))
        results = {
            "schema_version": 1,
            "skipped": [reason] if reason else [],
            "steps": [
                compare("hk", {"block elimination": hk_block}, c_forms, arguments.repetitions),
                compare(
                    "hybrid",
                    {"polar form, libm": hybrid_polar, "cmath form": hybrid_cmath},
                    c_forms,
                    arguments.repetitions,
                ),
            ],
            "round_off": round_off() if arguments.round_off else [],
        }
    if arguments.json:
        print(json.dumps(results, indent=1))
    else:
        show(results)


if __name__ == "__main__":
    main()
