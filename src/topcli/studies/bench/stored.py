"""Results of benchmarks on disk, one folder per scene, written whole or not at all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from topcli.errors import RunError, UsageError
from topcli.store.manifest import MANIFEST, StoredRun, stored_runs
from topcli.store.provenance import Commit
from topcli.store.run_folder import RunWriter, require_real
from topcli.store.series import write_table
from topcli.studies.bench.front import ratio_text, setting
from topcli.table import markdown_table, number

POINTS = "points.parquet"
REPORT = "report.json"
SCHEMA_VERSION = 1
_PLAIN = ("value", "error", "end_error", "drift", "seconds", "fastest", "repetitions")


def points_table(result: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the points of a result as columns, one row per point; seconds are per unit of simulated time."""
    pairs = [(competitor, row) for competitor in result["competitors"] for row in competitor["points"]]
    invariants = list(dict.fromkeys(name for _, row in pairs for name in row["invariants"]))
    return {
        **{key: [competitor[key] for competitor, _ in pairs] for key in ("name", "kind", "parameter")},
        **{key: [row[key] for _, row in pairs] for key in _PLAIN},
        "lower_quartile": [row["quartiles"][0] for _, row in pairs],
        "upper_quartile": [row["quartiles"][1] for _, row in pairs],
        **{f"drift_{name}": [row["invariants"].get(name) for _, row in pairs] for name in invariants},
    }


def decade_lines(result: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table of decades, for the terminal and Markdown; times in microseconds."""
    header = ["error", "best topcli", "with", "µs", "best peer", "with", "µs", "ratio", "over scipy"]
    lines = []
    for row in result["decades"]:
        cells = [f"{row['error']:.0e}".replace("e-0", "e-")]
        for entry in (row["topcli"], row["peer"]):
            cells += [entry["name"], entry["setting"], microseconds(entry["seconds"])] if entry else ["–", "–", "–"]
        cells += ["–" if row[key] is None else ratio_text(row[key]) for key in ("ratio", "baseline_ratio")]
        lines.append(cells)
    return header, lines


def point_lines(result: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table of all points."""
    header = ["", "with", "µs per unit time", "quartiles", "max error", "at the end", "largest drift"]
    lines = []
    for competitor in result["competitors"]:
        for row in competitor["points"]:
            lines.append(
                [
                    competitor["name"],
                    setting(competitor["parameter"], row["value"]),
                    microseconds(row["seconds"]),
                    " to ".join(microseconds(q) for q in row["quartiles"]),
                    *(number(row[key]) for key in ("error", "end_error", "drift")),
                ]
            )
    return header, lines


def ladder_lines(result: dict[str, Any]) -> list[str]:
    """Return a line for each competitor: its times to compile or load and to set up, and what ended its ladder."""
    return [
        f"{row['name']}: compiled or loaded in {row['compile_seconds']:.2g} s, set up in {row['setup_seconds']:.2g} s; "
        f"its ladder ended: {row['ended']}"
        for row in result["competitors"]
    ]


def microseconds(seconds: float) -> str:
    """Text of seconds in microseconds, to three digits, without an exponent."""
    return f"{float(f'{1e6 * seconds:.3g}'):g}"


def report_text(result: dict[str, Any]) -> str:
    """Return the text of ``report.md``."""
    (decade_header, decades), (point_header, points) = decade_lines(result), point_lines(result)
    not_measured = [*result["skipped_peers"], *result["failed_peers"], *result["left_out"]]
    lines = [
        f"# {result['name']}: speed against error",
        "",
        f"{result['title']}, t from 0 to {result['duration']:g}, errors at {result['intervals']} times against a "
        f"{result['reference']}. CPU time in microseconds per unit of simulated time, warm; "
        f"{result['environment']['cpu']}.",
        "",
        *markdown_table([decade_header, *decades]),
        "",
        *(f"- {row['words']}." for row in result["decades"]),
        *(
            f"- In closed form, `{row['name']}` is within {number(row['error'])} of the reference at "
            f"{microseconds(row['seconds_per_state'])} µs a state over {row['states']} states{setup_words(row)}."
            for row in result["closed_forms"]
        ),
        *(f"- Not measured: {row['name']} ({row['reason']})." for row in not_measured),
        "",
        "## All points",
        "",
        *markdown_table([point_header, *points]),
        "",
        *(f"- {line}." for line in ladder_lines(result)),
        "",
    ]
    return "\n".join(lines)


def setup_words(row: Mapping[str, Any]) -> str:
    """Time of a closed form's set-up, to follow that of a state; empty if it has none."""
    seconds = row.get("setup_seconds")
    return "" if seconds is None else f", after a set-up of {number(seconds)} s"


def _digest(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def require_bench_folder(out: Path, names: Sequence[str]) -> None:
    """Raise UsageError if ``out`` is the folder of a run, or the place of a result in it is a symbolic link."""
    if (out / MANIFEST).exists():
        raise UsageError(f"--out {out}: is the folder of a run; choose another")
    for name in names:
        require_real(out / name)


def store_bench(
    result: dict[str, Any], code: str, started: str, ended: str, out: Path
) -> tuple[StoredRun, Path | None]:
    """Write a result to ``out/<scene>/``; return its folder and the new place of a different earlier result.

    ``code`` is the digest of the schemes' code. A result of the same problem, competitors and code is replaced; any
    other is renamed, whole. Raises RunError if the result cannot be written; then nothing is kept of it.
    """
    named = sorted(competitor["name"] for competitor in result["competitors"])
    digest = _digest(result["config"], result["duration"], result["intervals"], named)
    with Commit() as commit, RunWriter(out, result["name"]) as writer:
        try:
            about = {"topcli.bench": result["name"], "topcli.digest": digest}
            write_table(writer.folder / POINTS, points_table(result), about)
            text = json.dumps({"schema_version": SCHEMA_VERSION, **result}, indent=1, ensure_ascii=False)
            writer.write(REPORT, text + "\n")
            writer.write("report.md", report_text(result))
            stored = writer.commit(
                {
                    "name": result["name"],
                    "kind": "bench",
                    "digest": digest,
                    "code": code,
                    "outcome": "completed",
                    "series": POINTS,
                    "config": result["config"],
                    "started": started,
                    "ended": ended,
                    "environment": result["environment"],
                    **commit.read(),
                }
            )
        except OSError as error:
            raise writer.failure(error, "nothing was kept of this bench") from error
    return stored, writer.set_aside


def stored_benches(out: Path) -> list[tuple[StoredRun, dict[str, Any]]]:
    """Return the finished results in ``out`` with their reports, without renamed ones.

    Raises RunError for a damaged result.
    """
    found = [run for run in stored_runs(out) if run.manifest.get("kind") == "bench"]
    benches = [(run, run.report()) for run in found if run.folder.name == run.manifest.get("name")]
    for run, report in benches:
        if report.get("schema_version") != SCHEMA_VERSION:
            raise RunError(f"{run.folder}: written by another version of topcli; run topcli bench again")
    return benches
