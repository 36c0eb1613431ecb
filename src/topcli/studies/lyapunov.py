"""``topcli lyapunov``: Lyapunov exponents of a scheme along an orbit, and whether the orbit is regular or chaotic."""

from __future__ import annotations

import math
from collections.abc import Iterator
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
    spectrum: Annotated[bool, Flag("--spectrum")] = False,
    overrides: Overrides = (),
    watch: Watch = SILENT,
) -> Result:
    """Measure Lyapunov exponents; tell regular from chaotic.

    Follow a tangent vector along the orbit of a config, by the tangent map of its scheme, and judge its growth. With
    several vectors the whole spectrum is measured.

    Parameters
    ----------
    config : path or str
        Config file or name of a packaged scene.
    spectrum : bool, optional
        Measure as many exponents as the state has components.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` has a row for each exponent; ``series`` the finite-time exponents over t.

    Raises
    ------
    UsageError
        For a scheme without a tangent map, and for too few steps.

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


def notes(data: Data) -> Iterator[str]:
    """The verdict, and what it rests on."""
    T, detectable = data["T"], data["detectable"]
    if data["verdict"] == "regular":
        yield (
            f"regular: the tangent vector grew by exp({data['growth']:.1f}) over T = {T:g}, in proportion to t; "
            f"a chaotic orbit with an exponent above {detectable:.2g} would have shown"
        )
    elif data["verdict"] == "chaotic":
        yield (
            f"chaotic: the exponent is {data['exponents'][0] / data['regular_exponent']:.1f} times that of a regular "
            f"orbit of the same length, ln(t)/t = {data['regular_exponent']:.2g}"
        )
    elif data["verdict"] == "undecided":
        yield f"undecided: the growth exp({data['growth']:.1f}) over T = {T:g} fits both; run longer, e.g. 10 times N"


def head(data: Data) -> Head:
    """Head of the chapter."""
    return Head("Lyapunov exponents", _subject(data), data["verdict"], data["verdict"] != "broke off")


def faults(data: Data) -> Faults:
    """An orbit that broke off."""
    if data["verdict"] != "broke off":
        return Faults()
    steps = data["completed_steps"]
    return Faults(
        ExitCode.FAILED, [f"the orbit broke off after {steps} steps or soon after: it blew up or did not converge"]
    )


LYAPUNOV = Study(
    "lyapunov",
    measure,
    head,
    (TABLE,),
    notes=notes,
    faults=faults,
    figure="topcli.figures.chaos:loaded_lyapunov",
    draws="the finite-time exponents over t",
    captions=("finite-time exponents, and the exponent of a regular orbit",),
    stem=lambda data: f"{data['config']['scheme']['name']}_{data['config']['name']}",
    parts=lambda data: parts_of(data["config"], [data["config"]["scheme"]["name"]]),
)
