"""``topcli roundoff``: growth of round-off in conserved quantities with plain and compensated sums, and its cost.

Independent rounding errors add up as the square root of the number of steps (Brouwer 1937), biased ones in proportion
to it. The deviation X of an invariant is averaged over blocks of steps, which takes out the rounding of its evaluation
and, because the weights (``frequencies.weights``) vanish with all their derivatives at both ends of a block, any quasi-
periodic oscillation much faster than a block. The root mean square of X(n + lag) - X(n), over all n and over copies of
the run whose states differ in the last two digits and hence in every rounding, is fitted by a power of the lag.

*random walk*  the power is compatible with 1/2: ``WALK`` is above the lower end of its confidence interval.
*biased*       the whole interval is above ``WALK``: errors of one sign add up.
*flat*         it is below ``FLAT``: nothing adds up, later steps undo the errors of earlier ones.
*moves*        the differences are far too large to be round-off: the invariant is not conserved.

The errors follow from the scatter of the copies (jackknife).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from topcli.analysis.frequencies import weights
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Floats, Invariant, Outcome, Sampler
from topcli.engine.timing import nanoseconds_per_step
from topcli.errors import ExitCode, UsageError, counted
from topcli.runs.simulate import simulate
from topcli.studies import SILENT, Watch
from topcli.studies.entries import SCENE, SCHEME, entry_named, refuse_keys
from topcli.studies.report import Report, Table
from topcli.table import Row, two_digits

BLOCKS, ROWS = 1024, 16
"""Largest number of blocks of a run, and rows that are recorded in each."""
SHIFT = 1e-14
"""Relative differences between the initial states of the copies."""
WALK = 0.6
FLAT = 0.3
MOVES = 1e3
"""Round-off is at most this many times the last bit of the invariant's terms and the root of the number of steps."""
MIN_BLOCKS = 16

_EPS = float(np.finfo(np.float64).eps)


