"""Draw the pictures of the documentation into docs/images, with a summary of the data behind them.

    python docs/draw_images.py [PICTURE...] [--folder .]

Experiments that are finished in the folder's ``results`` are not repeated. ``work-precision`` is drawn from the
measurements of ``topcli bench`` and skipped where there are none, unless it is named.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

IMAGES = Path(__file__).resolve().parent / "images"
SUMMARY = IMAGES / "data.json"

SWINGS = "kowalevski_swings --set name=swings --set grid.h=[0.01] --set grid.scheme=[hk,bohlin-a,hybrid,taylor]"
OF_CATALOGUE = (
    *("fig1", "polhodes", "traces", "bifurcation", "period", "long-energy", "torus-points", "chaos"),
    "work-precision",
)
PICTURES: dict[str, tuple[str, ...]] = {
    **{name: (f"plot {name} --format png",) for name in OF_CATALOGUE},
    "compare": ("compare hk bohlin-a bohlin-b bohlin-c hybrid --plot results/figures/compare.png --force",),
    "stress": ("stress --plot results/figures/stress.png --force",),
    "swings": (
        f"sweep {SWINGS}",
        "plot sweep swings --x initial.gamma3 --y first_swing_spacing --by scheme --format png",
    ),
}
"""The pictures, each with the commands that draw it."""
FILES = {"swings": "swings_first_swing_spacing_over_initial.gamma3_by_scheme"}
"""File names of figures that are not called as their pictures are."""
TIMES = "work-precision"
"""Picture of times, which no other machine repeats: its data have no summary."""


def draw(name: str, folder: Path) -> Path:
    """Run the commands that draw the picture ``name`` in a folder; the PNG file."""
    for command in PICTURES[name]:
        words = [sys.executable, "-m", "topcli", *command.split()]
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL, cwd=folder)
    return folder / "results" / "figures" / f"{FILES.get(name, name)}.png"


def summary(data: Path) -> dict[str, Any]:
    """Rows and, for each column of the plotted data, its largest magnitude and its root mean square, to 6 digits."""
    from topcli.figures.figure import stored_columns

    columns = stored_columns(data) or {}
    numbers = {name: values.astype(float) for name, values in columns.items() if values.dtype.kind in "fiu"}
    return {
        name: [
            int(np.isfinite(values).sum()),
            float(f"{np.nanmax(np.abs(values)):.6g}"),
            float(f"{np.sqrt(np.nanmean(values**2)):.6g}"),
        ]
        for name, values in numbers.items()
    }


def _copy_small(source: Path, target: Path) -> None:
    """Copy a picture for print as one for a page: half as many pixels each way, 256 colours."""
    from PIL import Image

    with Image.open(source) as picture:
        half = picture.convert("RGB").resize((picture.width // 2, picture.height // 2), Image.Resampling.LANCZOS)
    half.quantize(256, method=Image.Quantize.MEDIANCUT).save(target, optimize=True)


def _listing(known: dict[str, dict[str, Any]]) -> str:
    """JSON with a line for each column."""
    pictures = (
        f"{json.dumps(name)}: {{\n" + ",\n".join(f"  {json.dumps(key)}: {json.dumps(row)}" for key, row in rows.items())
        for name, rows in sorted(known.items())
    )
    return "{\n" + "\n},\n".join(pictures) + "\n}\n}\n"


def main() -> None:
    """Draw the pictures that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", nargs="*", metavar="PICTURE", help=f"one of {', '.join(PICTURES)}; all by default")
    parser.add_argument("--folder", type=Path, default=Path())
    arguments = parser.parse_args()
    unknown = set(arguments.pictures) - set(PICTURES)
    if unknown:
        parser.error(f"unknown picture {', '.join(sorted(unknown))}; choose from {', '.join(PICTURES)}")
    known = json.loads(SUMMARY.read_text(encoding="utf-8")) if SUMMARY.is_file() else {}
    for name in arguments.pictures or PICTURES:
        if name == TIMES and not arguments.pictures and not (arguments.folder / "results" / "bench").is_dir():
            print(f"{name}: skipped: nothing measured in results/bench; run make bench first")
            continue
        picture = draw(name, arguments.folder)
        _copy_small(picture, IMAGES / f"{name}.png")
        if name != TIMES and picture.with_suffix(".parquet").is_file():
            known[name] = summary(picture.with_suffix(".parquet"))
        print(IMAGES / f"{name}.png")
    SUMMARY.write_text(_listing(known), encoding="utf-8")


if __name__ == "__main__":
    main()
