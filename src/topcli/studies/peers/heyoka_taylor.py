"""heyoka: Taylor series compiled for the one system, of adaptive order and step (Biscani and Izzo 2021).

Settings: ``taylor_adaptive`` in its default, not compact, mode, where the whole step is unrolled; ``propagate_grid``,
whose dense output costs nothing extra. Order follows from ``tol``, down to below epsilon, where it still helps. Both
with and without ``high_accuracy``, which sums the series with compensation. ``slp_vectorize``, ``force_avx512`` and
``fast_math`` were tried on the generic Kowalevski scene and left out: no faster below order 20, and 3 % at it.
Its speed differs from process to process for the same call, so the best of several processes counts.
"""

from __future__ import annotations

from typing import Any

from topcli.studies.peers.contract import Call, PeerError, Problem, Variant, checked, decades


def _prepare(problem: Problem, high_accuracy: bool, tol: float) -> Call:
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
            raise PeerError(f"ended with {ending}")
        return checked(states, problem)

    return call


def variants(problem: Problem) -> list[Variant]:
    """The series with and without compensated summation."""
    tolerances = [*decades(-2, -16), 1e-18]
    return [
        Variant("heyoka", "tol", tolerances, lambda v: _prepare(problem, False, v)),
        Variant("heyoka high-accuracy", "tol", tolerances[9:], lambda v: _prepare(problem, True, v)),
    ]
