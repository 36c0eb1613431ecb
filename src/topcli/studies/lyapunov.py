"""``topcli lyapunov``: measure the Lyapunov exponents of an orbit, and decide whether it is regular or chaotic."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from topcli.errors import ExitCode, UsageError
from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Faults, Flag, Head, Overrides, Result, Study, parts_of, top_title
from topcli.table import Column, Table

if TYPE_CHECKING:
    from topcli.analysis.lyapunov import Growth


def measure(
    config: Annotated[str | Path, Flag("", "CONFIG")],
    overrides: Overrides = (),
    *,
    spectrum: Annotated[bool, Flag("--spectrum")] = False,
    discard: Annotated[float | None, Flag("--discard", "T", default="a transient, if there is one")] = None,
    watch: Watch = SILENT,
) -> Result:
    """Measure Lyapunov exponents and detect chaos.

    The study follows a tangent vector along the orbit of a config with the tangent map (the derivative of a step) of
    the scheme. The growth of this vector and the recurrence of the orbit decide whether the orbit is regular or
    chaotic. With the option spectrum, the study follows as many tangent vectors as the state has components.

    Parameters
    ----------
    config : path or str
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
    StudyReport
        Report on the exponents. ``table`` has a row for each exponent. ``series`` contains the finite-time exponents as
        functions of t. ``study["errors"]`` are half the widths of their confidence intervals of 95 %.
        ``study["verdict"]`` is ``"regular"``, ``"chaotic"``, ``"undecided"``, ``"equilibrium"``, ``"unstable"`` (an
        unstable periodic or quasi-periodic orbit), ``"escaping"`` or ``"broke off"``.

    Raises
    ------
    UsageError
        If the scheme has no tangent map, if the number of steps is too small, or if a step stretches tangent vectors
        too differently for a spectrum.

    Examples
    --------
    >>> import topcli
    >>> topcli.lyapunov("kowalevski_generic_hk", overrides=["N=20000"]).study["verdict"]
    'regular'
    """
    import numpy as np

    from topcli.analysis.lyapunov import LEAST_STEPS, growth_of, spectrum_of
    from topcli.config.load import load_experiment
    from topcli.runs.report import finite

    experiment = load_experiment(config, overrides)
    top, scheme, method, h, N = experiment.top, experiment.scheme, experiment.method(), experiment.h, experiment.N
    skip = None if discard is None else discarded_steps(discard, h, N)
    if N - (skip or 0) < LEAST_STEPS:
        left = f" after --discard {discard:g}" if skip else ""
        raise UsageError(f"N = {N}{left}: too few steps for an exponent; take at least {LEAST_STEPS}")
    watch.begin("lyapunov", experiment)
    y0 = np.array(experiment.y0, dtype=float)
    if spectrum:
        growth = spectrum_of(top, scheme, method, h, N, y0.tolist(), discard=skip, watch=watch)
    else:
        growth = growth_of(top, scheme, method, h, N, y0[None], discard=skip)
    return Result(
        {"config": experiment.resolved(), **finite(_figures(growth, skip or 0))},
        {"t": growth.t, **{f"exponent_{i + 1}": logs / growth.t for i, logs in enumerate(growth.logs.T)}},
    )


def discarded_steps(discard: float, h: float, N: int) -> int:
    """Number of the steps within the time ``discard``. Raises UsageError for a time that is not within N steps."""
    if not 0.0 <= discard <= N * abs(h):
        raise UsageError(f"--discard {discard:g}: must be a time from 0 to T = {N * abs(h):g}")
    return round(discard / abs(h))


def _figures(growth: Growth, skip: int) -> Data:
    """Exponents and verdict of an orbit of which the first ``skip`` steps are left out."""
    import numpy as np

    from topcli.analysis.lyapunov import TRANSIENT

    t = growth.T
    last = int(growth.n[np.isfinite(growth.logs).all(axis=1)][-1:].sum())
    return {
        "T": t,
        "discarded": skip * abs(growth.h),
        "transient": t * float(growth.skipped[0]) / TRANSIENT,
        "exponents": growth.exponents.tolist(),
        "errors": growth.errors.tolist(),
        "growth": float(growth.logs[-1, 0]),
        "largest_fall": float(growth.largest_fall[0]),
        "regular_exponent": float(np.log1p(growth.rate[0] * t) / t),
        "detectable": float(growth.detectable[0]),
        "verdict": str(growth.verdicts[0]),
        "completed_steps": skip + last,
    }


def _rows(data: Data) -> list[Data]:
    pairs = zip(data["exponents"], data["errors"], strict=True)
    return [{"number": i + 1, "exponent": x, "error": error} for i, (x, error) in enumerate(pairs)]


def _subject(data: Data) -> str:
    config = data["config"]
    return (
        f"{config['scheme']['name']} on {config['name']}: {top_title(config)}, h = {config['h']:g}, N = {config['N']}"
    )


def with_error(row: Data) -> str:
    """Exponent of a row with half the width of its interval, to two digits of that."""
    x, error = row["exponent"], row["error"]
    if x is None or error is None:
        return "none"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{x:.{digits}f} ± {error:.{digits}f}"


TABLE = Table(
    _rows,
    (
        Column("exponent", "number", key="number"),
        Column("per unit of time", with_error),
        Column("", "exponent"),
        Column("", "error"),
    ),
    heading="Lyapunov exponents",
    title=_subject,
    index="number",
    numbers=(1,),
)


def answer(data: Data) -> str:
    """The verdict, and what it rests on."""
    from topcli.analysis.lyapunov import DEEP, REGULAR

    verdict, T, growth = data["verdict"], data["T"], data["growth"]
    if verdict == "broke off":
        return ""
    grew, largest = f"the tangent vector grew by a factor exp({growth:.1f}) over T = {T:g}", with_error(_rows(data)[0])
    if verdict == "regular":
        linear = growth < data["regular_exponent"] * T + REGULAR
        how = (
            "no faster than in proportion to t" if linear else "but not exponentially: it fell back, or came to an end"
        )
        return f"regular: {grew}, {how}; the run would have detected an exponent above {data['detectable']:.2g}"
    if verdict == "chaotic":
        return (
            f"chaotic: the largest exponent is {largest} (95 %) per unit of time, "
            f"{data['exponents'][0] / data['regular_exponent']:.1f} times the value ln(t)/t = "
            f"{data['regular_exponent']:.2g} of a regular orbit of the same length"
        )
    if verdict == "equilibrium":
        stability = "unstable" if data["exponents"][0] > data["errors"][0] else "not unstable, as far as the run tells"
        return f"equilibrium: the orbit is at rest, and {stability}: {grew}, at a rate of {largest}"
    if verdict == "unstable":
        return (
            f"unstable: {grew}, at a rate of {largest}, but the orbit repeats itself: it is periodic or "
            "quasi-periodic, or its chaos is confined to narrow bands"
        )
    if verdict == "escaping":
        return (
            f"escaping: {grew}, at a rate of {largest}, but the orbit is not chaotic so far: it has not come back; "
            "it runs off, or leaves an unstable motion"
        )
    if data["largest_fall"] > DEEP:
        return (
            f"undecided: {grew}, with falls by factors down to exp(-{data['largest_fall']:.0f}), as next to a "
            "separatrix; there, round-off may decide how the orbit goes on"
        )
    return f"undecided: {grew}, as on a regular or a weakly chaotic orbit; run longer, e.g. 10 times N"


def notes(data: Data) -> list[str]:
    """A transient that the exponents leave out."""
    if not data["transient"]:
        return []
    return [
        f"the exponents leave out the first {data['transient']:g} of T = {data['T']:g}, in which the vector grew "
        "unlike later; --discard 0 includes them"
    ]


def head(data: Data) -> Head:
    """Head of the chapter."""
    return Head("Lyapunov exponents", _subject(data), data["verdict"], data["verdict"] != "broke off")


def faults(data: Data) -> Faults:
    """An orbit that broke off."""
    if data["verdict"] != "broke off":
        return Faults()
    steps = data["completed_steps"]
    return Faults(
        ExitCode.FAILED,
        [f"the orbit broke off at or soon after step {steps}: it blew up, or a step did not converge"],
    )


LYAPUNOV = Study(
    "lyapunov",
    measure,
    head,
    (TABLE,),
    answer=answer,
    notes=notes,
    faults=faults,
    figure="topcli.figures.chaos:loaded_lyapunov",
    draws="the finite-time exponents over t",
    captions=("finite-time exponents, and the exponent of a regular orbit",),
    stem=lambda data: f"{data['config']['scheme']['name']}_{data['config']['name']}",
    parts=lambda data: parts_of(data["config"], [data["config"]["scheme"]["name"]]),
)
