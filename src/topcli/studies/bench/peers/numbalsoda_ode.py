"""numbalsoda: Hairer's dop853 and LSODA as compiled libraries, the right-hand side a numba cfunc.

Settings: the constants are written into the inlined right-hand side, and no Python is called during a run. The
absolute tolerance is 1e-2 times the relative one. The returned flag is checked: at 1e-14 lsoda returns meaningless
numbers and reports it.
"""

from __future__ import annotations

from typing import Any

from topcli.studies.bench.peers.contract import Call, PeerError, Problem, Variant, checked, compilable_rates, decades

MAX_STEPS = 10_000_000
_TEMPLATE = """
def rates(t, y, out, data):
    f = field(({items}), {p})
    {store}
"""


def _compiled(problem: Problem) -> Any:
    from numba import cfunc
    from numbalsoda import lsoda_sig  # pyright: ignore[reportMissingImports]

    return cfunc(lsoda_sig, error_model="numpy")(compilable_rates(problem, _TEMPLATE))


def _prepare(problem: Problem, solve: Any, rates: Any, rtol: float) -> Call:
    import numpy as np

    data = np.zeros(1)
    solve(rates.address, problem.y0, problem.times[:2], data, rtol, 1e-2 * rtol, MAX_STEPS)  # numba compiles the call

    def call() -> Any:
        states, success = solve(rates.address, problem.y0, problem.times, data, rtol, 1e-2 * rtol, MAX_STEPS)
        if not success:
            raise PeerError("returned success = False")
        return checked(states, problem)

    return call


def variants(problem: Problem) -> list[Variant]:
    """Return both solvers."""
    from numbalsoda import dop853, lsoda  # pyright: ignore[reportMissingImports]

    rates = _compiled(problem)
    return [
        Variant("numbalsoda dop853", "rtol", decades(-3, -15), lambda v: _prepare(problem, dop853, rates, v)),
        Variant("numbalsoda lsoda", "rtol", decades(-3, -14), lambda v: _prepare(problem, lsoda, rates, v)),
    ]
