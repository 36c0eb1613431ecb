"""Result of a benchmark: the fastest scheme at each error, tables, and the folder on disk."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.errors import RunError, UsageError
from topcli.store.files import json_text
from topcli.store.provenance import git_commit
from topcli.store.result_folder import ResultFolder
from topcli.store.results import MANIFEST, REPORT, StoredResult, stored_results
from topcli.store.series import write_table
from topcli.table import Column, Table, number

MAX_GAP = 100.0
"""Largest ratio of errors of two neighbouring points that are interpolated; beyond it, the finer one counts."""


@dataclass(frozen=True)
class Point:
    """One measurement: the ``error`` reached, the ``seconds`` taken, and the ``setting`` (h or tolerance)."""

    error: float
    seconds: float
    setting: float


def pareto_front(points: Sequence[Point]) -> list[int]:
    """Indices of the points that no other beats or equals in both error and seconds, by decreasing error.

    The first of equal points counts. Points whose error or seconds are not positive and finite are left out; an error
    of 0 is kept.
    """
    usable = [
        i
        for i, point in enumerate(points)
        if math.isfinite(point.error) and point.error >= 0.0 and 0.0 < point.seconds < math.inf
    ]
    front: list[int] = []
    best = math.inf
    for i in sorted(usable, key=lambda i: (points[i].seconds, points[i].error, i)):
        if points[i].error < best:
            best = points[i].error
            front.append(i)
    return front


def _between(low: float, high: float, share: float) -> float:
    """Geometric mean of two positive numbers with the weight ``share`` on ``high``."""
    return math.exp((1.0 - share) * math.log(low) + share * math.log(high))


def at_error(points: Sequence[Point], error: float) -> Point | None:
    """Point of at most the given ``error`` (> 0), interpolated on the front of ``points``.

    The interpolation is linear in the logarithms, as errors are powers of h and of the tolerance. For an error larger
    than that of the cheapest point, it is that point; for one smaller than all, None. Across a gap wider than
    ``MAX_GAP`` it is the finer point.
    """
    front = [points[i] for i in pareto_front(points)]
    if not front or front[-1].error > error:
        return None
    if front[0].error <= error:
        return front[0]
    fine = next(i for i, point in enumerate(front) if point.error <= error)
    a, b = front[fine - 1], front[fine]
    if b.error == 0.0 or a.error > MAX_GAP * b.error or not (a.setting > 0.0 and b.setting > 0.0):
        return b
    share = math.log(a.error / error) / math.log(a.error / b.error)
    return Point(error, _between(a.seconds, b.seconds, share), _between(a.setting, b.setting, share))


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
    reached = [(competitor, at_error(points_of(competitor), error)) for competitor in competitors]
    entries = [_entry(competitor, point) for competitor, point in reached if point is not None]
    return sorted(entries, key=lambda entry: (entry["seconds"], entry["name"]))


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
        ours, peer = (
            next((entry for entry in ranked if kinds[entry["name"]] == kind), None) for kind in ("topcli", "peer")
        )
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


POINTS = "points.parquet"
SCHEMA_VERSION = 1
STORED = ("name", "kind", "parameter", "value", "error", "final_error", "drift", "seconds", "fastest", "repetitions")


def _points(result: dict[str, Any]) -> list[dict[str, Any]]:
    """Points of all competitors, each with the figures of its competitor that name it."""
    named = ("name", "kind", "parameter")
    return [
        {key: competitor[key] for key in named} | row
        for competitor in result["competitors"]
        for row in competitor["points"]
    ]


def points_table(result: dict[str, Any]) -> dict[str, list[Any]]:
    """Return the points of a result as columns, one row per point; seconds are per unit of simulated time."""
    rows = _points(result)
    invariants = list(dict.fromkeys(name for row in rows for name in row["invariants"]))
    return {
        **{key: [row[key] for row in rows] for key in STORED},
        **{f"{name}_quartile": [row["quartiles"][i] for row in rows] for i, name in enumerate(("lower", "upper"))},
        **{f"drift_{name}": [row["invariants"].get(name) for row in rows] for name in invariants},
    }


def microseconds(seconds: float) -> str:
    """Text of seconds in microseconds, to three digits, without an exponent."""
    return f"{float(f'{1e6 * seconds:.3g}'):g}"


DECADE_TABLE = Table(
    "decades",
    (
        Column("error", "error", lambda error: f"{error:.0e}".replace("e-0", "e-")),
        *(
            Column(head, f"{kind}.{key}", show)
            for kind in ("topcli", "peer")
            for head, key, show in (
                (f"best {kind}", "name", str),
                ("with", "setting", str),
                ("µs", "seconds", microseconds),
            )
        ),
        Column("ratio", "ratio", ratio_text),
        Column("over scipy", "baseline_ratio", ratio_text),
    ),
    heading="Fastest in each decade of error",
)
POINT_TABLE = Table(
    _points,
    (
        Column(" ", "name"),
        Column("with", lambda row: setting(row["parameter"], row["value"])),
        Column("µs per unit time", "seconds", microseconds),
        Column("quartiles", "quartiles", lambda ends: " to ".join(map(microseconds, ends))),
        Column("max error", "error", number),
        Column("at the end", "final_error", number),
        Column("largest drift", "drift", number),
    ),
    heading="All points",
)


def ladder_lines(result: dict[str, Any]) -> list[str]:
    """Return a line for each competitor: its times to compile or load and to set up, and what ended its ladder."""
    return [
        f"{row['name']}: compiled or loaded in {row['compile_seconds']:.2g} s, set up in {row['setup_seconds']:.2g} s; "
        f"ended: {row['ended']}"
        for row in result["competitors"]
    ]


def setup_words(row: Mapping[str, Any]) -> str:
    """Time of a closed form's set-up, to follow that of a state; empty if it is short."""
    seconds = row["setup_seconds"]
    return f", after a set-up of {number(seconds)} s" if seconds > SETUP else ""


