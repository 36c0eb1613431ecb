"""The front of speed against error, interpolation on it, and what is said of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from topcli.studies.bench.result import (
    DECADES,
    MAX_GAP,
    Point,
    at_error,
    decade_rows,
    front,
    pareto_front,
    ranking,
)

# the front


def dominated(points: list[Point], i: int) -> bool:
    """By definition: another is as good in both and better in one, or the same and earlier."""
    p = points[i]
    return any(
        q.error <= p.error and q.seconds <= p.seconds and (q.error < p.error or q.seconds < p.seconds or j < i)
        for j, q in enumerate(points)
        if j != i
    )


def test_front_is_the_set_of_undominated_points() -> None:
    random = np.random.default_rng(5)
    for _ in range(50):
        # few values, so that many are equal
        points = [Point(float(e), float(s), 1.0) for e, s in random.integers(1, 8, size=(30, 2))]
        front = pareto_front(points)
        assert sorted(front) == [i for i in range(len(points)) if not dominated(points, i)]
        errors = [points[i].error for i in front]
        assert errors == sorted(errors, reverse=True)


def test_what_is_not_finite_is_on_no_front() -> None:
    points = [Point(math.nan, 1.0, 1.0), Point(1.0, math.nan, 1.0), Point(math.inf, 0.1, 1.0), Point(1.0, 0.0, 1.0)]
    assert pareto_front(points) == []
    assert at_error(points, 1e-3) is None


def curve(order: int, hs: list[float]) -> list[Point]:
    """A scheme whose error is h^order and whose time is 1/h."""
    return [Point(h**order, 1.0 / h, h) for h in hs]


def test_interpolation_follows_a_power_law() -> None:
    points = curve(4, [0.5**k for k in range(8)])
    for error in (1e-2, 3e-5, 1e-8):
        found = at_error(points, error)
        assert found is not None
        assert found.setting == pytest.approx(error**0.25, rel=1e-12)
        assert found.seconds == pytest.approx(error**-0.25, rel=1e-12)
        assert found.error == error


def test_an_error_beyond_the_ends() -> None:
    points = curve(2, [1.0, 0.5, 0.25])
    assert at_error(points, 5.0) == points[0]  # no coarser one was tried: the coarsest does
    assert at_error(points, 0.25**2) == points[-1]
    assert at_error(points, 0.06) is None


def test_a_wide_gap_is_not_bridged() -> None:
    points = [Point(1.0, 1.0, 1.0), Point(0.5 / MAX_GAP, 2.0, 0.5)]
    assert at_error(points, 0.1) == points[1]
    near = [points[0], Point(2.0 / MAX_GAP, 2.0, 0.5)]
    found = at_error(near, 0.1)
    assert found is not None
    assert 1.0 < found.seconds < 2.0


def test_a_dominated_point_does_not_count() -> None:
    points = [Point(1e-2, 1.0, 0.1), Point(5e-2, 3.0, 0.2), Point(1e-3, 2.0, 0.05)]
    found = at_error(points, 1e-2)
    assert found == points[0]


# the words


def competitor(name: str, kind: str, points: list[Point], parameter: str = "h", setup: float = 0.0) -> dict[str, Any]:
    rows = [{"error": p.error, "seconds": p.seconds, "value": p.setting} for p in points]
    return {"name": name, "kind": kind, "parameter": parameter, "points": rows, "setup_seconds": setup}


def test_the_decades_name_the_fastest_and_by_how_much() -> None:
    fast = competitor("ours", "topcli", curve(4, [0.5**k for k in range(6)]))
    slow = competitor(
        "theirs", "peer", [Point(p.error, 3.0 * p.seconds, p.setting) for p in curve(4, [1.0, 0.1])], "tol"
    )
    base = competitor("scipy dop853", "peer", [Point(1e-9, 1e4, 1e-9)], "rtol")
    rows = {row["error"]: row for row in decade_rows([slow, base, fast])}
    assert tuple(rows) == DECADES
    row = rows[1e-3]
    assert row["best"]["name"] == "ours"
    assert row["best"]["setting"] == "h=0.18"
    assert row["peer"]["name"] == "theirs"
    # between 1 and 1e-4 the peer's two points are too far apart to interpolate: its finer one counts
    assert row["ratio"] == pytest.approx(30.0 / 1e-3**-0.25, rel=1e-12)
    assert row["baseline_ratio"] == pytest.approx(1e4 / 1e-3**-0.25, rel=1e-12)
    assert row["words"] == (
        "for an error of 1e-3 take ours with h=0.18: 5.3 times faster than the next, theirs (tol=0.1)"
    )
    assert rows[1e-8]["topcli"] is None
    assert rows[1e-8]["ratio"] is None
    assert rows[1e-8]["words"].endswith("take scipy dop853 with rtol=1e-9: nothing else reaches it")
    assert rows[1e-12]["words"] == "for an error of 1e-12: nothing measured reaches it"


def test_the_next_best_is_another_program_and_ties_are_named() -> None:
    points = curve(4, [1.0, 0.5, 0.25, 0.125])
    two = [competitor("heyoka", "peer", points), competitor("heyoka high-accuracy", "peer", points)]
    other = competitor("rk4", "topcli", [Point(p.error, 1.01 * p.seconds, p.setting) for p in points])
    row = decade_rows([*two, other])[0]
    assert row["next"]["name"] == "rk4"
    assert "level with the next, rk4" in row["words"]
    assert [entry["name"] for entry in ranking([*two, other], 1e-3)] == ["heyoka", "heyoka high-accuracy", "rk4"]
    assert {entry["name"] for entry in front([*two, other])} == {"heyoka"}
