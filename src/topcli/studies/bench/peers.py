"""Other integrators in benchmarks (peers); each runs in its own process and answers requests.

A peer has an entry in ``PEERS`` and a function of a problem that returns its variants: the ways to use it, each with a
ladder of settings and a call for each setting. Its packages are imported only in its process, so that whatever they
load, print or break stays there. Peers that are not installed are skipped with a message.

Requests and answers are pickled: ``(method of Worker, *arguments)`` is answered with its result, or with a
``NoResultError``. Output that a peer prints goes to stderr.
"""

from __future__ import annotations

import math
import os
import pickle
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import numpy as np

from topcli.config.load import load_experiment
from topcli.contracts import Array, Top
from topcli.errors import UnknownNameError, UsageError, nearest, quoted
from topcli.schemes.plugins import load_plugin_file
from topcli.studies import imported


class NoResultError(Exception):
    """One setting of a competitor gave no trajectory; the message is the reason."""


@dataclass(frozen=True)
class Peer:
    """One peer: its ``name`` on the command line, and the packages it ``requires``.

    ``variants`` is the place, ``module:function``, of the function of a problem that returns its variants. ``varies``
    is True if its speed differs between processes; the best of several then counts. ``patience`` multiplies the usual
    time allowed for a call, for a peer that runs in the interpreter. The extra of the same name installs the packages.
    """

    name: str
    title: str
    variants: str
    requires: tuple[str, ...]
    varies: bool = False
    patience: float = 1.0


PEERS: dict[str, Peer] = {
    peer.name: peer
    for peer in (
        Peer(
            "scipy",
            "SciPy's DOP853, right-hand side in Python and compiled by numba",
            f"{__name__}:scipy_variants",
            ("scipy", "numba"),
            patience=50.0,
        ),
        Peer("heyoka", "heyoka's adaptive Taylor series", f"{__name__}:heyoka_variants", ("heyoka",), True),
        Peer(
            "diffrax",
            "diffrax's Dopri8 and Tsit5 under jax.jit",
            f"{__name__}:diffrax_variants",
            ("diffrax", "jax"),
            patience=5.0,
        ),
    )
}


def find_peers(names: Sequence[str]) -> list[Peer]:
    """Return the peers called ``names``, matched without case. Raises UnknownNameError or UsageError."""
    keys = [name.lower() for name in names]
    for i, key in enumerate(keys):
        if key not in PEERS:
            raise UnknownNameError(f"--against: unknown peer {quoted(names[i])}; {nearest(names[i], PEERS)}")
        if key in keys[:i]:
            raise UsageError(f"--against: peer {quoted(names[i])} is named twice")
    return [PEERS[key] for key in keys]


def missing(peer: Peer) -> str:
    """Reason why ``peer`` cannot be measured here; empty if its packages are installed."""
    absent = [package for package in peer.requires if find_spec(package) is None]
    return f"{' and '.join(absent)} not installed; run pip install 'topcli[{peer.name}]'" if absent else ""


Call = Callable[[], Array]
"""Integrate once, warm, and return the states at the problem's times, shape (m, d). Raises NoResultError."""


@dataclass(frozen=True)
class PeerProblem:
    """The motion of ``top`` from ``y0`` at time zero, to be recorded at ``times`` (m,), the first of them zero."""

    top: Top
    y0: Array
    times: Array


@dataclass(frozen=True)
class Variant:
    """One way to use a peer; ``prepare(value)`` compiles everything for one value of ``parameter``."""

    name: str
    parameter: str
    values: Sequence[float]
    prepare: Callable[[float], Call]


def decades(first: int, last: int, step: int = 1) -> list[float]:
    """Return 10^first, 10^(first - step), ... down to 10^last."""
    return [float(f"1e{exponent}") for exponent in range(first, last - 1, -step)]


def checked(states: Array, problem: PeerProblem) -> Array:
    """Return ``states`` if they are complete and finite; raise NoResultError otherwise."""
    expected = (len(problem.times), len(problem.y0))
    if states.shape != expected:
        raise NoResultError(f"gave states of shape {states.shape}; expected {expected}")
    if not np.isfinite(states).all():
        raise NoResultError("gave states that are not finite")
    return states


class Worker:
    """The variants of one peer for one problem, and the prepared calls."""

    def start(
        self, place: str, config: dict[str, Any], span: float, intervals: int, plugins: Sequence[Path]
    ) -> list[tuple[Any, ...]]:
        """Load a peer for a problem; return the name, the parameter and the values of each variant."""
        for path in plugins:
            load_plugin_file(path)
        experiment = load_experiment(config)
        times = np.arange(intervals + 1) * (span / intervals)
        variants = imported(place)(PeerProblem(experiment.top, np.array(experiment.y0), times))
        self._variants: dict[str, Variant] = {variant.name: variant for variant in variants}
        self._calls: dict[tuple[str, float], Call] = {}
        return [(variant.name, variant.parameter, list(variant.values)) for variant in variants]

    def run(self, name: str, value: float) -> tuple[Array, float, float]:
        """Prepare and call once; return the states, and the CPU seconds of the call and of its preparation."""
        started = time.process_time()
        call = self._variants[name].prepare(value)
        compiled = time.process_time()
        states = call()
        ended = time.process_time()
        self._calls[name, value] = call
        return np.ascontiguousarray(states, dtype=np.float64), ended - compiled, compiled - started

    def seconds(self, name: str, value: float, calls: int) -> float:
        """Call again, warm; return the mean CPU seconds of a call."""
        call = self._calls[name, value]
        started = time.process_time()
        for _ in range(calls):
            call()
        return (time.process_time() - started) / calls


def serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer all ``requests``."""
    worker = Worker()
    while True:
        try:
            method, *arguments = pickle.load(requests)
        except EOFError:
            return
        try:
            answer = getattr(worker, method)(*arguments)
        except NoResultError as failure:
            answer = failure
        except Exception as error:  # any exception of a peer is its result
            answer = NoResultError(f"{type(error).__name__}: {error}".splitlines()[0])
        pickle.dump(answer, answers)
        answers.flush()


def main() -> None:
    """Answer on the original stdout; all other output goes to stderr."""
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        serve(sys.stdin.buffer, answers)
    os._exit(0)  # some peers take long to shut down


_RATES = """
def rates(t, y):
    f = field(({items}), {p})
    out = empty({d})
    {store}
    return out
"""


def _compiled(problem: PeerProblem) -> Callable[[float, Any], Any]:
    """Return the right-hand side ``rates(t, y) -> array`` as machine code."""
    from numba import float64, njit

    from topcli.engine.compile import kernels

    d = len(problem.y0)
    text = _RATES.format(
        items="".join(f"y[{i}], " for i in range(d)),
        p=repr(tuple(map(float, problem.top.constants()))),
        d=d,
        store="\n    ".join(f"out[{i}] = f[{i}]" for i in range(d)),
    )
    scope: dict[str, Any] = {"field": problem.top.field, "empty": np.empty}
    exec(compile(text, "<right-hand side>", "exec"), scope)
    with kernels():
        return njit(float64[::1](float64, float64[::1]), error_model="numpy")(scope["rates"])


def _scipy_call(problem: PeerProblem, rates: Callable[[float, Any], Any], rtol: float) -> Call:
    from scipy.integrate import solve_ivp

    def call() -> Any:
        span = (0.0, float(problem.times[-1]))
        solved = solve_ivp(rates, span, problem.y0, method="DOP853", t_eval=problem.times, rtol=rtol, atol=1e-2 * rtol)
        if not solved.success:
            raise NoResultError(solved.message)
        return checked(solved.y.T, problem)

    return call


def scipy_variants(problem: PeerProblem) -> list[Variant]:
    """Return SciPy's DOP853 with its right-hand side in Python, and compiled by numba.

    Settings: ``solve_ivp(method="DOP853", t_eval=...)``, dense output of order 7 at the given times. The absolute
    tolerance is 1e-2 times the relative one, because the states are of size one and pass through zero. SciPy accepts no
    relative tolerance below 2.3e-14, a hundred epsilons. The Python right-hand side is the top's own function on a
    tuple, which is faster than numpy arrays of length six. Compiling it gains almost nothing for a top, because SciPy's
    own stages take most of the time.
    """
    field, p = problem.top.field, problem.top.constants()

    def rates(t: float, y: Any) -> Any:
        return field(tuple(y.tolist()), p)

    smallest = 2.0**-52 * 100.0 * (1.0 + 1e-12)
    compiled = _compiled(problem)
    tolerances = [*decades(-4, -12, 2), math.ceil(smallest * 1e17) / 1e17]
    return [
        Variant("scipy dop853", "rtol", tolerances, lambda v: _scipy_call(problem, rates, v)),
        Variant("scipy dop853 numba", "rtol", tolerances, lambda v: _scipy_call(problem, compiled, v)),
    ]


def _heyoka_call(problem: PeerProblem, high_accuracy: bool, tol: float) -> Call:
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


def heyoka_variants(problem: PeerProblem) -> list[Variant]:
    """Return heyoka's Taylor series of adaptive order and step, with and without compensated summation.

    Settings (Biscani and Izzo 2021): ``taylor_adaptive`` in its default (not compact) mode, which unrolls the whole
    step; ``propagate_grid``, whose dense output costs nothing extra. The order follows from ``tol``, which still helps
    below epsilon. ``high_accuracy`` sums the series with compensation. ``slp_vectorize``, ``force_avx512`` and
    ``fast_math`` are left out: on the generic Kowalevski scene they gain nothing below order 20, and 3 % at order 20.
    The speed of the same call differs between processes, so the best of several processes counts.
    """
    tolerances = [*decades(-2, -16), 1e-18]
    return [
        Variant("heyoka", "tol", tolerances, lambda v: _heyoka_call(problem, False, v)),
        Variant("heyoka high-accuracy", "tol", tolerances[9:], lambda v: _heyoka_call(problem, True, v)),
    ]


DIFFRAX_STEPS = 1_000_000


def _diffrax_solver(problem: PeerProblem, method: str) -> Any:
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
            max_steps=DIFFRAX_STEPS,
            throw=False,
        )
        return solution.ys, solution.result == diffrax.RESULTS.successful

    return jax.jit(solve).lower(jnp.asarray(problem.y0), jnp.asarray(problem.times), jnp.asarray(1e-6)).compile()


def diffrax_variants(problem: PeerProblem) -> list[Variant]:
    """Return diffrax's Runge-Kutta pairs of order 8 and 5 under jax.jit on the CPU (Kidger 2021).

    Settings: float64; ``PIDController`` with an absolute tolerance of 1e-2 times the relative one; ``SaveAt(ts=...)``;
    the tolerance is an argument, so that each solver is compiled once, ahead of time and outside the timing.
    """
    import jax  # pyright: ignore[reportMissingImports]

    jax.config.update("jax_enable_x64", True)
    compiled = cache(lambda method: _diffrax_solver(problem, method))

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
