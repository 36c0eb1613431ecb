"""heyoka: Taylor series compiled for the given system, of adaptive order and step (Biscani and Izzo 2021).

Settings: ``taylor_adaptive`` in its default (not compact) mode, which unrolls the whole step; ``propagate_grid``, whose
dense output costs nothing extra. The order follows from ``tol``, which still helps below epsilon. Variants with and
without ``high_accuracy``, which sums the series with compensation. ``slp_vectorize``, ``force_avx512`` and
``fast_math`` are left out: on the generic Kowalevski scene they gain nothing below order 20, and 3 % at order 20.
The speed of the same call differs between processes, so the best of several processes counts.
"""

from __future__ import annotations

from typing import Any

from topcli.studies.bench.peers import NoResultError
from topcli.studies.bench.peers.worker import Call, PeerProblem, Variant, checked, decades


def _prepare(problem: PeerProblem, high_accuracy: bool, tol: float) -> Call:
    import heyoka  # pyright: ignore[reportMissingImports]

    names = problem.top.components
    state = heyoka.make_vars(*names)
    rates = problem.top.field(tuple(state), problem.top.constants())
    system = [(x, rate + heyoka.expression(0.0)) for x, rate in zip(state, rates, strict=True)]
    y0, times = problem.y0, problem.times
    series: Any = heyoka.taylor_adaptive(system, y0.copy(), tol=tol, high_accuracy=high_accuracy)

    def call() -> Any:
        series.time = 0.0
        series.state[:] = y0
        ending, *_, states = series.propagate_grid(times)
        if ending != heyoka.taylor_outcome.time_limit:
            raise NoResultError(f"ended with {ending}")
        return checked(states, problem)

    return call


def variants(problem: PeerProblem) -> list[Variant]:
    """Return the series with and without compensated summation."""
    tolerances = [*decades(-2, -16), 1e-18]
    return [
        Variant("heyoka", "tol", tolerances, lambda v: _prepare(problem, False, v)),
        Variant("heyoka high-accuracy", "tol", tolerances[9:], lambda v: _prepare(problem, True, v)),
    ]
