"""``topcli lyapunov``: Lyapunov exponents of an orbit, and the verdict whether it is regular or chaotic."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.lyapunov import DEEP, LEAST_STEPS, REGULAR, TRANSIENT, Growth, Verdict, growth_of, spectrum_of
from topcli.config.load import load_experiment
from topcli.errors import ExitCode, UsageError
from topcli.studies import SILENT, Watch
from topcli.studies.report import Report, Table, plain
from topcli.table import plus_minus


def lyapunov(
    config: str | Path | Mapping[str, Any],
    overrides: Sequence[str] = (),
    *,
    spectrum: bool = False,
    discard: float | None = None,
    watch: Watch = SILENT,
) -> Report:
    """Measure Lyapunov exponents and detect chaos.

    The study follows a tangent vector along the orbit of a config with the tangent map (the derivative of a step) of
    the scheme. The growth of this vector and the recurrence of the orbit decide whether the orbit is regular or
    chaotic. With the option spectrum, the study follows as many tangent vectors as the state has components.

    Parameters
    ----------
    config : path, str or mapping
        Config file or name of a packaged scene.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    spectrum : bool, optional
        Measure as many exponents as the state has components.
    discard : float, optional
        Time to leave out at the beginning of the orbit. By default, the verdict uses the whole orbit, and the exponents
        leave out a transient: the first parts of the time in which the vector grows unlike in the second half.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        ``table`` has a row for each exponent, with half the width of its confidence interval of 95 % as ``error``. The
        second table has the verdict, ``"regular"``, ``"chaotic"``, ``"undecided"``, ``"equilibrium"``, ``"unstable"``
        (an unstable periodic or quasi-periodic orbit), ``"escaping"`` or ``"broke off"``, with the numbers behind it.
        ``columns`` contains the finite-time exponents as functions of t.

    Raises
    ------
    UsageError
        If the scheme has no tangent map, if the number of steps is too small, or if a step stretches tangent vectors
        too differently for a spectrum.

    Examples
    --------
    >>> import topcli
    >>> topcli.lyapunov("kowalevski_generic_hk", overrides=["N=20000"]).tables[1].rows[0]["verdict"]
    'regular'
    """
    experiment = load_experiment(config, overrides)
    top, scheme, method, h, N = experiment.top, experiment.scheme, experiment.method(), experiment.h, experiment.N
    if discard is not None and not 0.0 <= discard <= N * abs(h):
        raise UsageError(f"--discard {discard:g}: must be a time from 0 to T = {N * abs(h):g}")
    skip = None if discard is None else round(discard / abs(h))
    if N - (skip or 0) < LEAST_STEPS:
        left = f" after --discard {discard:g}" if skip else ""
        raise UsageError(f"N = {N}{left}: too few steps for an exponent; take at least {LEAST_STEPS}")
    watch.begin("lyapunov", experiment)
    if spectrum:
        growth = spectrum_of(top, scheme, method, h, N, experiment.y0, discard=skip, watch=watch)
    else:
        growth = growth_of(top, scheme, method, h, N, np.array([experiment.y0], dtype=float), discard=skip)
    exponents, errors = plain(growth.exponents.tolist()), plain(growth.errors.tolist())
    rows = [
        {"number": i, "per unit of time": x if x is None else plus_minus(x, error), "exponent": x, "error": error}
        for i, (x, error) in enumerate(zip(exponents, errors, strict=True), start=1)
    ]
    orbit = _orbit(growth, (skip or 0), h)
    notes, faults = [], []
    if orbit["transient"]:
        notes.append(
            f"the exponents leave out the first {orbit['transient']:g} of T = {growth.T:g}, in which the vector grew "
            "unlike later; --discard 0 includes them"
        )
    if growth.verdicts[0] is Verdict.BROKE_OFF:
        step = orbit["completed_steps"]
        faults.append(f"the orbit broke off at or soon after step {step}: it blew up, or a step did not converge")
    tables = [
        Table("Lyapunov exponents", rows, detail=("exponent", "error")),
        Table("Orbit", [orbit], detail=True),
    ]
    t = growth.t[growth.t > 0.0]
    columns = {"t": t, **{f"exponent_{i}": logs[growth.t > 0.0] / t for i, logs in enumerate(growth.logs.T, start=1)}}
    columns["regular"] = np.log1p(growth.rate[0] * t) / t
    draw = None if faults else partial(_draw, columns, f"{scheme.name}, $h = {h:g}$: {orbit['verdict']}")
    title = f"{scheme.name} on {experiment.name}: {top.title}, h = {h:g}, N = {N}"
    answer = "" if faults else _answer(growth, orbit, rows[0])
    code = ExitCode.FAILED if faults else ExitCode.SUCCESS
    return Report("lyapunov", title, answer, tables, notes, faults, code, experiment.resolved(), columns, draw)


def _orbit(growth: Growth, discarded: int, h: float) -> dict[str, Any]:
    """Verdict of a run on its orbit, and the exponent from which on it would have detected chaos."""
    T = growth.T
    reached = growth.n[np.isfinite(growth.logs).all(axis=1)][-1:].sum()
    return {
        "verdict": str(growth.verdicts[0]),
        "T": T,
        "discarded": discarded * abs(h),
        "transient": T * float(growth.skipped[0]) / TRANSIENT,
        "growth": float(growth.logs[-1, 0]),
        "largest_fall": float(growth.largest_fall[0]),
        "regular_exponent": float(np.log1p(growth.rate[0] * T) / T),
        "detectable": float(growth.detectable[0]),
        "completed_steps": discarded + int(reached),
    }


def _draw(columns: Mapping[str, Any], title: str, axes: Any, looks: Callable[..., Any]) -> None:
    """Draw the finite-time exponents; a single one that stays positive, on a logarithmic axis."""
    t, *exponents, regular = columns.values()
    for i, values in enumerate(exponents, start=1):
        axes.semilogx(t, values, label=rf"$\lambda_{i}$" if len(exponents) > 1 else "exponent")
    axes.semilogx(t, regular, color="0.5", label=r"regular orbit: $\ln(t)/t$")
    if len(exponents) == 1 and (exponents[0] > 0.0).all():
        axes.set_yscale("log")
    axes.set(xlabel="time $t$", ylabel="exponent per unit of time", title=title)


def _answer(growth: Growth, orbit: Mapping[str, Any], first: Mapping[str, Any]) -> str:
    """The verdict, and what it rests on."""
    T, G, regular = orbit["T"], orbit["growth"], orbit["regular_exponent"]
    grew, largest = f"the tangent vector grew by a factor exp({G:.1f}) over T = {T:g}", first["per unit of time"]
    falls = growth.largest_fall[0]
    linear = "no faster than in proportion to t"
    slow = linear if regular * T + REGULAR > G else "but not exponentially: it fell back, or came to an end"
    times = first["exponent"] / regular if regular else math.inf  # at rest
    stable = "unstable" if first["exponent"] > first["error"] else "not unstable, as far as the run tells"
    undecided = f"{grew}, as on a regular or a weakly chaotic orbit; run longer, e.g. 10 times N"
    if falls > DEEP:
        undecided = (
            f"{grew}, with falls by factors down to exp(-{falls:.0f}), as next to a separatrix; there, round-off may "
            "decide how the orbit goes on"
        )
    verdict = growth.verdicts[0]
    reasons = {
        Verdict.REGULAR: f"{grew}, {slow}; the run would have detected an exponent above {orbit['detectable']:.2g}",
        Verdict.CHAOTIC: f"the largest exponent is {largest} (95 %) per unit of time, "
        f"{times:.1f} times the value ln(t)/t = {regular:.2g} of a regular orbit of the same "
        "length",
        Verdict.EQUILIBRIUM: f"the orbit is at rest, and {stable}: {grew}, at a rate of {largest}",
        Verdict.UNSTABLE: f"{grew}, at a rate of {largest}, but the orbit repeats itself: it is periodic or "
        "quasi-periodic, or its chaos is confined to narrow bands",
        Verdict.ESCAPING: f"{grew}, at a rate of {largest}, but the orbit is not chaotic so far: it has not come back; "
        "it runs off, or leaves an unstable motion",
    }
    return f"{verdict}: {reasons.get(verdict, undecided)}"
