"""Chapters on studies: comparisons, orders, stress and benchmarks, from their plain data."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from topcli.figures.claims import verdict_category, verdict_panel
from topcli.pages.contents import Block, Cells, Chapter, Picture, Pictures
from topcli.pages.origin import add_files, add_origin, value_text
from topcli.paper.ledger import OURS, PAPER
from topcli.store.manifest import StoredRun
from topcli.studies.bench.stored import decade_lines, point_lines
from topcli.table import number

SIGNS = {"held": "·", "degraded": "o", "broke": "X", "not tried": "–"}
MARKS = {"held": "good", "degraded": "middling", "broke": "bad"}
UNEXPLAINED = ("unexplained", "outlived limit")


def stress_chapter(study: dict[str, Any]) -> Chapter:
    """Chapter on a stress study: a table of outcomes for each top, then every trial that did not hold."""
    chapter = Chapter("Stress", "stress", "schemes in the hard cases of their tops")
    chapter.attempt("outcomes", lambda: _stress_state(chapter, study))
    trials = study["trials"] if isinstance(study["trials"], list) else []
    for top in dict.fromkeys(str(one.get("top")) for one in trials if isinstance(one, dict)):
        chapter.attempt(f"outcomes of {top}", lambda top=top: stress_grid(trials, top))
    chapter.attempt("failures", lambda: _failures(study["trials"]))
    chapter.attempt("questions", lambda: _questions(study["cases"]))
    add_origin(chapter, study, lambda: [(one["top"], str(one["scheme"]).partition(":")[0]) for one in study["trials"]])
    return chapter


def _stress_state(chapter: Chapter, study: Mapping[str, Any]) -> Block | None:
    wrong = sum(one["verdict"] in UNEXPLAINED for one in study["trials"])
    chapter.good = not wrong
    chapter.state = f"{wrong} unexplained" if wrong else "as declared"
    chapter.message = ", ".join(f"{count} {outcome}" for outcome, count in study["outcomes"].items())
    return None


def stress_grid(trials: Sequence[Mapping[str, Any]], top: str) -> Cells:
    """Outcomes of the schemes of one top, a row for each scheme and a column for each case."""
    mine = [one for one in trials if one["top"] == top]
    cases = list(dict.fromkeys(one["case"] for one in mine))
    found: dict[str, dict[str, str]] = {}
    for one in mine:
        found.setdefault(one["scheme"], {})[one["case"]] = one["outcome"]
    lines = [[scheme, *(SIGNS.get(row.get(case, ""), "") for case in cases)] for scheme, row in found.items()]
    signs = ", ".join(f"{sign} {outcome}" for outcome, sign in SIGNS.items())
    marks = {SIGNS[outcome]: kind for outcome, kind in MARKS.items()}
    return Cells(
        f"Outcomes: {top}", ["scheme", *cases], lines, f"{signs}; no sign: not run", numbers=False, marks=marks
    )


def _failures(trials: Sequence[Mapping[str, Any]]) -> Cells | None:
    lines = []
    for one in trials:
        if one["outcome"] in ("degraded", "broke") or one["verdict"] != "ok":
            step = "–" if one["step"] is None else str(one["step"])
            meaning = {"ok": "", "limit": "declared limit"}.get(one["verdict"], one["verdict"])
            lines.append([one["scheme"], one["top"], one["case"], one["outcome"], step, one["why"], meaning])
    header = ["scheme", "top", "case", "outcome", "step", "why", "verdict"]
    bad = dict.fromkeys(UNEXPLAINED, "bad")
    return Cells("Trials that did not hold", header, lines, keys=3, numbers=False, marks=MARKS | bad) if lines else None


def _questions(cases: Sequence[Mapping[str, Any]]) -> Cells:
    lines = [[one["case"], one["top"], one["question"]] for one in cases]
    return Cells("Cases", ["case", "top", "question"], lines, keys=2, numbers=False)


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
    chapter.attempt("best by decade", lambda: Cells("Fastest in each decade of error", *decade_lines(run.report())))
    chapter.attempt("all points", lambda: Cells("All points", *point_lines(run.report())))
    add_origin(chapter, manifest)
    add_files(chapter, run.folder, manifest, damage)
    return chapter
