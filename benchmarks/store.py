"""Time to write a series as Parquet and size of the file, over those of pyarrow with its default settings.

    python benchmarks/store.py [--repetitions 15]

The bars are 0.3 for the time and 0.6 for the size. The file must hold the same bits.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import pyarrow.parquet as pq

import topcli
from topcli.engine.columns import column_names
from topcli.store.series import arrow_table, parquet_options


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=15)
    repetitions = parser.parse_args().repetitions
    trajectory = topcli.simulate("kowalevski_hybrid")
    data = {name: trajectory[name] for name in column_names(trajectory.top)}
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = Path(folder) / "ours.parquet", Path(folder) / "theirs.parquet"
        for _ in range(repetitions + 1):
            start = time.perf_counter()
            pq.write_table(arrow_table(data), ours, **parquet_options(data))
            middle = time.perf_counter()
            pq.write_table(arrow_table(data), theirs)
            ratios.append((middle - start) / (time.perf_counter() - middle))
        stored = pq.read_table(ours)
        exact = all((stored.column(name).to_numpy() == values).all() for name, values in data.items())
        size = ours.stat().st_size / theirs.stat().st_size
    print(
        f"{len(trajectory)} rows of {len(data)} columns: {statistics.median(ratios[1:]):.2f} of the time, "
        f"{size:.2f} of the size of pyarrow's defaults; bit-exact: {exact}"
    )


if __name__ == "__main__":
    main()
