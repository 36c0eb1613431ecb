"""Figures of sweeps: a measure as curves over one key, or as colours over two keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.order import convergence
from topcli.errors import UsageError, nearest, quoted
from topcli.figures.figure import Columns, Figure
from topcli.figures.labels import labelled, plain
from topcli.figures.style import looks
from topcli.schemes.display import display_name
from topcli.schemes.registry import all_schemes
from topcli.sweeps.measures import in_words

if TYPE_CHECKING:
    import pandas as pd

KEYS = {"h": "step size h", "N": "number of steps N", "T": "time T"}
"""Keys of a config in words."""
ROOM = 0.21
"""Height of a figure in inches for each curve in its legend."""
CEILING = 1e10
"""Larger values, of runs that explode, are not drawn but counted in the title."""
DEEPEST = 1e-10
"""A scale with two signs is linear up to the smallest magnitude, or up to this part of the largest."""
AGGREGATES: dict[str, str | None] = {"median": " and quartiles", "mean": " ± standard error", "max": ""}
"""Ways to combine the values of rows at one point, each with the band around it in words."""


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

    def require(self, frame: pd.DataFrame) -> None:
        """Raise UsageError for columns that the rows do not have, and for several rows at one point."""
        for option, name in (("--x", self.x), ("--y", self.y), ("--by", self.by), ("--colour", self.colour)):
            if name is not None and name not in frame:
                raise UsageError(f"{option} {quoted(name)}: no such column; {nearest(name, list(frame))}")
        if self.by and self.colour:
            raise UsageError("--colour and --by cannot be combined: a heat map has no curves")
        if frame[self.measure].dtype.kind not in "fiub":
            option = "--colour" if self.colour else "--y"
            raise UsageError(f"{option} {quoted(self.measure)}: has words, not numbers; give a measure")
        if self.aggregate not in (None, *AGGREGATES):
            raise UsageError(f"--aggregate {quoted(self.aggregate)}: unknown aggregate; use {', '.join(AGGREGATES)}")
        if len(set(self.keys)) < len(self.keys):
            raise UsageError(f"key {self.x!r} is used twice; choose two different keys")
        most = max(frame.groupby(self.keys, dropna=False).size().tolist())
        if self.aggregate is None and most > 1:
            ways = "--aggregate median or --where" + ("" if self.colour or self.by else " or --by")
            raise UsageError(f"up to {most} rows have the same {' and '.join(self.keys)}; add {ways}")


def sweep_figure(frame: pd.DataFrame, choice: Choice, title: str, takes: str) -> Figure:
    """The figure of ``topcli plot sweep``: the part of the rows ``frame`` of a sweep that ``choice`` names.

    ``title`` begins with the name of the sweep; ``takes`` is the digest of the rows and conditions. Raises UsageError
    for a choice that the rows do not have.
    """
    choice.require(frame)
    sweep = title.partition(",")[0]
    over = ["by", choice.by] if choice.by else choice.keys[1:]
    name = "_".join([sweep, choice.measure, "over", choice.x, *over]).replace("/", "-")
    size = (6.4, min(9.4, max(3.8, ROOM * curves_of(frame, choice))))

    def draw(canvas: Any, columns: Columns) -> None:
        import pandas as pd

        draw_sweep(canvas.subplots(), pd.DataFrame(dict(columns)), choice, title)

    def data() -> Columns:
        return {name: frame[name].to_numpy() for name in dict.fromkeys([*choice.keys, choice.measure])}

    return Figure(name, f"{choice.measure} of {sweep}", data, draw, size, lambda: f"{takes} {choice}")


def curves_of(frame: pd.DataFrame, choice: Choice) -> int:
    """Number of curves of a figure."""
    return len(set(frame[choice.by])) if choice.by else 1


def draw_sweep(axes: Any, frame: pd.DataFrame, choice: Choice, title: str = "") -> None:
    """Draw the rows of a sweep; the title has the number of values that are missing or have no place on the scale."""
    frame, value = frame.copy(), choice.measure
    values = frame[value].to_numpy(dtype=float)
    values = np.where(np.abs(values) <= CEILING, values, np.nan)
    scale = scale_of(values)
    frame[value] = values = np.where(values > 0.0, values, np.nan) if scale["value"] == "log" else values
    if missing := int(np.isnan(values).sum()):
        title = ", ".join(filter(None, [title, f"{missing} of {len(frame)} values not shown"]))
    around = "" if choice.colour or not choice.aggregate else AGGREGATES[choice.aggregate]
    label = plain(in_words(value)) + (f" ({choice.aggregate}{around})" if choice.aggregate else "")
    x, y = (KEYS.get(key, plain(key)) for key in (choice.x, choice.y))
    if choice.colour:
        cells: Any = frame.groupby([choice.y, choice.x], sort=False)[value].agg(choice.aggregate or "max")
        _heat(axes, cells.unstack(choice.x), scale, label)
    else:
        _curves(axes, frame, scale, choice)
    labelled(axes, x, y if choice.colour else label, plain(title))


def _texts(values: Sequence[Any]) -> list[str]:
    """Names of keys on an axis; those of schemes as people read them."""
    return [f"{value:.4g}" if isinstance(value, float) else plain(display_name(str(value))) for value in values]


def _heat(axes: Any, table: Any, scale: Scale, label: str) -> None:
    """Draw a table as cells; values of both signs have two hues, and cells without a value are grey."""
    from matplotlib.colors import LogNorm, Normalize, SymLogNorm

    # numbers in their order, names in that of the rows and from top to bottom
    table = table.sort_index(axis=1) if table.columns.dtype.kind in "fi" else table
    table = table.sort_index() if table.index.dtype.kind in "fi" else table[::-1]
    cells = np.ma.masked_invalid(np.asarray(table, dtype=float))
    both = cells.count() and cells.min() < 0.0 < cells.max()
    bound = float(np.abs(cells).max()) if cells.count() else 1.0
    norm: Any = Normalize(-bound, bound) if both else Normalize()
    if scale["value"] != "linear":
        norm = LogNorm() if scale["value"] == "log" else SymLogNorm(scale["linthresh"], vmin=-bound, vmax=bound)
    axes.set_facecolor("0.85")
    axes.grid(visible=False)
    axes.tick_params(which="both", direction="out", top=False, right=False)  # the cells would cover them
    mesh = axes.pcolormesh(cells, norm=norm, cmap="RdBu_r" if both or scale["value"] == "symlog" else "viridis")
    axes.figure.colorbar(mesh, ax=axes, label=label, pad=0.02)
    for ticks, values in ((axes.set_xticks, table.columns), (axes.set_yticks, table.index)):
        at = np.arange(0, len(values), max(1, len(values) // 12))
        ticks(at + 0.5, _texts(values[at].tolist()))
    axes.tick_params(axis="x", rotation=90 if table.shape[1] > 5 else 0)


def _curves(axes: Any, frame: pd.DataFrame, scale: Scale, choice: Choice) -> None:
    """Draw the curves; if both axes are logarithmic, the legend has the slopes above the plateau of round-off."""
    x, y, by, aggregate = choice.x, choice.y, choice.by, choice.aggregate
    words = frame[x].dtype.kind not in "fiu"
    names = list(frame[x].unique()) if words else []
    logs = not words and is_geometric(frame[x].dropna().to_numpy(dtype=float))
    axes.set_yscale(**scale)
    axes.set_xscale("log" if logs else "linear")
    adaptive = {scheme.name for scheme in all_schemes() if scheme.adaptive}
    groups = dict(iter(frame.groupby(by, sort=False, dropna=False))) if by else {y: frame}
    styles = looks(map(str, groups), markers=True)
    for i, (key, rows) in enumerate(groups.items()):
        style = styles[str(key)] | {"markersize": 4.6 - 1.8 * i / len(groups)}  # all at one place are seen
        text = f"{by} = {key:.6g}" if by and isinstance(key, float | int) else plain(display_name(str(key)))
        table = _summary(rows.groupby(x, sort=not words)[y], aggregate).dropna(subset="middle")
        at = table.index.to_numpy()
        if words:
            beside = (i - 0.5 * (len(groups) - 1)) * min(0.12, 0.7 / len(groups))
            at, style["linestyle"] = np.array([names.index(name) for name in at]) + beside, "none"
        low, middle, high = (table[name].to_numpy() for name in ("low", "middle", "high"))
        if logs and scale["value"] == "log" and not (x == "h" and key in adaptive):
            order = convergence(at.tolist(), middle.tolist()).order
            text += "" if order is None else f": {order:.2f}".replace("-", "−")
        axes.plot(at, middle, label=text, **style)
        if words and aggregate:
            spread = [middle - low, high - middle]
            axes.errorbar(at, middle, spread, color=style["color"], fmt="none", elinewidth=0.9, capsize=2.0)
        elif aggregate:
            axes.fill_between(at, low, high, color=style["color"], alpha=0.18, linewidth=0.0)
    if words:
        axes.set_xlim(-0.5, len(names) - 0.5)
        axes.set_xticks(range(len(names)), _texts(names), rotation=90 if len(names) > 5 else 0)
    if by:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.02), fontsize="small")


def _summary(groups: Any, aggregate: str | None) -> pd.DataFrame:
    """Middle, low and high value of the groups of a column; without an aggregate all three are the only value."""
    import pandas as pd

    middle = groups.agg(aggregate or "max")
    if aggregate == "median":
        return pd.DataFrame({"low": groups.quantile(0.25), "middle": middle, "high": groups.quantile(0.75)})
    error = groups.sem().fillna(0.0) if aggregate == "mean" else 0.0
    return pd.DataFrame({"low": middle - error, "middle": middle, "high": middle + error})
