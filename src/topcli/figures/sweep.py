"""Figures of sweeps: a measure as curves over one key, or as colours over two keys."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.order import convergence
from topcli.errors import UsageError
from topcli.figures.figure import Figure
from topcli.figures.style import labelled, looks, plain_text
from topcli.schemes.display import display_name
from topcli.schemes.registry import all_schemes
from topcli.store.files import sha256_of
from topcli.sweeps.aggregates import SPREADS, Frame, names_hint, read_rows, require_names, sweep_cells
from topcli.sweeps.measures import in_words

KEYS_IN_WORDS = {"h": "step size h", "N": "number of steps N", "T": "time T"}
"""Keys of a config in words."""
LARGEST_VALUE = 1e10
"""Larger values, of runs that explode, are not drawn but counted in the title."""
DEEPEST = 1e-10
"""A scale with two signs is linear up to the smallest magnitude, or up to this part of the largest."""
KINDS = ("scheme", "top")
"""Keys over whose values no median is taken."""
MOST_CURVES = 12
"""Largest number of curves of a picture that nobody chose."""
Scale = Mapping[str, Any]
"""Arguments of ``Axes.set_yscale``."""


def scale_of(values: np.ndarray) -> Scale:
    """Scale that shows ``values`` (m,): more than two decades are logarithmic, on both sides of zero if need be."""
    sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
    if not len(sizes) or sizes.max() <= 100.0 * sizes.min():
        return {"value": "linear"}
    if (values < 0.0).any():
        return {"value": "symlog", "linthresh": max(float(sizes.min()), DEEPEST * float(sizes.max()))}
    return {"value": "log"}


def is_geometric(values: np.ndarray) -> bool:
    """True for three or more positive numbers whose ratios are more even than their differences."""
    at = np.unique(values)
    if len(at) < 3 or at[0] <= 0.0:
        return False
    ratios, gaps = np.diff(np.log(at)), np.diff(at)
    return bool(ratios.std() / ratios.mean() < gaps.std() / gaps.mean())


@dataclass(frozen=True)
class Choice:
    """Content of the figure: the measure ``y`` over ``x`` for each value of ``by``; or ``colour`` over x and y."""

    x: str
    y: str
    by: str | None = None
    colour: str | None = None
    aggregate: str | None = None

    @property
    def measure(self) -> str:
        """Measure that is drawn."""
        return self.colour or self.y


def usual_choices(rows: Frame) -> Iterator[Choice]:
    """Yield a choice for each measure: over the numeric key with most values, with a curve for each scheme or top.

    Without them the curves are those of the next key if it has few values. Values of rows that differ in other keys are
    combined by their median. There is no choice if no key varies.
    """
    counts = {key: count for key in rows.attrs["keys"] if (count := rows[key].nunique(dropna=False)) > 1}
    varied = sorted(counts, key=lambda key: -counts[key])
    if not varied:
        return
    x = next((key for key in varied if rows[key].dtype.kind in "fi"), varied[0])
    others = [key for key in (*KINDS, *varied) if key in counts and key != x]
    by = next((key for key in others if key in KINDS or counts[key] <= MOST_CURVES), None)
    aggregate = "median" if rows.duplicated([key for key in (x, by) if key]).any() else None
    for measure in rows.attrs["measures"]:
        if np.isfinite(rows[measure]).any():
            yield Choice(x, measure, by, aggregate=aggregate)


@dataclass(frozen=True)
class Points:
    """Points of a figure: ``table`` has their ``value`` and the ends ``low`` and ``high`` of its spread, by the keys.

    They are of ``rows`` rows, of which ``missing`` have no value.
    """

    choice: Choice
    table: Frame
    rows: int
    missing: int

    @property
    def height(self) -> float:
        """Height of a figure in inches, with room for a legend of all curves."""
        by = self.choice.by
        return min(9.4, max(3.8, 0.21 * self.table.index.get_level_values(by).nunique())) if by else 3.8


def points_of(rows: Frame, choice: Choice) -> Points:
    """Points of a choice, as ``topcli table`` combines the rows.

    Raises UnknownNameError for other names than those of the rows, and UsageError for several rows at one point.
    """
    import pandas as pd

    if choice.by and choice.colour:
        raise UsageError("--colour and --by cannot be combined: a heat map has no curves")
    keys = [name for name in (choice.x, choice.y if choice.colour else choice.by) if name]
    require_names(rows, "key", keys, "--x and --y" if choice.colour else "--x and --by")
    require_names(rows, "measure", [choice.measure], "--colour" if choice.colour else "--y")
    cells = sweep_cells(rows, keys, None, [choice.measure], choice.aggregate)[choice.measure]
    ends = [(*cell, *[np.nan] * 3)[:3] for cell in cells]
    table = pd.DataFrame(ends, cells.index, ["value", "low", "high"], dtype=float)
    return Points(choice, table, len(rows), int(rows[choice.measure].isna().sum()))


def sweep_figure(folder: Path, where: Sequence[str], x: str | None, y: str | None, **parts: str | None) -> Figure:
    """The figure of ``topcli plot sweep``: a choice of the rows that satisfy ``where`` of the sweep in ``folder``.

    ``parts`` are the further attributes of ``Choice``. Raises UsageError for a choice that the rows do not have.
    """
    rows = read_rows(folder, where)
    if x is None or y is None:
        hint = "plot sweep: give --x KEY and --y MEASURE, or --x KEY --y KEY --colour MEASURE"
        raise UsageError(hint, names_hint(rows))
    choice = Choice(x, y, **parts)
    points, sweep = points_of(rows, choice), rows.attrs["name"]
    over = ["by", choice.by] if choice.by else [y] * bool(choice.colour)
    name = "_".join([sweep, choice.measure, "over", x, *over]).replace("/", "-")
    columns = {str(key): values.to_numpy() for key, values in points.table.reset_index().items()}
    takes = f"{sha256_of(Path(rows.attrs['path']))} {where} {choice}"
    return Figure(
        name,
        f"{choice.measure} of {sweep}",
        lambda: columns,
        lambda canvas, columns: draw_sweep(canvas.subplots(), points, ", ".join([sweep, *where])),
        (6.4, points.height),
        lambda: takes,
    )


def draw_sweep(axes: Any, points: Points, title: str = "") -> None:
    """Draw points; the title has the number of values that are missing or have no place on the scale."""
    choice, table = points.choice, points.table
    values = table["value"].to_numpy()
    drawn = np.abs(values) <= LARGEST_VALUE
    scale = scale_of(values[drawn])
    drawn &= (values > 0.0) | (scale["value"] != "log")
    missing = {"values": points.missing, "points": int((~drawn & ~np.isnan(values)).sum())}
    totals = {"values": points.rows, "points": len(values)}
    if not choice.aggregate:  # each value is a point
        missing = {"values": sum(missing.values())}
    lost = [f"{count} of {totals[what]} {what} not shown" for what, count in missing.items() if count]
    title = ", ".join(filter(None, [title, *lost]))

    around = "" if choice.colour else SPREADS.get(choice.aggregate or "")
    label = plain_text(in_words(choice.measure)) + (f" ({choice.aggregate}{around})" if choice.aggregate else "")
    if choice.colour:
        _heat(axes, table["value"].where(drawn).unstack(choice.x), scale, label)
    else:
        _curves(axes, table[drawn], scale, choice)
    x, y = (KEYS_IN_WORDS.get(key, plain_text(key)) for key in (choice.x, choice.y))
    labelled(axes, x, y if choice.colour else label, plain_text(title))


def _texts(values: Sequence[Any]) -> list[str]:
    """Names of keys on an axis; those of schemes as people read them."""
    return [f"{value:.4g}" if isinstance(value, float) else plain_text(display_name(str(value))) for value in values]


def _heat(axes: Any, table: Frame, scale: Scale, label: str) -> None:
    """Draw a table as cells; values of both signs have two hues, and cells without a value are grey."""
    from matplotlib.colors import LogNorm, Normalize, SymLogNorm

    # numbers in their order, names from top to bottom
    table = table.sort_index(axis=1) if table.columns.dtype.kind in "fi" else table
    table = table.sort_index() if table.index.dtype.kind in "fi" else table[::-1]
    values = np.ma.masked_invalid(table.to_numpy(dtype=float))
    both, bound = (values < 0.0).any() and (values > 0.0).any(), np.abs(values).max()
    norm: Any = Normalize(-bound, bound) if both else Normalize()
    if scale["value"] != "linear":
        norm = LogNorm() if scale["value"] == "log" else SymLogNorm(scale["linthresh"], vmin=-bound, vmax=bound)
    axes.set_facecolor("0.85")
    axes.grid(visible=False)
    axes.tick_params(which="both", direction="out", top=False, right=False)  # the cells would cover them
    mesh = axes.pcolormesh(values, norm=norm, cmap="RdBu_r" if both or scale["value"] == "symlog" else "viridis")
    axes.figure.colorbar(mesh, ax=axes, label=label, pad=0.02)
    for ticks, names in ((axes.set_xticks, table.columns), (axes.set_yticks, table.index)):
        at = np.arange(0, len(names), max(1, len(names) // 12))
        ticks(at + 0.5, _texts(names[at].tolist()))
    axes.tick_params(axis="x", rotation=90 if table.shape[1] > 5 else 0)


def _curves(axes: Any, table: Frame, scale: Scale, choice: Choice) -> None:
    """Draw the curves; if both axes are logarithmic, the legend has the slopes above the plateau of round-off."""
    at = table.index.get_level_values(choice.x)
    names = [] if at.dtype.kind in "fiu" else list(at.unique())
    logs = not names and is_geometric(at.dropna().to_numpy(dtype=float))
    axes.set_xscale("log" if logs else "linear")
    axes.set_yscale(**scale)
    adaptive = {scheme.name for scheme in all_schemes() if scheme.adaptive}
    groups = dict(iter(table.groupby(choice.by, sort=False, dropna=False))) if choice.by else {choice.y: table}
    styles = looks(map(str, groups), markers=True)
    for i, (key, curve) in enumerate(groups.items()):
        # markers of later curves are smaller, and names have one after the other, so that all are seen
        style = styles[str(key)] | {"markersize": 4.6 - 1.8 * i / len(groups)}
        text = plain_text(display_name(str(key)))
        if choice.by and isinstance(key, float | int):
            text = f"{choice.by} = {key:.6g}"
        curve = curve if names else curve.sort_index(level=choice.x)
        x, value = curve.index.get_level_values(choice.x).to_numpy(), curve["value"].to_numpy()
        if names:
            beside = (i - 0.5 * (len(groups) - 1)) * min(0.12, 0.7 / len(groups))
            x, style["linestyle"] = np.array([names.index(name) for name in x]) + beside, "none"
        if logs and scale["value"] == "log" and not (choice.x == "h" and key in adaptive):
            order = convergence(x.tolist(), value.tolist()).order
            text += "" if order is None else f": {order:.2f}".replace("-", "−")
        axes.plot(x, value, label=text, **style)
        if names and choice.aggregate:
            spread = [value - curve["low"], curve["high"] - value]
            axes.errorbar(x, value, spread, color=style["color"], fmt="none", elinewidth=0.9, capsize=2.0)
        elif choice.aggregate:
            axes.fill_between(x, curve["low"], curve["high"], color=style["color"], alpha=0.18, linewidth=0.0)
    if names:
        axes.set_xlim(-0.5, len(names) - 0.5)
        axes.set_xticks(range(len(names)), _texts(names), rotation=90 if len(names) > 5 else 0)
    if choice.by and groups:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), fontsize="small")
