"""The Taylor series against heyoka's: time at equal error, over several processes.

    python benchmarks/taylor.py [--json] [--processes 5]

Each process times ladders of tolerances, repetitions interleaved, and keeps the least time of each rung; heyoka with
and without ``high_accuracy``, whichever is the faster at the error asked. A code's time is its least
over the processes, since the same call of heyoka varies from one to the next. At each error both are interpolated
(log-log) on their ladder's front, and the ratio of the times taken. The error is the largest of a component at any
of the instants t = 1, 2, ..., of the longest run, where both record the state by their dense output; both are also
timed with the last state alone. References are good to an ulp (``analysis.reference``).
heyoka's steps: llvm optimization level 3 (its default), its order from its tolerance (1e-18 at least).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src")]

from topcli.analysis.reference import reference_states  # noqa: E402
from topcli.contracts import Top  # noqa: E402
from topcli.engine.loop import loop_of  # noqa: E402
from topcli.schemes.any_top.taylor import Tolerance, build  # noqa: E402
from topcli.tops.heavy import Heavy  # noqa: E402
from topcli.tops.kowalevski import Kowalevski  # noqa: E402

GEN = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
PAPER = (2.0, 0.0, 0.0, (1.0 - 1e-6) ** 0.5, 0.0, 1e-3)
SCENES: dict[str, tuple[Top, tuple[float, ...], float]] = {
    "kowalevski gen": (Kowalevski(), GEN, 1000.0),
    "kowalevski paper": (Kowalevski(), PAPER, 50.0),
    "kowalevski other": (Kowalevski(), (-0.3, 1.1, 0.4, 0.6, -0.64, 0.48), 1000.0),
    "heavy regular": (Heavy(), (2.0, 0.5, 0.3, -0.6, -0.48, -0.64), 1000.0),
}
MINE = tuple(10.0**-k for k in range(4, 18))
THEIRS = tuple(10.0**-k for k in range(4, 19))
REPETITIONS = 12


def equations(top: Top, hy: Any) -> list[Any]:
    """The equations of ``top`` as heyoka's expressions, with its parameters as numbers."""
    w1, w2, w3, g1, g2, g3 = v = hy.make_vars("w1", "w2", "w3", "g1", "g2", "g3")
    if isinstance(top, Kowalevski):
        c = top.constants()[0]
        rates = [0.5 * w2 * w3, 0.5 * (c * g3 - w3 * w1), -c * g2]
    else:
        (A, B, C), (x, y, z) = top.euler_poisson().moments, top.euler_poisson().gravity
        rates = [
            (B - C) / A * w2 * w3 + z / A * g2 - y / A * g3,
            (C - A) / B * w3 * w1 + x / B * g3 - z / B * g1,
            (A - B) / C * w1 * w2 + y / C * g1 - x / C * g2,
        ]
    rates += [g2 * w3 - g3 * w2, g3 * w1 - g1 * w3, g1 * w2 - g2 * w1]
    return list(zip(v, rates, strict=True))


def timed(calls: dict[str, Any]) -> dict[str, float]:
    """The least time of each call in milliseconds, repetitions interleaved."""
    least = dict.fromkeys(calls, np.inf)
    for _ in range(REPETITIONS):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            least[name] = min(least[name], 1e3 * (time.perf_counter() - start))
    return least


def series_calls(top: Top, y0: tuple[float, ...], t: float, tol: float) -> tuple[Any, Any]:
    """Calls that follow one trajectory with every t = n recorded, and to its end; both return the states."""
    loop = loop_of(build(top, Tolerance(tol=tol)), 6, len(top.constants()))
    p, rows = np.array(top.constants()), round(t)
    out, first = np.empty((rows, 6)), np.zeros(loop.width)
    loop.enter(np.array(y0), first, p, 1.0)  # the same for every h

    def to(h: float, steps: int) -> np.ndarray:
        assert loop.drive(first.copy(), out.reshape(-1), p, h, steps, 1, 1) == steps
        return out[:steps]

    return lambda: to(1.0, rows), lambda: to(t, 1)


