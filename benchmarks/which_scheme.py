"""Put the tables of docs/which-scheme.md up to date with the results of `topcli bench`.

    topcli bench && python benchmarks/which_scheme.py [--results results] && make docs-images ARGS=work-precision

Only the tables between `<!-- decades SCENE -->` or `<!-- drift SCENE H -->` and `<!-- end -->` are replaced.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src")]

from topcli.studies.bench.result import DECADE_TABLE, microseconds, stored_benches  # noqa: E402
from topcli.table import markdown_table, number  # noqa: E402

PAGE = ROOT / "docs" / "which-scheme.md"


def drift_lines(result: dict[str, Any], h: float) -> tuple[list[str], list[list[str]]]:
    """Each scheme of fixed steps at the step nearest to ``h``: cost, error, and the deviation of each invariant."""
    rows = [row for row in result["competitors"] if row["kind"] == "topcli" and row["parameter"] == "h"]
    points = {
        row["name"]: min(row["points"], key=lambda point: abs(math.log(point["value"] / h)))
        for row in rows
        if row["points"]
    }
    invariants = list(next(iter(points.values()))["invariants"])
    header = ["scheme", "h", "µs per step", "µs per unit time", "largest error", *invariants]
    lines = []
    for name, point in points.items():
        times = [microseconds(point["seconds"] * point["value"]), microseconds(point["seconds"])]
        cells = [f"`{name}`", f"{point['value']:.2g}", *times]
        lines.append([*cells, number(point["error"], 2), *(f"{value:.0e}" for value in point["invariants"].values())])
    return header, lines


def filled(page: str, results: dict[str, dict[str, Any]]) -> str:
    """``page`` with every table whose scene is among the ``results`` rewritten."""

    def table(match: re.Match[str]) -> str:
        kind, scene, h = match["kind"], match["scene"], match["h"]
        if scene not in results:
            return match[0]
        if kind == "decades":
            lines = DECADE_TABLE.cells(results[scene]).markdown()
        else:
            header, rows = drift_lines(results[scene], float(h))
            lines = markdown_table([header, *rows])
        return "\n".join([match["head"], *lines, "<!-- end -->"])

    pattern = r"(?P<head><!-- (?P<kind>decades|drift) (?P<scene>\S+)(?: (?P<h>\S+))? -->)\n.*?<!-- end -->"
    return re.sub(pattern, table, page, flags=re.DOTALL)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=Path("results"))
    results = parser.parse_args().results
    found = {report["name"]: report for _, report in stored_benches(results / "bench")}
    if not found:
        sys.exit(f"{results / 'bench'}: nothing measured; run topcli bench first, or name the folder with --results")
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), found), encoding="utf-8")
    print(f"{PAGE}: {', '.join(found)}")


if __name__ == "__main__":
    main()
