"""Writing a series: topcli's Parquet settings against pyarrow's defaults, and the memory of a long run."""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from topcli.analysis.columns import column_names
from topcli.runs.simulate import simulate
from topcli.store.series import arrow_table, write_parquet

ROOT = Path(__file__).resolve().parents[1]

_MEMORY = """
import resource, sys
from topcli.__main__ import main
sys.argv = ["topcli", "run", {config!r}, "--out", {out!r}, "--quiet"]
sys.argv += ["--set", "N=100000000", "--set", "output.every=1000"]
try:
    main()
except SystemExit as leaving:
    assert not leaving.code, leaving.code
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def parquet(repetitions: int) -> dict[str, Any]:
    """Time and size of the hybrid's 50001 rows, relative to ``pyarrow.parquet.write_table`` as it comes."""
    import pyarrow.parquet as pq

    trajectory = simulate(ROOT / "configs" / "kowalevski_hybrid.yaml")
    data = {name: trajectory[name] for name in column_names(trajectory.top)}
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "ours.parquet", Path(folder) / "theirs.parquet"
        pairs = []
        for _ in range(repetitions + 1):
            start = time.perf_counter()
            write_parquet(ours, data, {})
            middle = time.perf_counter()
            pq.write_table(arrow_table(data), theirs)
            pairs.append((middle - start, time.perf_counter() - middle))
        pairs = pairs[1:]
        back = pq.read_table(ours)
        exact = all((back.column(name).to_numpy() == values).all() for name, values in data.items())
        return {
            "rows": len(trajectory),
            "columns": len(data),
            "seconds": statistics.median(a for a, _ in pairs),
            "time_ratio": statistics.median(a / b for a, b in pairs),
            "size_ratio": ours.stat().st_size / theirs.stat().st_size,
            "bytes": ours.stat().st_size,
            "bit_exact": exact,
        }


def memory() -> float:
    """Largest resident memory, in MB, of a run of 1e8 HK steps recorded every 1000."""
    with tempfile.TemporaryDirectory() as out:
        script = _MEMORY.format(config=str(ROOT / "configs" / "kowalevski_hk.yaml"), out=out)
        done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    return float(done.stdout.split()[-1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=15)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    written, megabytes = parquet(arguments.repetitions), memory()
    if arguments.json:
        print(json.dumps({"schema_version": 1, "parquet": written, "memory_mb": megabytes}, indent=1))
        return
    print(
        f"Parquet {written['rows']} x {written['columns']}: {written['time_ratio']:.2f} times the time (bar 0.3) and "
        f"{written['size_ratio']:.2f} times the size (bar 0.6) of pyarrow's defaults; bit-exact: {written['bit_exact']}"
    )
    print(f"1e8 HK steps recorded every 1000: {megabytes:.0f} MB resident at most (bar 300)")


if __name__ == "__main__":
    main()
