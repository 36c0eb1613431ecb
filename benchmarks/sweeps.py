"""Cost of sweeps: rows per second as they grow, memory, cost of a row, and Dask, joblib and one task a row beside it.

    python benchmarks/sweeps.py [--json] [--rows 100 1000 10000 100000] [--million] [--repetitions 5]

``growth``: each sweep is a process of its own on one thread, its rows differ in their initial states and advance in
lanes; the machine code is compiled before. ``rows/s`` are rows per second of processor time, which is that of one core,
after subtracting the start of the process, measured with a sweep of one row; ``ms`` is its inverse and must stay below
0.3; memory must not grow with the rows.

``light`` rows of a hundred steps through one worker of a Dask cluster: ``ms`` each beyond the time on one thread of
this process must stay below 1.

``heavy`` rows, about a millisecond each and with a step size of their own, on two workers: topcli's back end against
one worker, its threads, joblib and plain ``dask.delayed`` with one task a row. The repetitions are interleaved, the
first one warms up; ``best`` is the least time, which other load disturbs the least, and the ratios are medians with
quartiles of topcli's time over the other's in the same repetition. Two workers should be 1.8 times as fast as one.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "benchmarks"), str(ROOT / "src")]

from ratios import quartiles  # noqa: E402

MEASURES = ("max_deviation.energy", "drift.energy")
GENERIC = {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}
OWN = "topcli, two workers"


def light(count: int) -> dict[str, Any]:
    """Sweep file of rows that differ in their initial states."""
    base = {"top": "kowalevski", "initial": GENERIC, "scheme": "hk", "h": 0.01, "N": 100, "output": {"every": 10}}
    random = {"count": count, "seed": 1, "omega": {"sphere": 1}, "gamma": "sphere"}
    return {"name": "light", "base": base, "random": random, "measure": list(MEASURES)}


def heavy(count: int) -> dict[str, Any]:
    """Sweep file of rows that differ in their steps."""
    base = {"top": "kowalevski", "initial": GENERIC, "scheme": "hk", "N": 50_000, "output": {"every": 500}}
    return {
        "name": "heavy",
        "base": base,
        "grid": {"h": {"from": 0.001, "to": 0.01, "count": count}},
        "measure": list(MEASURES),
    }


def worker(count: int) -> None:
    """Run a sweep of light rows; print its figures as JSON."""
    from topcli.config.sweep import load_sweep
    from topcli.sweeps.run import SweepOptions, run_sweep

    with tempfile.TemporaryDirectory() as folder:
        done = run_sweep(load_sweep(light(count)), Path(folder), SweepOptions(confirmed=True, threads=1))
    unit = 1 if sys.platform == "darwin" else 1024
    print(
        json.dumps(
            {
                "rows": done.ran,
                "wall_seconds": done.seconds,
                "cpu_seconds": time.process_time(),
                "peak_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit,
            }
        )
    )


def growth(counts: list[int], repetitions: int) -> list[dict[str, Any]]:
    """Figures of sweeps of growing numbers of rows; the least processor time counts."""

    def once(count: int) -> dict[str, Any]:
        command = [sys.executable, __file__, "--worker", str(count)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
        return json.loads(done.stdout)

    def least(count: int) -> dict[str, Any]:
        times = repetitions if count <= 10_000 else 1
        return min((once(count) for _ in range(times)), key=lambda found: found["cpu_seconds"])

    once(100)  # compiles both loops
    once(1)
    start = least(1)["cpu_seconds"]
    rows = [least(count) for count in counts]
    for row in rows:
        row["ms_each"] = (row["cpu_seconds"] - start) * 1e3 / row["rows"]
    return rows


def rows_of(data: dict[str, Any]) -> list[Any]:
    """Rows of a sweep file."""
    from topcli.config.rows import RowReader
    from topcli.config.sweep import load_sweep

    return list(RowReader(load_sweep(data)).rows())


def through(backend: Any, rows: list[Any], workers: int, scale: int) -> Callable[[], None]:
    """Function that evaluates ``rows`` in the batches that a sweep makes."""
    from topcli.sweeps.row_results import Work, batches

    def run() -> None:
        found = backend(batches(iter(rows), workers, scale), Work(MEASURES), lambda: False)
        if sum(sum(results.done) for _, results in found) != len(rows):
            raise RuntimeError("rows are missing")

    return run


def one_task_a_row(client: Any, rows: list[Any]) -> Callable[[], None]:
    """Function that evaluates ``rows`` by ``dask.delayed``."""
    import dask

    from topcli.sweeps.row_results import results_of_rows

    def run() -> None:
        task = dask.delayed(results_of_rows, pure=False)
        found = client.gather(client.compute([task([row], MEASURES) for row in rows]))
        if sum(sum(results.done) for results in found) != len(rows):
            raise RuntimeError("rows are missing")

    return run


def joblib_task_a_row(rows: list[Any]) -> Callable[[], None] | None:
    """Function that evaluates ``rows`` by joblib in two processes; None without joblib."""
    try:
        import joblib
    except ImportError:
        return None
    from topcli.sweeps.row_results import results_of_rows

    def run() -> None:
        found = joblib.Parallel(n_jobs=2)(joblib.delayed(results_of_rows)([row], MEASURES) for row in rows)
        if sum(sum(results.done) for results in found) != len(rows):
            raise RuntimeError("rows are missing")

    return run


def interleaved(forms: dict[str, Callable[[], None]], repetitions: int) -> dict[str, list[float]]:
    """Seconds of each form in every repetition."""
    names, spent = list(forms), {name: [] for name in forms}
    for repetition in range(repetitions + 1):
        for name in names[repetition % len(names) :] + names[: repetition % len(names)]:
            start = time.perf_counter()
            forms[name]()
            spent[name].append(time.perf_counter() - start)
    return {name: times[1:] for name, times in spent.items()}


def compared(light_rows: int, heavy_rows: int, repetitions: int) -> dict[str, Any]:
    """Figures of light rows through one worker, and of heavy rows in several ways."""
    from topcli.sweeps.cluster import BATCH_SCALE, connected
    from topcli.sweeps.run import in_threads

    few, many = rows_of(heavy(heavy_rows)), rows_of(light(light_rows))
    with ExitStack() as stack:
        one, two = (stack.enter_context(connected(f"local:{count}")) for count in (1, 2))
        spent = interleaved(
            {
                "through one worker": through(one, many, 1, BATCH_SCALE),
                "one thread": through(in_threads(1), many, 1, 1),
            },
            repetitions,
        )
        best = {name: min(times) for name, times in spent.items()}
        beyond = (best["through one worker"] - best["one thread"]) * 1e3 / len(many)
        forms = {
            OWN: through(two, few, 2, BATCH_SCALE),
            "topcli, one worker": through(one, few, 1, BATCH_SCALE),
            "topcli, two threads": through(in_threads(2), few, 2, 1),
            "dask.delayed, a task a row": one_task_a_row(two.client, few),
        }
        by_joblib = joblib_task_a_row(few)
        if by_joblib:
            forms["joblib, a task a row"] = by_joblib
        spent = interleaved(forms, repetitions)
    rows = []
    for name, times in spent.items():
        low, middle, high = quartiles([a / b for a, b in zip(spent[OWN], times, strict=True)])
        best_ms = min(times) * 1e3 / heavy_rows
        rows.append({"form": name, "best_ms": best_ms, "ratio": middle, "quartiles": [low, high]})
    return {
        "light": {"rows": light_rows, **best, "ms_each_beyond": beyond},
        "heavy": {
            "rows": heavy_rows,
            "forms": rows,
            "two_workers_against_one": min(spent["topcli, one worker"]) / min(spent[OWN]),
            "two_workers_against_one_median": statistics.median(
                a / b for a, b in zip(spent["topcli, one worker"], spent[OWN], strict=True)
            ),
        },
    }


def show(found: dict[str, Any]) -> None:
    """Print the figures."""
    print(f"{'rows':>9}{'wall s':>9}{'cpu s':>9}{'MB':>7}{'ms':>9}{'rows/s':>9}")
    for row in found["growth"]:
        print(
            f"{row['rows']:>9}{row['wall_seconds']:>9.2f}{row['cpu_seconds']:>9.2f}{row['peak_bytes'] / 1e6:>7.0f}"
            f"{row['ms_each']:>9.4f}{1e3 / row['ms_each']:>9.0f}"
        )
    print(f"light rows through one worker: {found['light']['ms_each_beyond']:.3f} ms each beyond one thread")
    print(f"heavy rows{'best ms':>27}   ratio")
    for row in found["heavy"]["forms"]:
        low, high = row["quartiles"]
        print(f"  {row['form']:<26}{row['best_ms']:>9.3f}   {row['ratio']:.3f} ({low:.3f} to {high:.3f})")
    if not any("joblib" in row["form"] for row in found["heavy"]["forms"]):
        print("  joblib is not installed")
    print(f"two workers against one: {found['heavy']['two_workers_against_one']:.2f}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, nargs="+", default=[100, 1000, 10_000, 100_000])
    parser.add_argument("--million", action="store_true", help="also a sweep of a million rows")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--worker", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        worker(arguments.worker)
        return
    counts = arguments.rows + [1_000_000] * arguments.million
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled here, and the user's cache left alone
        found = {"growth": growth(counts, arguments.repetitions), **compared(5000, 1000, arguments.repetitions)}
    if arguments.json:
        print(json.dumps({"schema_version": 1, "cpus": os.cpu_count(), **found}, indent=1))
    else:
        show(found)


if __name__ == "__main__":
    main()