def require_bench_folder(out: Path) -> None:
    """Raise UsageError if ``out`` is the folder of a run."""
    if (out / MANIFEST).exists():
        raise UsageError(f"--out {out}: is the folder of a run; choose another")


@dataclass(frozen=True)
class _Identity:
    """Identity of a benchmark: its problem, and the code of its schemes."""

    config: dict[str, Any]
    digest: str
    code: str

    @property
    def key(self) -> str:
        """Eight digits that tell results of one name apart."""
        return hashlib.sha256(f"{self.digest} {self.code}".encode()).hexdigest()[:8]


def store_bench(result: dict[str, Any], code: str, started: str, out: Path) -> tuple[StoredResult, Path | None]:
    """Write a result to ``out/<scene>/``; return it and the new place of an earlier result, which is renamed.

    ``code`` is the digest of the schemes' code. Raises RunError if the result cannot be written.
    """
    named = sorted(competitor["name"] for competitor in result["competitors"])
    parts = [result["config"], result["duration"], result["intervals"], named]
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
    claim = ResultFolder.claim(out / result["name"], _Identity(result["config"], digest, code), force=True)
    with claim as folder:
        table = folder.working / POINTS
        write_table(table, points_table(result), {"topcli.bench": result["name"], "topcli.digest": digest})
        entries = {"kind": "bench", "outcome": "completed", "series": POINTS, "started": started, **git_commit()}
        report = json_text({"schema_version": SCHEMA_VERSION, **result})
        folder.finish({**entries, "environment": result["environment"]}, {REPORT: report}, [table])
    return folder.stored, folder.set_aside


def stored_benches(out: Path) -> list[tuple[StoredResult, dict[str, Any]]]:
    """Return the finished results in ``out`` with their reports, without renamed ones.

    Raises RunError for a damaged result.
    """
    benches = []
    for name, stored in stored_results(out).items():
        if isinstance(stored, RunError):
            raise stored
        if stored.manifest.get("kind") == "bench" and stored.manifest["name"] == name and stored.complete:
            benches.append((stored, stored.report()))
            if benches[-1][1].get("schema_version") != SCHEMA_VERSION:
                raise RunError(f"{stored.folder}: written by another version of topcli; run topcli bench again")
    return benches
