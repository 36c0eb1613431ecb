"""``topcli bench``: CPU time against error of schemes and of other integrators (peers).

Each competitor climbs a ladder of settings, coarse to fine: step sizes, or tolerances. Errors are the largest Euclidean
distances of states from the Taylor reference in double-double arithmetic at common times. Times are CPU seconds of a
warm call, which depend least on the load of the machine: medians of repetitions in which all competitors take turns.
What a scheme computes once for an initial state is timed apart.

A peer runs in a process of its own, so that whatever its packages load, print or break stays there. A new peer is an
entry of ``PEERS`` and a function of an experiment and times, which returns a function of a tolerance.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from functools import cache, partial
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Sampler, Stepper
from topcli.errors import ExitCode, SchemeCodeError, UnknownNameError, UsageError, counted, nearest, quoted
from topcli.plugins import FILES, load_plugin_file, reason_of
from topcli.schemes.display import display_name
from topcli.schemes.registry import composable_names, names_for
from topcli.studies import SILENT, Watch
from topcli.studies.entries import code_failures, entries_of
from topcli.studies.ladder import (
    USELESS,
    ErrorCurve,
    Measurement,
    NoResultError,
    Prepare,
    ladder,
    measured,
    scheme_calls,
    tolerance_option,
)
from topcli.studies.report import Report
from topcli.table import Row, Table, two_digits

DECADES = tuple(float(f"1e-{n}") for n in range(3, 13))
"""Errors at which the fastest are named."""
_KINDS = ("scheme", "peer")
"""Kinds of competitors."""
_COMPOSED = dict.fromkeys(("hk", "midpoint", "splitting"), ("kahan-li6", "kahan-li8"))
"""Compositions that take part by default if their base fits."""
SETUP = 1e-3
"""Set-ups for an initial state that take longer than this, in seconds, are mentioned."""
MOST_DRAWN = 7
"""Number of our schemes in a picture; there are no more distinct colours."""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "JAX_PLATFORMS": "cpu"}
"""Environment of the process of a peer."""


def scipy_peer(experiment: Experiment, times: Array) -> Prepare:
    """SciPy's DOP853 with dense output and the top's own right-hand side.

    A function of a tuple is faster than numpy arrays of length six; compiling it gains almost nothing, because SciPy's
    own stages take most of the time. States are of size one and pass through zero: ``atol`` is 1e-2 ``rtol``.
    """
    from scipy.integrate import solve_ivp

    rates, p = experiment.top.field, experiment.top.constants()

    def call(rtol: float) -> Array:
        span = (0.0, float(times[-1]))
        solved = solve_ivp(
            lambda t, y: rates(tuple(y.tolist()), p), span, experiment.y0, "DOP853", times, rtol=rtol, atol=1e-2 * rtol
        )
        if not solved.success:
            raise NoResultError(solved.message)
        return solved.y.T

    return lambda rtol: partial(call, rtol)


def heyoka_peer(experiment: Experiment, times: Array, accurate: bool = False) -> Prepare:
    """heyoka's Taylor series of adaptive order and step (Biscani and Izzo 2021), with compensated sums if asked for.

    The default mode unrolls the whole step, and ``propagate_grid`` gets the states between the steps for nothing.
    ``slp_vectorize``, ``force_avx512`` and ``fast_math`` gain 3 % at most on these scenes.
    """
    import heyoka  # pyright: ignore[reportMissingImports]

    state = heyoka.make_vars(*experiment.top.components)
    rates = experiment.top.field(tuple(state), experiment.top.constants())
    system = [(x, rate + heyoka.expression(0.0)) for x, rate in zip(state, rates, strict=True)]

    def call(series: Any) -> Array:
        series.time = 0.0
        series.state[:] = experiment.y0
        ending, *_, states = series.propagate_grid(times)
        if ending != heyoka.taylor_outcome.time_limit:
            raise NoResultError(f"ended with {ending}")
        return states

    return lambda tol: partial(call, heyoka.taylor_adaptive(system, experiment.y0, tol=tol, high_accuracy=accurate))


def diffrax_peer(experiment: Experiment, times: Array) -> Prepare:
    """diffrax's Runge-Kutta pair of order 8 in float64 under jax.jit on the CPU (Kidger 2021).

    The tolerance is an argument, so that the solver is compiled once, ahead of time.
    """
    import diffrax  # pyright: ignore[reportMissingImports]
    import jax  # pyright: ignore[reportMissingImports]
    import jax.numpy as jnp  # pyright: ignore[reportMissingImports]

    jax.config.update("jax_enable_x64", True)
    rates, p = experiment.top.field, experiment.top.constants()
    term = diffrax.ODETerm(lambda t, y, args: jnp.stack([jnp.asarray(x, y.dtype) for x in rates(tuple(y), p)]))

    def solve(y0: Any, times: Any, rtol: Any) -> Any:
        control = diffrax.PIDController(rtol=rtol, atol=1e-2 * rtol)
        # an early-exit loop without checkpoints: no gradient is asked for
        options = {"adjoint": diffrax.ForwardMode(), "max_steps": 1_000_000, "throw": False}
        save, ends = diffrax.SaveAt(ts=times), (times[0], times[-1])
        solution = diffrax.diffeqsolve(
            term, diffrax.Dopri8(), *ends, None, y0, saveat=save, stepsize_controller=control, **options
        )
        return solution.ys  # infinite from where it failed

    start_and_times: Any = jnp.asarray(experiment.y0), jnp.asarray(times)
    compiled = jax.jit(solve).lower(*start_and_times, jnp.asarray(1e-6)).compile()
    return lambda rtol: lambda: np.asarray(compiled(*start_and_times, jnp.asarray(rtol)).block_until_ready())


class Peer(NamedTuple):
    """Another integrator: its ``package``, a function that prepares its calls, and its ``tolerances``.

    ``patience`` multiplies the time allowed for a call, for a peer that runs in the interpreter.
    """

    package: str
    prepare: Callable[[Experiment, Array], Prepare]
    tolerances: Sequence[float]
    patience: float = 1.0


def powers(first: int, last: int) -> list[float]:
    """10^-first, ..., 10^-last."""
    return [float(f"1e-{exponent}") for exponent in range(first, last + 1)]


PEERS: dict[str, Peer] = {
    # SciPy accepts no relative tolerance below a hundred epsilons
    "scipy": Peer("scipy", scipy_peer, [*powers(4, 13), 2.221e-14], 50.0),
    "heyoka": Peer("heyoka", heyoka_peer, [*powers(2, 16), 1e-18]),
    "heyoka-accurate": Peer("heyoka", partial(heyoka_peer, accurate=True), [*powers(11, 16), 1e-18]),
    "diffrax": Peer("diffrax", diffrax_peer, powers(3, 14), 5.0),
}
_started: list[Any] = []
"""In the process of a peer: the arguments of ``start_peer``."""


def start_peer(prepare: Any, config: Mapping[str, Any], times: Array, plugins: Sequence[Path]) -> None:
    """Make the process of a peer ready; what the peer prints goes to stderr."""
    os.dup2(2, 1)
    os.environ.update(ONE_THREAD)
    _started[:] = prepare, config, times, plugins


@cache
def peer_in_process() -> Measurement:
    """Measurements of the peer of this process."""
    prepare, config, times, plugins = _started
    for path in plugins:
        load_plugin_file(path)
    return measured(prepare(load_experiment(config), times), times)


def run_peer(setting: float, calls: int) -> tuple[Array, float]:
    """Measurement of the peer of this process. Raises NoResultError for any exception."""
    try:
        return peer_in_process()(setting, calls)
    except Exception as error:
        raise NoResultError(reason_of(error)) from None


def peer_measure(peer: Peer, experiment: Experiment, times: Array, stack: ExitStack) -> Measurement:
    """Measurements of a peer in a process that ends with the ``stack``. They raise SchemeCodeError if it dies."""
    plugins = [*FILES]
    arguments = peer.prepare, experiment.resolved(), times, plugins
    pool = stack.enter_context(ProcessPoolExecutor(1, get_context("spawn"), start_peer, arguments))

    def measure(setting: float, calls: int) -> tuple[Array, float]:
        try:
            return pool.submit(run_peer, setting, calls).result()
        except BrokenProcessPool:
            raise SchemeCodeError("its process died") from None

    return measure


def take_turns(
    curves: Sequence[ErrorCurve], reference: Array, repetitions: int, watch: Callable[[int, int], None]
) -> list[str]:
    """Let all competitors climb, and time them in turns; returns a line for each whose code failed."""
    tasks = [(curve.name, partial(curve.climb, reference)) for curve in curves]
    for i in range(repetitions):
        first = i * len(curves) // repetitions  # another competitor begins
        tasks += [(curve.name, curve.repeat) for curve in [*curves[first:], *curves[:first]]]
    errors: list[str] = []
    for i, (name, task) in enumerate(tasks):
        with code_failures(errors, name):
            task()
        watch(i + 1, len(tasks))
    return list(dict.fromkeys(errors))


def default_names(form: str) -> list[str]:
    """Names of every scheme of a form of a top, and of the compositions and settings that take part by default."""
    names, composable = names_for(form), composable_names(form)
    composed = [f"{base}+{name}" for base, parts in _COMPOSED.items() if base in composable for name in parts]
    return [*names, *(["backlund:nodes=exact"] if "backlund" in names else []), *composed]


def obstacle_of(experiment: Experiment, named: bool) -> str:
    """Reason why the speed of a scheme is not measured; empty if it is. Interpreted ones are, if they are named."""
    method = experiment.method()
    if isinstance(method, Sampler):
        return "is evaluated, not stepped; topcli compare shows its error"
    if experiment.scheme.adaptive and not tolerance_option(experiment.scheme):
        return "is adaptive and has no option tol or rtol to measure it over"
    return "is interpreted" if isinstance(method, Stepper) and method.plain and not named else ""


def point_rows(curves: Sequence[ErrorCurve], duration: float) -> list[Row]:
    """Row for each point; times are per unit of simulated time, but for that of the set-up."""
    return [
        {
            **{kind: curve.name if kind == curve.kind else None for kind in _KINDS},
            "setting": f"{curve.parameter}={point.setting:.2g}", "error": point.error,
            "seconds": point.seconds / duration, "repetitions": len(point.samples),
            "set_up": min(curve.setups, default=0.0),
        }
        for curve in curves
        for point in curve.points
    ]  # fmt: skip


def fastest(points: Sequence[Row], error: float) -> Row | None:
    """Fastest of the points of at most this error; None if there is none."""
    return min((row for row in points if row["error"] <= error), key=lambda row: row["seconds"], default=None)


def decade_rows(points: Sequence[Row]) -> list[Row]:
    """Row for each decade of error: our fastest, the fastest peer, and the ratio of their times."""
    rows: list[Row] = []
    for error in DECADES:
        row: dict[str, Any] = {"error": error}
        for kind in _KINDS:
            best = fastest([point for point in points if point[kind]], error) or {}
            row |= {f"best {kind}": best.get(kind), f"{kind} with": best.get("setting")}
            row[f"{kind} µs"] = 1e6 * best["seconds"] if best else None
        both = row["best scheme"] and row["best peer"]
        rows.append({**row, "ratio": row["peer µs"] / row["scheme µs"] if both else None})
    return rows


def answer_of(decades: Sequence[Row]) -> str:
    """Lead over the peers; without peers, the fastest scheme at the middle one of the decades that are reached."""
    ratios = [row["ratio"] for row in decades if row["ratio"] is not None]
    reached = [row for row in decades if row["best scheme"]]
    if ratios:
        lead = f"{two_digits(min(ratios))} to {two_digits(max(ratios))} times as fast as the best peer"
        return f"{lead} at {counted(len(ratios), 'decade')} of error"
    if not reached:
        return f"no scheme reaches an error of {DECADES[0]:g}"
    row = reached[len(reached) // 2]
    return f"for an error of {row['error']:.0e} take {row['best scheme']} with {row['scheme with']}"


def bench(
    *schemes: str,
    config: str | Path | Mapping[str, Any] = "kowalevski_generic_hk",
    overrides: Sequence[str] = (),
    against: Sequence[str] = tuple(PEERS),
    budget: float = 0.06,
    repetitions: int = 7,
    samples: int = 100,
    watch: Watch = SILENT,
) -> Report:
    """Measure speed against error and name the fastest schemes.

    Each scheme runs with a series of step sizes. Each peer (an integrator of another package) runs in a process of its
    own with a series of tolerances; in a Python script, call this function below ``if __name__ == "__main__":``.

    Parameters
    ----------
    *schemes : str
        Names of schemes, with options if needed; by default all that fit the top, and compositions.
    config : path, str or mapping, optional
        Read the experiment from a config or scene. In Python, ``config`` may also be the content of a config.
    overrides : sequence of str, optional
        Override a key of the config, for example T=1000 or top.c0=-1.
    against : sequence of str, optional
        Compare with these peers; none for no peer.
    budget : float, optional
        Limit the CPU time of one run, in seconds.
    repetitions : int, optional
        Repeat each short run this many times.
    samples : int, optional
        Measure the error at this many points in time.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        The fastest scheme and the fastest peer in each decade of error, and all points. Times are CPU seconds per unit
        of simulated time.

    Raises
    ------
    UsageError
        If a name is unknown, or a scheme does not fit the top or is a closed form.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.bench("hk", "taylor", overrides=["T=10"], against=["none"], budget=1e-3, repetitions=1)
    >>> report.table["best scheme"].tolist()[-3:]
    ['taylor', 'taylor', 'taylor']
    >>> len(report.tables[1].rows) > 20
    True
    """
    if not budget > 0.0 or repetitions < 1 or samples < 1:
        raise UsageError("--budget, --repetitions and --samples must be positive")
    if unknown := [name for name in against if name not in (*PEERS, "none")]:
        raise UnknownNameError(f"--against: unknown peer {quoted(unknown[0])}; {nearest(unknown[0], [*PEERS, 'none'])}")
    peers = {name: PEERS[name] for name in against if name != "none"}
    missing = {name: peer.package for name, peer in peers.items() if find_spec(peer.package) is None}
    notes = [f"peer {name} is skipped: run pip install 'topcli[{package}]'" for name, package in missing.items()]
    experiment = load_experiment(config, overrides)
    top, duration = experiment.top, experiment.duration
    if duration < 0.0:
        raise UsageError(f"{experiment.name}: h = {experiment.h:g} runs backwards; speed is measured forwards")
    line_up = entries_of(experiment, schemes, default_names(top.form), partial(obstacle_of, named=bool(schemes)))
    watch.begin(experiment.name, experiment, unit="measurements")
    times = np.arange(samples + 1) * (duration / samples)
    reference = reference_states(top, experiment.y0, times)
    # all take turns, so that a slow moment of the machine meets them alike
    with ExitStack() as stack:
        curves = []
        for name, scheme in line_up.items():
            setups: list[float] = []
            calls, settings = measured(scheme_calls(scheme, times, setups), times), ladder(scheme, float(times[1]))
            parameter = tolerance_option(scheme.scheme) or "h"
            curves.append(ErrorCurve(name, "scheme", parameter, settings, budget, calls, setups=setups))
        for name, peer in peers.items():
            if name not in missing:
                calls = peer_measure(peer, experiment, times, stack)
                curves.append(ErrorCurve(name, "peer", "tol", peer.tolerances, budget * peer.patience, calls))
        errors = take_turns(curves, reference, repetitions, watch)
    for curve in curves:
        if not curve.points and curve.failure:
            lines = errors if curve.kind == "peer" else notes
            lines.append(f"{curve.name} gave no result: {curve.failure}")
        if (setup := min(curve.setups, default=0.0)) > SETUP:
            notes.append(f"{curve.name}: times leave out {setup:.2g} s for each initial state")
    points = point_rows(curves, duration)
    decades = decade_rows(points)
    formats = {"error": ".0e", "ratio": two_digits}
    tables = [
        Table("Fastest in each decade of error", decades, formats, ("scheme with", "peer with")),
        Table("All points", points, detail=True),
    ]
    title = f"{experiment.name}: {top.title}, t from 0 to {duration:g}, CPU time per unit of time"
    code, base = ExitCode.PARTLY_FAILED if errors else ExitCode.SUCCESS, experiment.resolved()
    columns = {key: np.array([row[key] for row in points]) for key in points[0]} if points else {}
    draw = partial(draw_speed_against_error, points) if points else None
    return Report("bench", title, answer_of(decades), tables, notes, errors, code, base, columns, draw)


def front_of(points: Sequence[Row]) -> list[Row]:
    """Points with an error that no faster one reaches, by decreasing error."""
    front: list[Row] = []
    for row in sorted(points, key=lambda row: row["seconds"]):
        if not front or row["error"] < front[-1]["error"]:
            front.append(row)
    return front


def nearest_to_front(points: Sequence[Row]) -> list[str]:
    """Our schemes by the smallest ratio of their time to the fastest of at most the same error; ``MOST_DRAWN``."""
    ratios: dict[str, float] = {}
    for row in points:
        if row["scheme"] and (best := fastest(points, row["error"])):
            ratios[row["scheme"]] = min(ratios.get(row["scheme"], math.inf), row["seconds"] / best["seconds"])
    return sorted(ratios, key=lambda name: (ratios[name], name))[:MOST_DRAWN]


def draw_speed_against_error(points: Sequence[Row], axes: Any, looks: Callable[..., Any]) -> None:
    """Draw every peer in grey, and our schemes that are nearest to the fastest."""
    useful = [row for row in points if 0.0 < row["error"] <= USELESS]
    peers = dict.fromkeys(row["peer"] for row in useful if row["peer"])
    grey = {"color": "0.55", "linewidth": 0.8, "markerfacecolor": "white", "zorder": 1.8}
    styles = {name: {**grey, "marker": marker} for name, marker in zip(peers, "osD^v<>ph*", strict=False)}
    for name, style in {**looks(nearest_to_front(useful), markers=True), **styles}.items():
        front = front_of([row for row in useful if name in (row["scheme"], row["peer"])])
        label = display_name(name) + (" (after its set-up)" if front[0]["set_up"] > SETUP else "")
        times = [1e6 * row["seconds"] for row in front]
        axes.loglog([row["error"] for row in front], times, label=label, markersize=4, **style)
    axes.invert_xaxis()
    axes.set(xlabel="largest error; more accurate →", ylabel="CPU time per unit of time, µs")
