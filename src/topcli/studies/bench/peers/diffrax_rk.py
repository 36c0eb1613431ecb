"""diffrax: Runge-Kutta pairs under jax.jit on the CPU (Kidger 2021).

Settings: float64; ``PIDController`` with an absolute tolerance of 1e-2 times the relative one; ``SaveAt(ts=...)``; the
tolerance is an argument, so that each solver is compiled once, ahead of time and outside the timing.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from topcli.studies.bench.peers import NoResultError
from topcli.studies.bench.peers.worker import Call, PeerProblem, Variant, checked, decades

MAX_STEPS = 1_000_000


def _solver(problem: PeerProblem, method: str) -> Any:
    """Return the compiled ``solve(y0, times, rtol) -> (states, succeeded)``."""
    import diffrax  # pyright: ignore[reportMissingImports]
    import jax  # pyright: ignore[reportMissingImports]
    import jax.numpy as jnp  # pyright: ignore[reportMissingImports]

    jax.config.update("jax_enable_x64", True)
    p, field = problem.top.constants(), problem.top.field
    term = diffrax.ODETerm(lambda t, y, args: jnp.stack([jnp.asarray(x, y.dtype) for x in field(tuple(y), p)]))

    def solve(y0: Any, times: Any, rtol: Any) -> Any:
        solution = diffrax.diffeqsolve(
            term,
            getattr(diffrax, method)(),
            times[0],
            times[-1],
            None,
            y0,
            saveat=diffrax.SaveAt(ts=times),
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=1e-2 * rtol),
            adjoint=diffrax.ForwardMode(),  # an early-exit loop without checkpoints: no gradient is asked for
            max_steps=MAX_STEPS,
            throw=False,
        )
        return solution.ys, solution.result == diffrax.RESULTS.successful

    return jax.jit(solve).lower(jnp.asarray(problem.y0), jnp.asarray(problem.times), jnp.asarray(1e-6)).compile()


def variants(problem: PeerProblem) -> list[Variant]:
    """Return a pair of order 8 and one of order 5."""
    import jax  # pyright: ignore[reportMissingImports]
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    compiled = cache(lambda method: _solver(problem, method))

    def prepare(method: str, rtol: float) -> Call:
        solve = compiled(method)
        y0, times, tolerance = map(jax.device_put, (problem.y0, problem.times, np.float64(rtol)))

        def call() -> Any:
            states, succeeded = solve(y0, times, tolerance)
            states.block_until_ready()
            if not succeeded:
                raise NoResultError("did not succeed")
            return checked(np.asarray(states), problem)

        return call

    return [
        Variant("diffrax Dopri8", "rtol", decades(-3, -14), lambda v: prepare("Dopri8", v)),
        Variant("diffrax Tsit5", "rtol", decades(-3, -10), lambda v: prepare("Tsit5", v)),
    ]
