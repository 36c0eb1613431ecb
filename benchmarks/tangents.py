"""Steps with their tangent maps against the steps alone, and the largest Lyapunov exponent against pynamicalsys.

    python benchmarks/tangents.py [--json] [--repetitions 21] [--peer] [--shares]

The first table has a row for each top with a quadratic field: the HK step, and the HK step with a tangent vector,
renormalised and its growth summed up every 64 steps; one orbit, and a tile of 64 side by side, on one core. The
repetitions are interleaved; times are medians in nanoseconds per step of an orbit, ratios medians of those of the
repetitions. The bar is a ratio of 2.5, and 25 ns (one orbit) and 3.5 ns (in a tile) for the Kowalevski top.

With ``--shares``, instead of times, the share of chaotic orbits among 1e5 random ones under HK, after 1e4 steps.
With ``--peer``, pynamicalsys computes the same exponent from the same map, compiled by numba, with its Jacobian.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src"), str(ROOT / "tests")]

from topcli.analysis.lyapunov import growth_of  # noqa: E402
from topcli.engine.ensemble import TILE, EnsembleCode  # noqa: E402
from topcli.engine.loop import loop_of  # noqa: E402
from topcli.engine.tangent import TangentRun, tangent_code  # noqa: E402
from topcli.field.polynomial import NotPolynomialError, field_of  # noqa: E402
from topcli.figures.chaos import chaotic_share, growth_under, random_orbits  # noqa: E402
from topcli.schemes.registry import all_schemes, find_scheme  # noqa: E402
from topcli.tops import TOPS  # noqa: E402

H, STEPS, EVERY = 0.05, 19_200, 64


def quadratic_forms() -> list[str]:
    """Forms of the tops with a quadratic field and the scheme hk."""
    found = []
    fitting = {one.top for one in all_schemes() if one.name == "hk"}
    for form, declared in TOPS.items():
        if form not in fitting:
            continue
        try:
            found += [form] if max(rate.degree for rate in field_of(declared.new())) == 2 else []
        except NotPolynomialError:
            continue
    return found


def works(form: str) -> dict[str, tuple[Callable[[], Any], int]]:
    """Calls that are timed for a top, each with its number of steps."""
    top, scheme = TOPS[form].new(), find_scheme("hk", form)
    method, d = scheme.build(top, scheme.options()), len(top.components)
    rng = np.random.default_rng(1)
    y, v = 0.3 * rng.normal(size=(TILE, d)), rng.normal(size=(TILE, d))
    p = np.array(top.constants())
    loop, end, work = loop_of(method, d, len(p)), np.empty(d), None
    work = np.zeros(loop.width)
    loop.enter(y[0], work, p, H)
    lanes = EnsembleCode(top, method, TILE).lanes
    assert lanes is not None
    together = np.zeros((method.width + 1, TILE))
    together[:-1] = np.array([method.enter(tuple(one), H, tuple(p)) if method.enter else tuple(one) for one in y]).T
    ends = np.empty(TILE * d)
    alone = TangentRun(tangent_code(scheme, top, method, 1), H, y[:1], v[:1])
    tile = TangentRun(tangent_code(scheme, top, method, TILE), H, y, v)
    few = STEPS // TILE
    return {
        "step": (lambda: loop.drive(work, end, p, H, STEPS, STEPS, STEPS), STEPS),
        "step, tile": (lambda: lanes.code(together, ends, lanes.params, H, few, few, few, d), few * TILE),
        "tangent": (lambda: alone.advance(STEPS // EVERY, EVERY), STEPS),
        "tangent, tile": (lambda: tile.advance(few // EVERY + 1, EVERY), (few // EVERY + 1) * EVERY * TILE),
    }


def row_of(form: str, repetitions: int) -> dict[str, Any]:
    """Times and ratios of a top."""
    spent: dict[str, list[float]] = {}
    timed = works(form)
    for _ in range(repetitions):
        for name, (call, steps) in timed.items():
            start = time.perf_counter()
            call()
            spent.setdefault(name, []).append((time.perf_counter() - start) / steps * 1e9)
    times = {name: statistics.median(values) for name, values in spent.items()}
    ratios = {
        name: statistics.median(a / b for a, b in zip(spent[f"tangent{name}"], spent[f"step{name}"], strict=True))
        for name in ("", ", tile")
    }
    return {"top": form, **times, "ratio": ratios[""], "ratio, tile": ratios[", tile"]}


def peer(steps: int = 100_000) -> dict[str, Any]:
    """Exponents of the same orbits by topcli and by pynamicalsys, and nanoseconds per step."""
    from numba import njit
    from pynamicalsys import DiscreteDynamicalSystem

    top, scheme, h = TOPS["kowalevski"].new(), find_scheme("hk", "kowalevski"), 0.3
    method, c, d = scheme.build(top, scheme.options()), top.constants()[0], 0.15

    @njit
    def slope(y):
        w1, w2, w3, g1, g2, g3 = y
        return np.array(
            [
                [0.0, 0.5 * w3, 0.5 * w2, 0.0, 0.0, 0.0],
                [-0.5 * w3, 0.0, -0.5 * w1, 0.0, 0.0, 0.5 * c],
                [0.0, 0.0, 0.0, 0.0, -c, 0.0],
                [0.0, -g3, g2, 0.0, w3, -w2],
                [g3, 0.0, -g1, -w3, 0.0, w1],
                [-g2, g1, 0.0, w2, -w1, 0.0],
            ]
        )

    @njit
    def rates(y):
        w1, w2, w3, g1, g2, g3 = y
        first = np.array([0.5 * w2 * w3, -0.5 * w3 * w1 + 0.5 * c * g3, -c * g2])
        return np.append(first, np.array([w3 * g2 - w2 * g3, w1 * g3 - w3 * g1, w2 * g1 - w1 * g2]))

    @njit
    def mapping(y, parameters):
        return y + 2.0 * np.linalg.solve(np.eye(6) - d * slope(y), d * rates(y))

    @njit
    def jacobian(y, parameters, *more):
        return np.linalg.solve(np.eye(6) - d * slope(y), np.eye(6) + d * slope(mapping(y, parameters)))

    other = DiscreteDynamicalSystem(mapping=mapping, jacobian=jacobian, system_dimension=6, number_of_parameters=1)
    rng, rows = np.random.default_rng(7), []
    other.lyapunov(np.ones(6), 10, parameters=np.array([0.0]), num_exponents=1)
    for _ in range(4):
        y = rng.normal(size=6) * np.array([1.5, 1.5, 1.5, 1.0, 1.0, 1.0])
        y[3:] /= np.linalg.norm(y[3:])
        own = growth_of(top, scheme, method, h, steps, y[None])
        run = TangentRun(tangent_code(scheme, top, method, 1), h, y[None], np.ones((1, 6)))
        start = time.perf_counter()
        run.advance(steps // EVERY, EVERY)
        middle = time.perf_counter()
        theirs = other.lyapunov(y, steps, parameters=np.array([0.0]), num_exponents=1)
        end = time.perf_counter()
        rows.append(
            {
                "topcli": float(own.exponents[0]),
                "error": float(own.errors[0]),
                "pynamicalsys": float(np.ravel(theirs)[0]) / h,
                "ns": (middle - start) / steps * 1e9,
                "their ns": (end - middle) / steps * 1e9,
            }
        )
    return {"steps": steps, "h": h, "orbits": rows}


def show_shares(count: int = 100_000) -> None:
    """Print the shares of chaotic orbits of three step sizes in percent, and the time of each."""
    y = random_orbits(count)
    for h in (0.1, 0.3, 0.6):
        start = time.perf_counter()
        share, error = chaotic_share(growth_under("hk", "kowalevski", h, 10_000, y))
        print(f"h = {h}: {100 * share:.2f} +- {100 * error:.2f} % chaotic, {time.perf_counter() - start:.1f} s")


def main() -> None:
    """Time and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repetitions", type=int, default=21)
    parser.add_argument("--peer", action="store_true")
    parser.add_argument("--shares", action="store_true")
    arguments = parser.parse_args()
    if arguments.shares:
        show_shares()
        return
    rows = [row_of(form, arguments.repetitions) for form in quadratic_forms()]
    against = peer() if arguments.peer else None
    if arguments.json:
        print(json.dumps({"rows": rows, "peer": against}))
        return
    print(f"{'top':<22}{'step':>8}{'tangent':>9}{'ratio':>7}{'tile: step':>12}{'tangent':>9}{'ratio':>7}")
    for row in rows:
        print(
            f"{row['top']:<22}{row['step']:>8.1f}{row['tangent']:>9.1f}{row['ratio']:>7.2f}"
            f"{row['step, tile']:>12.2f}{row['tangent, tile']:>9.2f}{row['ratio, tile']:>7.2f}"
        )
    for orbit in against["orbits"] if against else []:
        print("  ".join(f"{name} {value:.4g}" for name, value in orbit.items()))


if __name__ == "__main__":
    main()
