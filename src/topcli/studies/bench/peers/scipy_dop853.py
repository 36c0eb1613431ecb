"""SciPy's DOP853 with its right-hand side in Python, and compiled by numba.

Settings: ``solve_ivp(method="DOP853", t_eval=...)``, dense output of order 7 at the given times. The absolute tolerance
is 1e-2 times the relative one, because the states are of size one and pass through zero. SciPy accepts no relative
tolerance below 2.3e-14, a hundred epsilons. The Python right-hand side is the top's own function on a tuple, which is
faster than numpy arrays of length six. Compiling it gains almost nothing for a top, because SciPy's own stages take
most of the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from topcli.studies.bench.peers import NoResultError
from topcli.studies.bench.peers.worker import Call, PeerProblem, Variant, checked, decades

_TEMPLATE = """
def rates(t, y):
    f = field(({items}), {p})
    out = empty({d})
    {store}
    return out
"""


def _compiled(problem: PeerProblem) -> Callable[[float, Any], Any]:
    """Return the right-hand side ``rates(t, y) -> array`` as machine code."""
    import numpy as np
    from numba import float64, njit

    from topcli.engine.source import compilable_copy

    d, jit = len(problem.y0), njit(forceinline=True, error_model="numpy")
    text = _TEMPLATE.format(
        items="".join(f"y[{i}], " for i in range(d)),
        p=repr(tuple(map(float, problem.top.constants()))),
        d=d,
        store="\n    ".join(f"out[{i}] = f[{i}]" for i in range(d)),
    )
    scope: dict[str, Any] = {"field": jit(compilable_copy(problem.top.field, jit)), "empty": np.empty}
    exec(compile(text, "<right-hand side>", "exec"), scope)
    return njit(float64[::1](float64, float64[::1]), error_model="numpy")(scope["rates"])


def _prepare(problem: PeerProblem, rates: Callable[[float, Any], Any], rtol: float) -> Call:
    from scipy.integrate import solve_ivp

    def call() -> Any:
        span = (0.0, float(problem.times[-1]))
        solved = solve_ivp(rates, span, problem.y0, method="DOP853", t_eval=problem.times, rtol=rtol, atol=1e-2 * rtol)
        if not solved.success:
            raise NoResultError(solved.message)
        return checked(solved.y.T, problem)

    return call


def variants(problem: PeerProblem) -> list[Variant]:
    """Return DOP853 with the right-hand side in Python, and with it compiled."""
    field, p = problem.top.field, problem.top.constants()

    def rates(t: float, y: Any) -> Any:
        return field(tuple(y.tolist()), p)

    smallest = 2.0**-52 * 100.0 * (1.0 + 1e-12)
    compiled = _compiled(problem)
    tolerances = [*decades(-4, -12, 2), math.ceil(smallest * 1e17) / 1e17]
    return [
        Variant("scipy dop853", "rtol", tolerances, lambda v: _prepare(problem, rates, v)),
        Variant("scipy dop853 numba", "rtol", tolerances, lambda v: _prepare(problem, compiled, v)),
    ]
