"""Comparison of several runs on one page."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from topcli.pages.contents import Cells, Chapter
from topcli.pages.origin import value_text
from topcli.runs.report import comparison_lines
from topcli.runs.resume import OUTSIDE_IDENTITY, flattened


def comparison_of(chapters: Sequence[Chapter]) -> list[Chapter]:
    """Chapters that compare the runs of one top in ``chapters``, one for each top with several runs."""
    tops: dict[str, list[Chapter]] = {}
    for chapter in chapters:
        report = chapter.data.get("report") or {}
        if chapter.kind == "run" and report.get("invariants") and isinstance(report.get("top_title"), str):
            tops.setdefault(report["top_title"], []).append(chapter)
    return [_chapter(title, runs) for title, runs in tops.items() if len(runs) > 1]


def _chapter(title: str, runs: Sequence[Chapter]) -> Chapter:
    chapter = Chapter("Comparison of the runs", "comparison", title)
    chapter.state, chapter.good = f"{len(runs)} runs", all(run.good for run in runs)
    chapter.attempt("comparison", lambda: runs_table(runs))
    return chapter


def runs_table(runs: Sequence[Chapter]) -> Cells:
    """Cells with a column for each run: what differs in their configs, outcomes, and the invariants that they share."""
    reports = [run.data["report"] for run in runs]
    configs = [flattened(run.data["config"]) for run in runs]
    keys = [key for key in dict.fromkeys(key for one in configs for key in one) if key not in OUTSIDE_IDENTITY]
    lines = [
        [key, *(_value(one, key) for one in configs)] for key in keys if len({_value(one, key) for one in configs}) > 1
    ]
    lines.append(["outcome", *(run.state for run in runs)])
    lines.append(["steps", *(value_text(report["step"]) for report in reports)])
    lines.append(["run seconds", *(f"{report['seconds']['run']:.3g}" for report in reports)])
    shared = set.intersection(*({row["name"] for row in report["invariants"]} for report in reports))
    common = [{"invariants": [row for row in report["invariants"] if row["name"] in shared]} for report in reports]
    return Cells(
        "Comparison",
        ["", *(run.title for run in runs)],
        [*lines, *comparison_lines(common)],
        "Keys of the config are listed if the runs differ in them; invariants are those that all runs have.",
        marks={"lost": "bad", "drifting": "middling", "exact": "good"},
    )


def _value(config: dict[str, Any], key: str) -> str:
    return value_text(config.get(key))
