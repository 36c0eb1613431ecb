"""Draw the pictures of the documentation into docs/images, with a summary of the data behind them.

    python docs/draw_images.py [PICTURE...] [--results results]

Experiments that are finished in the folder of results are not repeated. ``work-precision`` is drawn from the
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

COMPARED = ("hk", "bohlin-a", "bohlin-b", "bohlin-c", "hybrid")
PICTURES: dict[str, tuple[str, ...]] = {
    "fig1": ("plot", "fig1", "--format", "png"),
    "overlay": ("plot", "fig2", "--overlay", "exact", "--format", "png"),
    "polhodes": ("plot", "polhodes", "--format", "png"),
    "nutation": ("plot", "nutation", "--format", "png"),
    "catalogue": ("plot", "catalogue", "--format", "png"),
    "bifurcation": ("plot", "bifurcation", "--format", "png"),
    "torus": ("plot", "torus", "--format", "png"),
    "body": ("plot", "body", "--format", "png"),
    "compare": ("compare", *COMPARED, "--plot", "--force"),
    "period": ("plot", "period", "--format", "png"),
    "swings": ("plot", "swings", "--format", "png"),
    "integrable": ("plot", "integrable", "--format", "png"),
    "torus-points": ("plot", "torus-points", "--format", "png"),
    "chaos": ("plot", "chaos", "--format", "png"),
    "error-and-cost": ("plot", "error-and-cost", "--format", "png"),
    "stress": ("plot", "stress", "--format", "png"),
    "work-precision": ("plot", "work-precision", "--format", "png"),
}
"""The pictures, each with the command that draws it."""
FILES = {"compare": "compare_kowalevski_hk", "overlay": "fig2"}
"""File names of figures that are not called as their pictures are."""
TIMES = ("work-precision", "error-and-cost")
"""Pictures of times, which no other machine repeats: their data have no summary."""


def draw(name: str, results: Path) -> Path:
    """Run the command that draws the picture ``name``; the PNG file."""
    folder = results / "figures"
    where = ("--out", str(folder)) + (("--results", str(results)) if PICTURES[name][0] == "plot" else ())
    subprocess.run([sys.executable, "-m", "topcli", *PICTURES[name], *where], check=True, stdout=subprocess.DEVNULL)
    return folder / f"{FILES.get(name, name)}.png"


def summary(data: Path) -> dict[str, Any]:
    """Rows and, for each column of the plotted data, its largest magnitude and its root mean square, to 6 digits."""
    from topcli.store.series import read_series

    columns = read_series(data)
    numbers = {name: np.asarray(values, dtype=float) for name, values in columns.items()}
    return {
        name: [
            int(np.isfinite(values).sum()),
            float(f"{np.nanmax(np.abs(values)):.6g}"),
            float(f"{np.sqrt(np.nanmean(values**2)):.6g}"),
        ]
        for name, values in numbers.items()
    }


def breaks(study: Path) -> dict[str, list[str]]:
    """For each scheme and top of the stress suite the cases that broke."""
    found: dict[str, list[str]] = {}
    for trial in json.loads(study.read_text(encoding="utf-8"))["trials"]:
        cases = found.setdefault(f"{trial['scheme']} ({trial['top']})", [])
        cases += [trial["case"]] * (trial["outcome"] == "broke")
    return found


def draw_portraits(data: Path) -> None:
    """Draw the panels of the picture of the catalogue one by one, for the pages of its tops."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    from topcli.figures.portraits import PLANES, Portrait
    from topcli.figures.style import STYLE
    from topcli.store.series import read_series

    columns, folder = read_series(data), IMAGES / "tops"
    folder.mkdir(exist_ok=True)
    for form, plane in PLANES.items():
        with mpl.rc_context(fname=STYLE):
            figure = Figure(figsize=(3.6, 2.8), layout="constrained")
            axes = figure.add_subplot()
            Portrait(form, plane).paint(axes, columns, None)
            figure.legend(loc="outside lower center", ncols=3)
            figure.savefig(folder / f"{form}.drawn.png", dpi=200)
        _copy_small(folder / f"{form}.drawn.png", folder / f"{form}.png")
        (folder / f"{form}.drawn.png").unlink()


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
    parser.add_argument("--results", type=Path, default=Path("results"))
    arguments = parser.parse_args()
    unknown = set(arguments.pictures) - set(PICTURES)
    if unknown:
        parser.error(f"unknown picture {', '.join(sorted(unknown))}; choose from {', '.join(PICTURES)}")
    known = json.loads(SUMMARY.read_text(encoding="utf-8")) if SUMMARY.is_file() else {}
    for name in arguments.pictures or PICTURES:
        if name == TIMES[0] and not arguments.pictures and not (arguments.results / "bench").is_dir():
            print(f"{name}: skipped: nothing measured in {arguments.results / 'bench'}; run make bench first")
            continue
        picture = draw(name, arguments.results)
        _copy_small(picture, IMAGES / f"{name}.png")
        if name == "catalogue":
            draw_portraits(picture.with_suffix(".parquet"))
        if name == "stress":
            known[name] = breaks(arguments.results / "stress" / "stress.json")
        elif name not in TIMES:
            known[name] = summary(picture.with_suffix(".parquet"))
        print(IMAGES / f"{name}.png")
    SUMMARY.write_text(_listing(known), encoding="utf-8")


if __name__ == "__main__":
    main()
