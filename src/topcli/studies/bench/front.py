"""The front in words and numbers: the fastest at each decade of error, the next, and their ratio."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from topcli.analysis.pareto import Point, at_error, pareto_front

DECADES = tuple(float(f"1e-{n}") for n in range(3, 13))
"""Errors for which the front is described."""
BASELINE = "scipy dop853"
"""The well-known baseline: SciPy with its right-hand side in Python."""
LEVEL = 1.05
"""Competitors within this factor of each other are called level."""
SETUP = 1e-3
"""Set-ups that take longer than this, in seconds, are mentioned."""

Competitor = dict[str, Any]


def points_of(competitor: Competitor) -> list[Point]:
    """Points of a competitor in a result with a finite error; JSON stores the others as null."""
    return [
        Point(row["error"], row["seconds"], row["value"]) for row in competitor["points"] if row["error"] is not None
    ]


def setting(parameter: str, value: float) -> str:
    """Text of a setting: ``h=0.042``, ``tol=1e-9``."""
    if value >= 1e-3:
        return f"{parameter}={value:.2g}"
    return f"{parameter}={value:.1e}".replace("e-0", "e-").replace(".0e", "e")


def ratio_text(ratio: float) -> str:
    """Text of a ratio of times, to two digits, without an exponent."""
    return f"{float(f'{ratio:.2g}'):g}"


def _entry(competitor: Competitor, point: Point) -> dict[str, Any]:
    return {
        "name": competitor["name"],
        "parameter": competitor["parameter"],
        "value": point.setting,
        "setting": setting(competitor["parameter"], point.setting),
        "seconds": point.seconds,
        "setup_seconds": competitor["setup_seconds"],
    }


def ranking(competitors: Sequence[Competitor], error: float) -> list[dict[str, Any]]:
    """Competitors that reach ``error``, fastest first, each with its setting and its seconds per unit of time."""
    found = []
    for competitor in competitors:
        point = at_error(points_of(competitor), error)
        if point is not None:
            found.append(_entry(competitor, point))
    return sorted(found, key=lambda entry: (entry["seconds"], entry["name"]))


def _after(ranked: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the fastest entry that is not a variant of the best, that is the same program with other settings."""
    return next((entry for entry in ranked[1:] if _program(entry) != _program(ranked[0])), None)


def _program(entry: dict[str, Any]) -> str:
    """Name of an entry without its settings: ``backlund:nodes=exact`` and ``backlund`` are one program."""
    return entry["name"].partition(":")[0].partition(" ")[0]


def _words(error: float, ranked: Sequence[dict[str, Any]]) -> str:
    wanted = f"for an error of 1e{math.log10(error):.0f}"
    if not ranked:
        return f"{wanted}: nothing measured reaches it"
    best, after = ranked[0], _after(ranked)
    taken = f"{wanted} take {best['name']} with {best['setting']}"
    if best["setup_seconds"] > SETUP:
        taken += f", after a set-up of {1e3 * best['setup_seconds']:.2g} ms for each initial state"
    if after is None:
        return f"{taken}: nothing else reaches it"
    times = after["seconds"] / best["seconds"]
    much = "level with" if times < LEVEL else f"{ratio_text(times)} times faster than"
    return f"{taken}: {much} the next, {after['name']} ({after['setting']})"


def decade_rows(competitors: Sequence[Competitor]) -> list[dict[str, Any]]:
    """Return for each decade of error the best of all and the next, the best of ours and of the peers, and ratios.

    ``ratio`` is the time of the best peer, and ``baseline_ratio`` that of SciPy's DOP853 with a Python right-hand side,
    over the time of our best; None if either does not reach the error.
    """
    rows = []
    for error in DECADES:
        ranked = ranking(competitors, error)
        kinds = {competitor["name"]: competitor["kind"] for competitor in competitors}
        ours = next((entry for entry in ranked if kinds[entry["name"]] == "topcli"), None)
        peer = next((entry for entry in ranked if kinds[entry["name"]] == "peer"), None)
        known = next((entry for entry in ranked if entry["name"] == BASELINE), None)
        rows.append(
            {
                "error": error,
                "best": ranked[0] if ranked else None,
                "next": _after(ranked),
                "topcli": ours,
                "peer": peer,
                "ratio": peer["seconds"] / ours["seconds"] if ours and peer else None,
                "baseline_ratio": known["seconds"] / ours["seconds"] if ours and known else None,
                "words": _words(error, ranked),
            }
        )
    return rows


def front(competitors: Sequence[Competitor]) -> list[dict[str, Any]]:
    """Return the measured points that no other beats in both error and time, by decreasing error."""
    named = [(competitor, point) for competitor in competitors for point in points_of(competitor)]
    kept = pareto_front([point for _, point in named])
    return [{**_entry(*named[i]), "error": named[i][1].error, "kind": named[i][0]["kind"]} for i in kept]
