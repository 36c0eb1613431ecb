"""Figures of sweeps: a measure as curves over one key, or as colours over two keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.order import convergence
from topcli.errors import UsageError
from topcli.figures.figure import Columns, Figure
from topcli.figures.labels import escaped, labelled
from topcli.figures.style import looks
from topcli.schemes.display import display_name
from topcli.schemes.registry import all_schemes
from topcli.sweeps.measures import in_words
from topcli.sweeps.table import SPREADS, Frame, require_names, sweep_table

KEYS_IN_WORDS = {"h": "step size h", "N": "number of steps N", "T": "time T"}
"""Keys of a config in words."""
LARGEST_VALUE = 1e10
"""Larger values, of runs that explode, are not drawn but counted in the title."""
DEEPEST = 1e-10
"""A scale with two signs is linear up to the smallest magnitude, or up to this part of the largest."""
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

    @property
    def keys(self) -> list[str]:
        """Keys of the axes and curves."""
        return [name for name in (self.x, self.y if self.colour else self.by) if name]

    def cells(self, rows: Frame) -> Frame:
        """Value of the measure with its spread for each combination of the keys, as ``topcli table`` combines rows.

        Raises UnknownNameError for other names than those of the rows, and UsageError for several rows at one point.
        """
        if self.by and self.colour:
            raise UsageError("--colour and --by cannot be combined: a heat map has no curves")
        require_names(rows, "key", self.keys, "--x and --y" if self.colour else "--x and --by")
        require_names(rows, "measure", [self.measure], "--colour" if self.colour else "--y")
        return sweep_table(rows, self.keys, None, [self.measure], self.aggregate).values[self.measure]


def sweep_figure(rows: Frame, choice: Choice, title: str, takes: str) -> Figure:
    """The figure of ``topcli plot sweep``: the part of the ``rows`` of a sweep that ``choice`` names.

    ``takes`` is the digest of the rows and conditions. Raises UsageError for a choice that the rows do not have.
    """
    choice.cells(rows)
    sweep = rows.attrs["name"]
    over = ["by", choice.by] if choice.by else choice.keys[1:]
    name = "_".join([sweep, choice.measure, "over", choice.x, *over]).replace("/", "-")

    def draw(canvas: Any, columns: Columns) -> None:
        import pandas as pd

        stored = pd.DataFrame(dict(columns))
        stored.attrs = rows.attrs
        draw_sweep(canvas.subplots(), stored, choice, title)

    def data() -> Columns:
        return {key: rows[key].to_numpy() for key in dict.fromkeys([*rows.attrs["keys"], choice.measure, "outcome"])}

    takes = f"{takes} {choice}"
    return Figure(name, f"{choice.measure} of {sweep}", data, draw, (6.4, height_of(rows, choice)), lambda: takes)


def height_of(rows: Frame, choice: Choice) -> float:
    """Height of a figure in inches, with room for a legend of all curves."""
    return min(9.4, max(3.8, 0.21 * rows[choice.by].nunique(dropna=False))) if choice.by else 3.8


def draw_sweep(axes: Any, rows: Frame, choice: Choice, title: str = "") -> None:
    """Draw the rows of a sweep; the title has the number of values that are missing or have no place on the scale."""
    import pandas as pd

    # value and ends of its spread for each combination of the keys, of all rows that have a value
    cells = choice.cells(rows)
    ends = [np.array([(*cell, *[np.nan] * 3)[i] for cell in cells], dtype=float) for i in range(3)]
    table = pd.DataFrame(dict(zip(("value", "low", "high"), ends, strict=True)), index=cells.index)

    # points without a place on the scale are left out afterwards, so that those that are drawn are of all their rows
    values = ends[0]
    drawn = np.abs(values) <= LARGEST_VALUE
    scale = scale_of(values[drawn])
    drawn &= (values > 0.0) | (scale["value"] != "log")
    table.loc[~drawn, :] = np.nan
    missing = {"values": int(rows[choice.measure].isna().sum()), "points": int((~drawn & ~np.isnan(values)).sum())}
    totals = {"values": len(rows), "points": len(values)}
    if not choice.aggregate:  # each value is a point
        missing = {"values": sum(missing.values())}
    lost = [f"{count} of {totals[what]} {what} not shown" for what, count in missing.items() if count]
    title = ", ".join(filter(None, [title, *lost]))

    around = "" if choice.colour else SPREADS.get(choice.aggregate or "")
    label = escaped(in_words(choice.measure)) + (f" ({choice.aggregate}{around})" if choice.aggregate else "")
    if choice.colour:
        _heat(axes, table["value"].unstack(choice.x), scale, label)
    else:
        _curves(axes, table.dropna(subset="value"), scale, choice)
    x, y = (KEYS_IN_WORDS.get(key, escaped(key)) for key in (choice.x, choice.y))
    labelled(axes, x, y if choice.colour else label, escaped(title))


def _texts(values: Sequence[Any]) -> list[str]:
    """Names of keys on an axis; those of schemes as people read them."""
    return [f"{value:.4g}" if isinstance(value, float) else escaped(display_name(str(value))) for value in values]


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
        text = escaped(display_name(str(key)))
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
