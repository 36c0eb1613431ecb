"""Figure ``work-precision``: CPU time against error, from stored reports of ``topcli bench``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from topcli.figures.figure import Columns, NothingMeasuredError, figure
from topcli.figures.labels import legend_below
from topcli.figures.style import looks
from topcli.store.identity import digest_of_texts
from topcli.studies.bench import draw_speed_against_error
from topcli.studies.report import read_record

FOLDER = Path("results") / "bench"
"""Folder of the reports, ``topcli bench --save results/bench/NAME.json``; there is a panel for each."""
POINT_KEYS = ("scheme", "peer", "error", "seconds", "set_up")
"""Keys of the points that are drawn."""


def draw_work_precision(canvas: Any, columns: Columns) -> None:
    """Draw a panel for each scene: our fastest schemes in colours, others in grey."""
    titles = list(dict.fromkeys(key.partition("|")[0] for key in columns))
    rows = -(-len(titles) // 2)
    canvas.set_size_inches(7.0, 1.0 + 2.8 * rows)
    for i, title in enumerate(titles, 1):
        values = zip(*(columns[f"{title}|{key}"] for key in POINT_KEYS), strict=True)
        axes = canvas.add_subplot(rows, min(2, len(titles)), i)
        draw_speed_against_error([dict(zip(POINT_KEYS, row, strict=True)) for row in values], axes, looks)
        axes.set_title(title, loc="left")
    legend_below(canvas, 3)


def stored_digests() -> str:
    """Digest of the stored reports."""
    return digest_of_texts(file.read_text(encoding="utf-8") for file in sorted(FOLDER.glob("*.json")))


@figure("work-precision", "CPU time against error, of topcli and others", draw_work_precision, takes=stored_digests)
def work_precision() -> Columns:
    """Points of all curves, ``scene|key``.

    Raises NothingMeasuredError if no benchmark is stored.
    """
    records = [read_record(file) for file in sorted(FOLDER.glob("*.json"))]
    if not records:
        raise NothingMeasuredError(f"no report in {FOLDER}; topcli bench --save {FOLDER / 'NAME.json'} writes one")
    scenes = {record["config"]["name"]: record["tables"][-1]["rows"] for record in records}
    return {
        f"{name}|{key}": np.array(["" if row[key] is None else row[key] for row in rows])
        for name, rows in scenes.items()
        for key in POINT_KEYS
    }