def heyoka_calls(hy: Any, top: Top, y0: tuple[float, ...], t: float, tol: float, careful: bool) -> tuple[Any, Any]:
    """The same by heyoka: propagate_grid and propagate_until."""
    stepper = hy.taylor_adaptive(equations(top, hy), list(y0), tol=tol, high_accuracy=careful)
    grid = np.arange(0.0, t + 0.5)

    def reset() -> None:
        stepper.time = 0.0
        stepper.state[:] = y0

    def all_of_them() -> np.ndarray:
        reset()
        return stepper.propagate_grid(grid)[-1][1:]

    def last() -> np.ndarray:
        reset()
        stepper.propagate_until(t)
        return stepper.state

    return all_of_them, last


def measured() -> dict[str, dict[str, list[tuple[float, float]]]]:
    """In this process: for each scene and each code (error, milliseconds) at each tolerance."""
    try:
        import heyoka as hy
    except ImportError:
        hy = None
    found: dict[str, dict[str, list[tuple[float, float]]]] = {}

    def note(scene: str, calls: dict[str, Any], exact: np.ndarray) -> None:
        errors = {name: float(np.abs(call() - exact).max()) for name, call in calls.items()}
        for name, least in timed(calls).items():
            found.setdefault(scene, {}).setdefault(name.split(" @")[0], []).append((errors[name], least))

    for scene, (top, y0, t) in SCENES.items():
        exact = reference_states(top, y0, np.arange(1.0, t + 0.5))
        for kind, reference in ((0, exact), (1, exact[-1:])):
            calls = {f"topcli @{tol}": series_calls(top, y0, t, tol)[kind] for tol in MINE}
            for tol in THEIRS if hy else ():
                for careful in (False, True):
                    name = f"heyoka{' accurate' * careful} @{tol}"
                    calls[name] = heyoka_calls(hy, top, y0, t, tol, careful)[kind]
            note(f"{scene}, {('every t = n', 'the end')[kind]}", calls, reference)
    return found


def in_processes(count: int) -> dict[str, dict[str, list[tuple[float, float]]]]:
    """Least times over ``count`` processes."""
    best: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for _ in range(count):
        done = subprocess.run([sys.executable, __file__, "--one"], capture_output=True, text=True, check=True)
        for scene, codes in json.loads(done.stdout).items():
            for code, rungs in codes.items():
                before = best.setdefault(scene, {}).get(code, rungs)
                best[scene][code] = [(e, min(a, b)) for (e, a), (_, b) in zip(rungs, before, strict=True)]
    return best


def time_at(rungs: list[tuple[float, float]], error: float) -> float | None:
    """The time at which the front of the rungs reaches ``error``; None where it does not."""
    front: list[tuple[float, float]] = []
    for e, ms in sorted(rungs, key=lambda rung: rung[1]):
        if not front or e < front[-1][0]:
            front.append((e, ms))
    if not front or front[-1][0] > error:
        return None
    if front[0][0] <= error:
        return front[0][1]
    x, y = np.log([e for e, _ in front[::-1]]), np.log([ms for _, ms in front[::-1]])
    return float(np.exp(np.interp(np.log(error), x, y)))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measured()))
        return
    found = in_processes(arguments.processes)
    rows = []
    for scene, codes in found.items():
        theirs = [rung for code, rungs in codes.items() if code != "topcli" for rung in rungs]
        for error in [10.0**-k for k in range(3, 14)]:
            mine, other = time_at(codes["topcli"], error), time_at(theirs, error) if theirs else None
            if mine is not None:
                ratio = mine / other if other else None
                rows.append({"scene": scene, "error": error, "ms": mine, "heyoka_ms": other, "ratio": ratio})
        rows.append({"scene": scene, "least errors": {code: min(e for e, _ in r) for code, r in codes.items()}})
    if arguments.json:
        print(json.dumps({"schema_version": 1, "rows": rows}, indent=1))
        return
    if all("heyoka" not in code for codes in found.values() for code in codes):
        print("heyoka: not installed here, skipped", file=sys.stderr)
    for row in rows:
        if "error" not in row:
            least_errors = ", ".join(f"{code} {least:.1e}" for code, least in row["least errors"].items())
            print(f"{row['scene']:<34} least error: {least_errors}\n")
            continue
        other = f"heyoka {row['heyoka_ms']:7.3f} ms   ratio {row['ratio']:.2f}" if row["ratio"] else "heyoka: -"
        print(f"{row['scene']:<34} error {row['error']:.0e}   topcli {row['ms']:7.3f} ms   {other}")


if __name__ == "__main__":
    main()
