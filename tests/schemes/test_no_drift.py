"""No secular drift over t = 1e5: the slope of every integral is within its uncertainty, the paper's hybrid's is not."""

from __future__ import annotations

import pytest

from conftest import GEN, random_states
from test_beyond import stepper
from topcli.analysis.tally import InvariantRow, InvariantTally
from topcli.contracts import Floats
from topcli.engine.loop import Run
from topcli.tops.kowalevski import Kowalevski

STATES = [GEN, *map(tuple, random_states(2, seed=34))]


def drifts(name: str, y0: Floats, h: float = 0.05, t: float = 1e5) -> dict[str, InvariantRow]:
    """The report on all integrals over the whole time."""
    tally = InvariantTally(Kowalevski().invariants(), h)
    for chunk in Run(Kowalevski(), stepper(name), y0, h, round(t / h), 20):
        tally.add(chunk.n, chunk.states)
    return {row.name: row for row in tally.report()}


def in_errors(row: InvariantRow) -> float:
    """The slope in its standard errors."""
    assert row.drift is not None
    assert row.drift_error
    return abs(row.drift) / row.drift_error


@pytest.mark.slow
@pytest.mark.parametrize("y0", STATES)
def test_four_integrals_do_not_drift(y0: Floats) -> None:
    for row in drifts("midpoint4", y0).values():
        assert row.max_deviation < 1e-14 * max(1.0, abs(row.first))
        assert row.verdict == "exact"
        assert in_errors(row) < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("y0", STATES)
@pytest.mark.parametrize("h", [0.05, 0.4])
def test_integrable_map_does_not_drift(y0: Floats, h: float) -> None:
    for row in drifts("backlund", y0, h).values():
        assert row.max_deviation < 1e-12 * max(1.0, abs(row.first))
        assert row.verdict == "exact"
        assert in_errors(row) < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("y0", STATES)
def test_self_adjoint_hybrid_does_not_drift(y0: Floats) -> None:
    rows = drifts("hybrid-sym", y0)
    assert all(in_errors(row) < 5.0 for row in rows.values())
    assert rows["gamma_sq"].verdict == rows["k_sq"].verdict == "exact"
    assert rows["two_l"].verdict == rows["energy"].verdict == "bounded"


def test_the_papers_hybrid_drifts() -> None:
    rows = drifts("hybrid", GEN)
    for name in ("two_l", "energy"):
        assert in_errors(rows[name]) > 50.0  # 83 by the error of a random walk, the larger of the two
        assert rows[name].verdict == "lost"  # so far that hardly anything is left of it
