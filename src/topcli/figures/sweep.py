"""Figures of sweeps: a measure as curves over one key, or as colours over two keys."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from topcli.contracts import Array
from topcli.errors import UsageError
from topcli.figures.curves import LINEAR, LOG, SYMLOG, CurvePanel, HeatPanel, KeyAxis, curve_column, plain
from topcli.figures.figure import Figure, Loaded, Request
from topcli.figures.picture import Grid
from topcli.schemes.display import display_name
from topcli.schemes.registry import all_schemes
from topcli.store.files import sha256_of
from topcli.sweeps.measures import in_words
from topcli.sweeps.rows import SweepRows, key_labels
from topcli.sweeps.table import SPREADS, aggregated, require_aggregate, require_groups
from topcli.sweeps.table_text import left_out

KEYS = {"h": "step size h", "N": "number of steps N", "T": "time T"}
"""Keys of a config in words."""
TIMES = ("seconds", "nanoseconds_per_step")
"""Measures that have no order in h."""
DECADES = 2.0
"""Magnitudes over more decades than this have a logarithmic scale, on both sides of zero if there are both signs."""
CROWDED = 20.0
"""Ratio of the largest to the smallest value and gap of a key from which its axis is logarithmic."""
MOST_KEYS = 10
"""Most curves with a legend; more have their names at their ends."""
ROOM = 0.215
"""Height of a figure in inches for each name at the end of a curve."""
CEILING = 1e10
"""Values above this one, of runs that explode, are drawn at the upper edge."""
DEEPEST = 1e-10
"""A scale with two signs is linear up to the smallest magnitude, or up to this part of the largest."""


@dataclass(frozen=True)
class Choice:
    """Content of the figure: the measure ``y`` over ``x`` for each value of ``by``; or ``colour`` over x and y."""

    x: str
    y: str
    by: str | None = None
    colour: str | None = None
    aggregate: str | None = None

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys whose values are distinguished."""
        return (self.x, self.y) if self.colour else (self.x, self.by) if self.by else (self.x,)

    @property
    def measure(self) -> str:
        """Measure that is drawn."""
        return self.colour or self.y

    def require(self, rows: SweepRows) -> None:
        """Raise UsageError for names that the sweep does not have or that do not go together."""
        require_aggregate(self.aggregate)
        if self.colour and self.by:
            raise UsageError("--colour and --by cannot be combined: a heat map has no curves")
        rows.require_key(self.x, "--x")
        if self.colour:
            rows.require_key(self.y, "--y")
            rows.require_measure(self.colour, "--colour")
        else:
            rows.require_measure(self.y, "--y")
            if self.by:
                rows.require_key(self.by, "--by")
        if len(set(self.keys)) < len(self.keys):
            raise UsageError(f"key {self.x!r} is used twice; choose two different keys")


def _geometric(values: Array) -> bool:
    """True for three or more positive numbers with a constant ratio."""
    at = np.unique(values)
    if len(at) < 3 or at[0] <= 0.0:
        return False
    ratios = np.diff(np.log(at))
    return bool(np.ptp(ratios) < 1e-6 * ratios.mean())


def _uneven(values: Array) -> bool:
    """True for three or more positive numbers whose places would crowd together on a linear axis."""
    at = np.unique(values)
    return len(at) > 2 and bool(at[-1] >= CROWDED * at[0]) and bool(np.diff(at).max() >= CROWDED * np.diff(at).min())


def scale_of(values: Array) -> tuple[str, float]:
    """Scale that shows ``values`` (m,): linear, log or symlog, and the threshold of the last."""
    sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
    if not len(sizes) or sizes.max() <= 10.0**DECADES * sizes.min():
        return LINEAR, 0.0
    if (values < 0.0).any():
        return SYMLOG, max(float(sizes.min()), DEEPEST * float(sizes.max()))
    return LOG, 0.0


def _axis(rows: SweepRows, key: str) -> tuple[KeyAxis, dict[Any, float]]:
    """Axis of a key, and the place of each of its values on it."""
    column = rows.columns[key]
    labels, words = key_labels(column), plain(KEYS.get(key, key))
    if column.dtype.kind in "OU":
        return KeyAxis(words, categories=tuple(plain(display_name(label)) for label in labels.values())), {
            value: float(i) for i, value in enumerate(labels)
        }
    numbers = np.array([value for value in labels if value is not None], dtype=float)
    positive = bool(len(numbers)) and bool((numbers > 0.0).all())
    log = positive and (key in rows.log or _geometric(numbers) or _uneven(numbers))
    return KeyAxis(words, log), {value: np.nan if value is None else float(value) for value in labels}


def _points(rows: SweepRows, choice: Choice) -> dict[tuple[Any, ...], tuple[float, float, float]]:
    """Value of each combination of the keys, and the ends of its spread; nan without a value.

    Raises UsageError for several rows without an aggregate.
    """
    grouped = require_groups(rows, choice.keys, "point", () if choice.colour else ("--by",), choice.aggregate)
    points = {}
    for keys, indices in grouped.items():
        cell = aggregated(rows, indices, choice.measure, choice.aggregate)
        low, value, high = (cell.low, cell.value, cell.high) if cell else (np.nan, np.nan, np.nan)
        points[keys] = value, value if low is None else low, value if high is None else high
    return points


def _measure_label(choice: Choice) -> str:
    spread = {"quartiles": " and quartiles", "standard error": " ± standard error", "": ""}
    if not choice.aggregate:
        return plain(in_words(choice.measure))
    around = "" if choice.colour else spread[SPREADS[choice.aggregate]]
    return plain(in_words(choice.measure)) + f" ({choice.aggregate}{around})"


def _title(rows: SweepRows) -> str:
    return plain(", ".join([rows.name, *rows.chosen]))


