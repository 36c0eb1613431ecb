"""Chapters on studies: comparisons, orders, stress and benchmarks, from their plain data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from topcli.figures.claims import verdict_category, verdict_panel
from topcli.pages.contents import Cells, Chapter, Picture, Pictures
from topcli.pages.origin import add_files, add_origin, value_text
from topcli.paper.ledger import OURS, PAPER
from topcli.store.manifest import StoredRun
from topcli.studies.bench.result import DECADE_TABLE, POINT_TABLE
from topcli.table import number


def claims_chapter(found: dict[str, Any], name: str | None = None) -> Chapter:
    """Chapter on claims of the paper with their verdicts.

    ``name`` is unique within the page; None leaves out pictures.
    """
    chapter = Chapter("Claims of the paper", "claims", "each with the figure that decides it and its bound", "decided")
    chapter.attempt("claims", lambda: _claims(chapter, found["claims"]))
    if name:
        chapter.attempt("pictures", lambda: _claims_picture(found["claims"], name))
    add_origin(chapter, found)
    return chapter


def _claims(chapter: Chapter, claims: Sequence[Mapping[str, Any]]) -> Cells:
    parts = []
    for origin, title in ((PAPER, ""), (OURS, "findings of ours: ")):
        counted = Counter(verdict_category(str(one["verdict"])) for one in claims if one["origin"] == origin)
        if counted:
            parts.append(title + ", ".join(f"{count} {verdict}" for verdict, count in counted.most_common()))
    chapter.message = "; ".join(parts)
    keys = ("id", "origin", "statement", "verdict", "figure", "bound", "source")
    shown = [{**one, "bound": one.get("bound_text", one["bound"])} for one in claims]
    lines = [[_figure(one[key]) for key in keys] for one in shown]
    return Cells("Claims", keys, lines, numbers=False, marks={"holds": "good", "does not hold as stated": "bad"})


def _claims_picture(claims: Sequence[Mapping[str, Any]], name: str) -> Pictures:
    panel, data = verdict_panel(claims)
    caption = "statements with each verdict, by parts of the paper; findings beyond it apart"
    return Pictures([Picture(panel, data, name, caption)])


def _figure(value: object) -> str:
    return number(value) if isinstance(value, float) else value_text(value)


def bench_chapter(run: StoredRun) -> Chapter:
    """Chapter on a benchmark of speed against error."""
    manifest = run.manifest
    chapter = Chapter(manifest["name"], "bench", "speed against error", "measured")
    damage = chapter.check(run)
    chapter.attempt("best by decade", lambda: DECADE_TABLE.cells(run.report()))
    chapter.attempt("all points", lambda: POINT_TABLE.cells(run.report()))
    add_origin(chapter, manifest)
    add_files(chapter, run.folder, manifest, damage)
    return chapter
