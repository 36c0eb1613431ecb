"""``topcli lyapunov``: measure the Lyapunov exponents of an orbit, and decide whether it is regular or chaotic."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from topcli.errors import ExitCode
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
    watch: Watch = SILENT,
) -> Result:
    """Measure Lyapunov exponents and detect chaos.

    The study follows a tangent vector along the orbit of a config with the tangent map (the derivative of a step) of
    the scheme. The growth of this vector decides whether the orbit is regular or chaotic. With the option
    spectrum, the study follows as many tangent vectors as the state has components.

    Parameters
    ----------
    config : path or str
        Config file or name of a packaged scene.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    spectrum : bool, optional
        Measure as many exponents as the state has components.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report on the exponents. ``table`` has a row for each exponent. ``series`` contains the finite-time exponents as
        functions of t. ``study["verdict"]`` is ``"regular"``, ``"chaotic"`` or ``"undecided"``.

    Raises
    ------
    UsageError
        If the scheme has no tangent map, or if the number of steps is too small.

    Examples
    --------
    >>> import topcli
    >>> topcli.lyapunov("kowalevski_generic_hk", overrides=["N=20000"]).study["verdict"]
    'regular'
    """
    import numpy as np

    from topcli.analysis.lyapunov import LEAST_STEPS, growth_of, spectrum_of
    from topcli.config.load import load_experiment
    from topcli.errors import UsageError
    from topcli.runs.report import finite

    experiment = load_experiment(config, overrides)
    if experiment.N < LEAST_STEPS:
        raise UsageError(f"N = {experiment.N}: too few steps for an exponent; take at least {LEAST_STEPS}")
    top, scheme, method, h, N = experiment.top, experiment.scheme, experiment.method(), experiment.h, experiment.N
    watch.begin("lyapunov", experiment)
    y0 = np.array(experiment.y0, dtype=float)
    if spectrum:
        growth = spectrum_of(top, scheme, method, h, N, y0.tolist(), watch=watch)
    else:
        growth = growth_of(top, scheme, method, h, N, y0[None])
    return Result(
        {"config": experiment.resolved(), **finite(_figures(growth))},
        {"t": growth.t, **{f"exponent_{i + 1}": logs / growth.t for i, logs in enumerate(growth.logs.T)}},
        source=lambda: experiment.digest,
    )


def _figures(growth: Growth) -> Data:
    """Exponents and verdict of an orbit."""
    import numpy as np

    t = float(growth.t[-1])
    verdict = growth.verdicts[0]
    last = int(growth.n[np.isfinite(growth.logs).all(axis=1)][-1:].sum())
    return {
        "T": t,
        "exponents": growth.exponents.tolist(),
        "errors": growth.errors.tolist(),
        "growth": float(growth.logs[-1, 0]),
        "regular_exponent": float(np.log1p(growth.rate[0] * t) / t),
        "detectable": float(growth.detectable[0]),
        "verdict": str(verdict),
        "completed_steps": last,
    }


def _rows(data: Data) -> list[Data]:
    pairs = zip(data["exponents"], data["errors"], strict=True)
    return [{"number": i + 1, "exponent": x, "error": error} for i, (x, error) in enumerate(pairs)]


def _subject(data: Data) -> str:
    config = data["config"]
    return (
        f"{config['scheme']['name']} on {config['name']}: {top_title(config)}, h = {config['h']:g}, N = {config['N']}"
    )


def _with_error(row: Data) -> str:
    x, error = row["exponent"], row["error"]
    if x is None:
        return "none"
    digits = max(0, 1 - math.floor(math.log10(error))) if error > 0.0 else 6
    return f"{x:.{digits}f} ± {error:.{digits}f}"


TABLE = Table(
    _rows,
    (
        Column("exponent", "number", key="number"),
        Column("per unit of time", _with_error),
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
    T, detectable = data["T"], data["detectable"]
    if data["verdict"] == "regular":
        return (
            f"regular: the tangent vector grew in proportion to t, by a factor exp({data['growth']:.1f}) over "
            f"T = {T:g}; the run would have detected an exponent above {detectable:.2g}"
        )
    if data["verdict"] == "chaotic":
        return (
            f"chaotic: the largest exponent is {_with_error(_rows(data)[0])} per unit of time, "
            f"{data['exponents'][0] / data['regular_exponent']:.1f} times the value ln(t)/t = "
            f"{data['regular_exponent']:.2g} of a regular orbit of the same length"
        )
    if data["verdict"] == "undecided":
        return (
            f"undecided: the tangent vector grew by a factor exp({data['growth']:.1f}) over T = {T:g}, as on a regular "
            "or a weakly chaotic orbit; run longer, e.g. 10 times N"
        )
    return ""


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
    faults=faults,
    figure="topcli.figures.chaos:loaded_lyapunov",
    draws="the finite-time exponents over t",
    captions=("finite-time exponents, and the exponent of a regular orbit",),
    stem=lambda data: f"{data['config']['scheme']['name']}_{data['config']['name']}",
    parts=lambda data: parts_of(data["config"], [data["config"]["scheme"]["name"]]),
)