def _labels(rows: SweepRows, choice: Choice) -> tuple[dict[Any, str], str]:
    """Label of the curve of each value, and the title of the legend."""
    if choice.by is None:
        return {None: choice.y}, ""
    labels = key_labels(rows.columns[choice.by])
    if rows.columns[choice.by].dtype.kind in "OU":
        return labels, plain(choice.by)
    return {value: f"{choice.by} = {label}" for value, label in labels.items()}, ""


def _adaptive() -> tuple[str, ...]:
    """Names of the schemes that choose their own steps: h is only the distance of their rows."""
    return tuple(dict.fromkeys(one.name for one in all_schemes() if one.adaptive))


def curves(rows: SweepRows, choice: Choice) -> tuple[CurvePanel, dict[str, np.ndarray]]:
    """Panel and columns of the curves. Raises UsageError for several rows at a point without an aggregate."""
    axis, place = _axis(rows, choice.x)
    points = {keys: point for keys, point in _points(rows, choice).items() if not np.isnan(place[keys[0]])}
    labels, legend = _labels(rows, choice)
    data = {}
    band = bool(choice.aggregate and SPREADS[choice.aggregate])
    for i, (value, label) in enumerate(labels.items()):
        beside = (i - 0.5 * (len(labels) - 1)) * min(0.12, 0.7 / len(labels)) if axis.categories else 0.0
        mine = [keys for keys in points if not choice.by or keys[1] == value]
        mine.sort(key=lambda keys: place[keys[0]])
        data[curve_column(label, "x")] = np.array([place[keys[0]] + beside for keys in mine])
        for part, kind in enumerate(("y", "low", "high") if band else ("y",)):
            data[curve_column(label, kind)] = np.array([points[keys][part] for keys in mine])
    every = np.array([point[0] for point in points.values()])
    scale, threshold = scale_of(every)
    slopes = axis.log and scale == LOG and choice.y not in TIMES
    flat = _adaptive() if choice.by == "scheme" and choice.x == "h" else ()
    panel = CurvePanel(
        tuple(labels.values()),
        axis.label,
        _measure_label(choice),
        axis.log,
        scale,
        threshold,
        CEILING,
        band=band,
        categories=axis.categories,
        title=_title(rows),
        legend=": ".join([one for one in (legend, "slope" * slopes) if one]),
        flat=flat if slopes else tuple(labels.values()),
        at_ends=len(labels) > MOST_KEYS and not axis.categories,
    )
    return panel, data


def _heat(rows: SweepRows, choice: Choice) -> tuple[HeatPanel, dict[str, np.ndarray]]:
    """Panel and columns of the heat map."""
    (x, x_place), (y, y_place) = _axis(rows, choice.x), _axis(rows, choice.y)
    points = {
        keys: point
        for keys, point in _points(rows, choice).items()
        if not np.isnan([x_place[keys[0]], y_place[keys[1]]]).any()
    }
    data = {
        "x": np.array([x_place[keys[0]] for keys in points]),
        "y": np.array([y_place[keys[1]] for keys in points]),
        "value": np.array([point[0] for point in points.values()]),
    }
    return HeatPanel(x, y, _measure_label(choice), *scale_of(data["value"]), _title(rows)), data


def sweep_notes(rows: SweepRows, choice: Choice) -> list[str]:
    """Sentences about rows that did not complete, have no value, cannot be drawn or were left out."""
    values = rows.columns[choice.measure].astype(float)
    outcomes = [str(one) for one in rows.columns["outcome"][~rows.completed]]
    missing = int(np.isnan(values).sum())
    said = []
    if outcomes:
        listed = ", ".join(f"{outcomes.count(name)} {name}" for name in dict.fromkeys(outcomes))
        said.append(f"{len(outcomes)} of {len(rows)} rows did not complete: {listed}")
    if missing:
        said.append(f"{missing} of {len(rows)} values could not be computed (nan)")
    if scale_of(values)[0] == LOG and (zeros := int((values == 0.0).sum())):
        said.append(f"{zeros} of {len(rows)} values are zero and cannot be shown on a logarithmic scale")
    axes = choice.keys if choice.colour else (choice.x,)
    if any(np.isnan(rows.columns[key]).any() for key in axes if rows.columns[key].dtype.kind == "f"):
        said.append(f"rows without a number for {' or '.join(axes)} are not drawn")
    return [*said, left_out(rows.left_out)] if rows.left_out else said


def figure_name(rows: SweepRows, choice: Choice) -> str:
    """Name of the files of the figure."""
    parts = [rows.name, choice.measure, "over", choice.x]
    parts += [choice.y] if choice.colour else ["by", choice.by] if choice.by else []
    return "_".join(parts).replace("/", "-")


def sweep_figure(rows: SweepRows, choice: Choice) -> Figure:
    """The figure of ``topcli plot sweep``: the part of the ``rows`` of a sweep that ``choice`` names."""
    title = f"{choice.measure} of {rows.name}"
    return Figure(figure_name(rows, choice), title, "topcli sweep", partial(_load_rows, rows, choice))


def _load_rows(rows: SweepRows, choice: Choice, request: Request) -> Loaded:
    """Load panel and data. Raises UsageError for a choice that the rows do not have."""
    choice.require(rows)
    prepare = _heat if choice.colour else curves
    panel, data = prepare(rows, choice)
    source = {"rows": sha256_of(rows.path), "choice": repr(choice)}
    for line in sweep_notes(rows, choice):
        request.on_message(line)
    curves_named = len(panel.labels) if isinstance(panel, CurvePanel) and panel.at_ends else 0
    return Loaded((panel,), lambda: data, source, Grid(figsize=(6.4, min(9.4, max(3.8, ROOM * curves_named)))))
