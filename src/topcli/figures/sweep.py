"""Figures of sweeps: a measure over a key, with a curve for each value of another, or as colours over two keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.contracts import Array
from topcli.engine.fingerprint import fingerprint
from topcli.errors import UsageError
from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.curves import LINEAR, LOG, SYMLOG, CurvePanel, curve_column, plain
from topcli.figures.heat import Axis, HeatPanel
from topcli.figures.picture import Grid
from topcli.store.manifest import sha256_of
from topcli.sweeps.rows import SweepRows, key_labels
from topcli.sweeps.table import SPREADS, aggregated, require_aggregate, require_groups
from topcli.sweeps.table_text import left_out

DECADES = 2.0
"""Magnitudes over more decades than this have a logarithmic scale, on both sides of zero if there are both signs."""
CROWDED = 20.0
"""Ratio of the largest to the smallest value and gap of a key from which its axis is logarithmic."""
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
            raise UsageError("--colour and --by do not go together: a heat map has no curves")
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


def _wide(values: Array) -> bool:
    """True for values that are not negative and, but for zeros, span more than ``DECADES``."""
    return scale_of(values)[0] == LOG


def scale_of(values: Array) -> tuple[str, float]:
    """Scale that shows ``values`` (m,): linear, log or symlog, and the threshold of the last."""
    sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
    if not len(sizes) or sizes.max() <= 10.0**DECADES * sizes.min():
        return LINEAR, 0.0
    if (values < 0.0).any():
        return SYMLOG, max(float(sizes.min()), DEEPEST * float(sizes.max()))
    return LOG, 0.0


def _axis(rows: SweepRows, key: str) -> tuple[Axis, dict[Any, float]]:
    """Axis of a key, and the place of each of its values on it."""
    column = rows.columns[key]
    labels = key_labels(column)
    if column.dtype.kind in "OU":
        return Axis(plain(key), words=tuple(map(plain, labels.values()))), {
            value: float(i) for i, value in enumerate(labels)
        }
    numbers = np.array([value for value in labels if value is not None], dtype=float)
    positive = bool(len(numbers)) and bool((numbers > 0.0).all())
    log = positive and (key in rows.log or _geometric(numbers) or _uneven(numbers))
    return Axis(plain(key), log), {value: np.nan if value is None else float(value) for value in labels}


@dataclass(frozen=True)
class Point:
    """Value of one combination of keys: ``low`` and ``high`` are its spread; all are nan without a value."""

    value: float
    low: float
    high: float


def _points(rows: SweepRows, choice: Choice) -> dict[tuple[Any, ...], Point]:
    """Value of each combination of the keys. Raises UsageError for several rows without an aggregate."""
    found = require_groups(rows, choice.keys, "point", () if choice.colour else ("--by",), choice.aggregate)
    points = {}
    for keys, indices in found.items():
        one = aggregated(rows, indices, choice.measure, choice.aggregate)
        value = one.value if one else np.nan
        spread = (one.low, one.high) if one else (np.nan, np.nan)
        low, high = (value if end is None else end for end in spread)
        points[keys] = Point(value, low, high)
    return points


def _measure_label(choice: Choice) -> str:
    spread = {"quartiles": " and quartiles", "standard error": " ± standard error", "": ""}
    note = f" ({choice.aggregate}{spread[SPREADS[choice.aggregate]]})" if choice.aggregate else ""
    return plain(choice.measure) + (note if not choice.colour else f" ({choice.aggregate})" if choice.aggregate else "")


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
    from topcli.schemes.registry import all_schemes

    return tuple(dict.fromkeys(one.name for one in all_schemes() if one.adaptive))


def curves(rows: SweepRows, choice: Choice) -> tuple[CurvePanel, dict[str, np.ndarray]]:
    """Panel and columns of the curves. Raises UsageError for several rows at a point without an aggregate."""
    axis, place = _axis(rows, choice.x)
    points = {keys: point for keys, point in _points(rows, choice).items() if not np.isnan(place[keys[0]])}
    labels, legend = _labels(rows, choice)
    data = {}
    for i, (value, label) in enumerate(labels.items()):
        beside = (i - 0.5 * (len(labels) - 1)) * min(0.12, 0.7 / len(labels)) if axis.words else 0.0
        mine = [(place[keys[0]] + beside, point) for keys, point in points.items() if not choice.by or keys[1] == value]
        mine.sort(key=lambda one: one[0])
        data[curve_column(label, "x")] = np.array([x for x, _ in mine])
        for kind, name in (("y", "value"), ("low", "low"), ("high", "high")):
            data[curve_column(label, kind)] = np.array([getattr(point, name) for _, point in mine])
    every = np.array([point.value for point in points.values()])
    scale, threshold = scale_of(every)
    panel = CurvePanel(
        tuple(labels.values()),
        axis.label,
        _measure_label(choice),
        axis.log,
        scale,
        threshold,
        CEILING,
        band=bool(choice.aggregate and SPREADS[choice.aggregate]),
        words=axis.words,
        title=_title(rows),
        legend=": ".join([one for one in (legend, "slope" * (axis.log and scale == LOG)) if one]),
        flat=_adaptive() if choice.by == "scheme" and choice.x == "h" else (),
    )
    return panel, {name: data[name] for name in panel.columns}


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
        "value": np.array([point.value for point in points.values()]),
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
    if _wide(values) and (zeros := int((values == 0.0).sum())):
        said.append(f"{zeros} of {len(rows)} values are zero and have no place on a logarithmic scale")
    axes = choice.keys if choice.colour else (choice.x,)
    if any(np.isnan(rows.columns[key]).any() for key in axes if rows.columns[key].dtype.kind == "f"):
        said.append(f"rows without a number for {' or '.join(axes)} are not drawn")
    return [*said, left_out(rows.left_out)] if rows.left_out else said


def figure_name(rows: SweepRows, choice: Choice) -> str:
    """Name of the files of the figure."""
    parts = [rows.name, choice.measure, "over", choice.x]
    parts += [choice.y] if choice.colour else ["by", choice.by] if choice.by else []
    return "_".join(parts).replace("/", "-")


@dataclass(frozen=True)
class SweepFigure(Figure):
    """Figure of the part of the ``rows`` of a sweep that ``choice`` names."""

    rows: SweepRows
    choice: Choice

    def load(self, request: Request) -> Loaded:
        """Return panel and data. Raises UsageError for a choice that the rows do not have."""
        self.choice.require(self.rows)
        prepare = _heat if self.choice.colour else curves
        panel, data = prepare(self.rows, self.choice)
        source = {
            "rows": sha256_of(self.rows.path),
            "choice": repr(self.choice),
            "code": fingerprint(prepare, compiled=False),
        }
        for line in sweep_notes(self.rows, self.choice):
            request.on_message(line)
        return Loaded((panel,), lambda: data, source, Grid(figsize=(6.4, 3.8)))


def sweep_figure(rows: SweepRows, choice: Choice) -> SweepFigure:
    """The figure of ``topcli plot sweep``."""
    return SweepFigure(figure_name(rows, choice), f"{choice.measure} of {rows.name}", "topcli sweep", rows, choice)