def roundoff(
    scheme: str,
    *,
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    steps: int = 10_000_000,
    copies: int = 8,
    watch: Watch = SILENT,
) -> Report:
    """Measure growth of round-off, and cost of compensated sums.

    Round-off in the invariants that the scheme conserves exactly may grow as a random walk, linearly because of a bias,
    or not at all. If the scheme has a form with compensated summation, both forms are measured.

    Parameters
    ----------
    scheme : str
        Name of a scheme, with options if needed.
    config : path, str or mapping, optional
        Config of the experiment; by default, a generic motion of the Kowalevski top at h = 0.01.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01 or top.c0=-1.
    steps : int, optional
        Set the number of steps of each run, e.g. 1e8.
    copies : int, optional
        Make this many runs, from initial states that differ by up to 1e-14 of their values.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        The table has a row for each invariant with plain sums, and another with compensated sums. Round-off grows as
        the number of steps to the power of the exponent: 1/2 for a random walk, 1 for a bias. Errors are half the
        widths of confidence intervals of 95 %.

    Raises
    ------
    UsageError
        If the scheme is unknown, does not fit the config, conserves nothing exactly or takes no steps, or if the number
        of steps is too small.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.roundoff("hk", config="euler_hk", steps=20_000, copies=2)
    >>> sorted(set(report.table["sums"]))
    ['compensated', 'plain']
    """
    if steps < (least := MIN_BLOCKS * ROWS):
        raise UsageError(f"--steps {steps}: too few for a fit of the growth; give at least {least}")
    if copies < 2:
        raise UsageError(f"--copies {copies}: must be at least 2")
    refuse_keys(overrides, {**SCHEME, **dict.fromkeys("NT", "the number of steps is set by --steps")})
    scene, first = (SCENE, ["h=0.01"]) if config is None else (config, [])
    base = load_experiment(scene, [*first, *overrides])
    blocks = min(BLOCKS, steps // ROWS)
    every = steps // (blocks * ROWS)
    forms = {name: _lasting(form, every, blocks * ROWS) for name, form in _forms(base, scheme).items()}
    invariants = _conserved(forms["plain"], scheme)
    watch.begin("roundoff", base, unit="runs")
    # before the runs, which heat the processor; thread time does not depend on other threads
    nanoseconds = nanoseconds_per_step([(form.top, form.method(), form.y0, form.h) for form in forms.values()])
    rows: list[Row] = []
    columns: dict[str, Array] = {}
    errors: list[str] = []
    for (name, form), cost in zip(forms.items(), nanoseconds, strict=True):
        run = simulate(form.resolved(), states=_copies(base.y0, copies))
        failed = np.flatnonzero(~run.endings.is_(Outcome.COMPLETED))
        if len(failed):
            errors.append(f"{scheme} with {name} sums: {run.endings[int(failed[0])].message}")
        for invariant in () if len(failed) else invariants:
            means, scale = _block_means(invariant, run.states, blocks)
            fit = growth(means, ROWS * every, scale)
            rows.append({
                "invariant": invariant.symbol, "sums": name,
                "rms_drift": float(np.sqrt(np.mean(means[:, -1] ** 2))), "largest_drift": float(np.abs(means).max()),
                "exponent": fit.exponent, "exponent_error": fit.exponent_error, "growth": fit.verdict,
                "bias_per_step": fit.bias, "bias_error": fit.bias_error,
                "ns_per_step": cost, "cost": cost / nanoseconds[0],
            })  # fmt: skip
            columns |= {"steps": np.array(fit.steps), f"{invariant.symbol} {name}": np.array(fit.rms)}
        watch(1 + [*forms].index(name), len(forms))
    symbols = [invariant.symbol for invariant in invariants]
    rows.sort(key=lambda row: symbols.index(row["invariant"]))
    small = dict.fromkeys(("rms_drift", "largest_drift", "bias_per_step", "bias_error"), two_digits)
    formats = {**small, "exponent": ".2f", "exponent_error": ".2f", "ns_per_step": ".1f", "cost": ".2f"}
    table = Table("Growth of round-off", rows, formats, ("largest_drift", "bias_per_step", "bias_error"))
    size = f"{counted(every * blocks * ROWS, 'step')}, {counted(copies, 'copy')}"
    title = f"{scheme} on {base.name}: {base.top.title}, h = {base.h:g}, {size}"
    code, resolved = ExitCode.FAILED if errors else ExitCode.SUCCESS, forms["plain"].resolved()
    draw = partial(_draw, symbols, columns, base.name) if columns else None
    return Report("roundoff", title, _answer(rows), [table], (), errors, code, resolved, columns, draw)


def _copies(y0: Floats, count: int) -> Array:
    """Initial states (count, d): the first as it is, the others with changes in the last digits."""
    random, y = np.random.default_rng(1), np.array(y0)
    return np.array([y, *(y * (1.0 + SHIFT * random.uniform(-1.0, 1.0, len(y))) for _ in range(count - 1))])


def _block_means(invariant: Invariant, states: Array, blocks: int) -> tuple[Array, float]:
    """Weighted means (copies, blocks) of the deviation of an invariant, and the largest size of its terms."""
    values = np.array([invariant.value(copy) for copy in states])
    deviations = (values[:, 1:] - values[:, :1]).reshape(len(states), blocks, ROWS)
    return deviations @ weights(ROWS), max(float(invariant.scale(copy).max()) for copy in states)


def _draw(
    symbols: Sequence[str], columns: Mapping[str, Array], title: str, axes: Any, looks: Callable[..., Any]
) -> None:
    """Draw the drifts of each invariant over the number of steps, dashed with compensated sums."""
    styles = looks(symbols, markers=True)
    for label, drifts in columns.items():
        symbol, _, sums = label.rpartition(" ")
        if symbol in styles and drifts.max() > 0.0:
            line = {**styles[symbol], "linestyle": "-" if sums == "plain" else "--"}
            axes.loglog(columns["steps"], drifts, label=label, markersize=4, **line)
    guide = 2.0**-52 * np.sqrt(columns["steps"])
    axes.loglog(columns["steps"], guide, color="0.6", linestyle="-", linewidth=0.9, label=r"$\epsilon\sqrt{N}$")
    axes.set(xlabel="number of steps", ylabel="drift (rms)", title=title.replace("$", r"\$"))


def _forms(base: Experiment, scheme: str) -> dict[str, Experiment]:
    """Experiment with plain and, if the scheme and its options allow it, with compensated sums."""
    plain = entry_named(base, scheme)
    if isinstance(plain.method(), Sampler):
        raise UsageError(f"scheme {scheme!r} is a closed form, which has no steps with errors that add up")
    if "compensated" not in type(plain.options).model_fields:
        return {"plain": plain}
    sums = scheme + (",compensated=" if ":" in scheme else ":compensated=")
    try:
        return {"plain": entry_named(base, f"{sums}false"), "compensated": entry_named(base, f"{sums}true")}
    except UsageError:  # an option that cannot be combined with it
        return {"plain": plain}


def _lasting(experiment: Experiment, every: int, rows: int) -> Experiment:
    """``experiment`` with this many rows after the first, one every ``every`` steps."""
    output = experiment.output.model_copy(update={"every": every})
    return experiment.model_copy(update={"N": rows * every, "output": output})


def _conserved(experiment: Experiment, scheme: str) -> list[Invariant]:
    """Invariants of the top and of the scheme that stay but for round-off. Raises UsageError if there are none."""
    conserved = [each for each in experiment.top.invariants() if each.name in experiment.scheme.conserves]
    if invariants := [*conserved, *experiment.modified]:
        return invariants
    raise UsageError(
        f"scheme {scheme!r} conserves nothing exactly on {experiment.name}, so that round-off cannot be told from its "
        "own drift; see the drifts of topcli run"
    )


def _answer(rows: Sequence[Mapping[str, Any]]) -> str:
    """Growth with each form of the sums; gain and cost of the compensated form."""
    parts = []
    for sums in dict.fromkeys(row["sums"] for row in rows):
        named: dict[str, list[str]] = {}
        for row in rows:
            if row["sums"] == sums:
                named.setdefault(row["growth"], []).append(row["invariant"])
        parts.append(f"{sums} sums: " + ", ".join(f"{kind} ({', '.join(names)})" for kind, names in named.items()))
    plain, better = ([row for row in rows if row["sums"] == sums] for sums in ("plain", "compensated"))
    gains = sorted(
        a["rms_drift"] / b["rms_drift"]
        for a, b in zip(plain, better, strict=False)
        if a["rms_drift"] and b["rms_drift"]
    )
    if gains:
        parts[-1] += f", drifts {two_digits(gains[0])} to {two_digits(gains[-1])} times smaller"
        parts[-1] += f" at {better[0]['cost']:.2f} times the cost"
    return "; ".join(parts)


@dataclass(frozen=True)
class RoundOffGrowth:
    """Growth of one invariant's round-off; dimensionless, and None where there is no fit.

    ``rms[i]`` is the root mean square of the drift over ``steps[i]`` steps. ``bias`` is the mean drift per step. The
    errors are half the widths of confidence intervals of 95 %.
    """

    steps: list[int]
    rms: list[float]
    exponent: float | None
    exponent_error: float | None
    bias: float
    bias_error: float
    verdict: str


def growth(means: Array, block_steps: int, scale: float) -> RoundOffGrowth:
    """Growth estimated from block means of the deviation, (copies, blocks), of ``block_steps`` steps per block.

    ``scale`` is the size of the terms that make up the invariant. Raises ValueError for fewer than 16 blocks or two
    copies.
    """
    copies, blocks = means.shape
    if blocks < MIN_BLOCKS or copies < 2:
        raise ValueError(f"{blocks} blocks of {copies} copies: at least {MIN_BLOCKS} blocks of two copies are needed")
    # a mean over a block blurs what happens within one: lags 2, 4, 8, ...
    lags = 2 ** np.arange(1, int(math.log2(blocks / 2)) + 1)
    squares = np.stack([np.mean((means[:, lag:] - means[:, :-lag]) ** 2, axis=1) for lag in lags], axis=1)
    others = (squares.sum(axis=0) - squares) / (copies - 1)  # without one copy
    rms = np.sqrt(squares.mean(axis=0))
    quantile = float(stdtrit(copies - 1, 0.975))
    exponent = error = None
    if others.min() > 0.0:
        exponent = float(np.polyfit(np.log(lags), np.log(rms), 1)[0])
        scatter = 0.5 * np.polyfit(np.log(lags), np.log(others).T, 1)[0]
        error = quantile * math.sqrt(copies - 1) * float(scatter.std())
    drifts = (means[:, -1] - means[:, 0]) / (blocks - 1) / block_steps
    return RoundOffGrowth(
        steps=(lags * block_steps).tolist(),
        rms=rms.tolist(),
        exponent=exponent,
        exponent_error=error,
        bias=float(drifts.mean()),
        bias_error=quantile * float(drifts.std()) / math.sqrt(copies - 1),
        verdict=_verdict(exponent, error, float(rms.max()) / (_EPS * math.sqrt(blocks * block_steps) * (scale or 1.0))),
    )


def _verdict(exponent: float | None, error: float | None, size: float) -> str:
    if size > MOVES:
        return "moves"
    if exponent is None or error is None or exponent < FLAT:
        return "flat"
    return "biased" if exponent - error > WALK else "random walk"
