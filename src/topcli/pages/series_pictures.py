"""Pictures of a stored series: its vectors and the deviations of its invariants over time."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.errors import UsageError
from topcli.figures.picture import Line, Panel, column_label, component_symbol
from topcli.pages.contents import Picture, Pictures
from topcli.pages.svg import svg_of
from topcli.store.envelope import envelope
from topcli.store.series import DECIMAL, INTEGERS, WORDS, series_names

DEVIATION = "deviation:"
MOST_LINES = 7
"""Lines of a picture that look different."""
EXPLODED = 1e3
_COMPONENT = re.compile(r"([A-Za-z]+)([1-9])")


def vectors_of(names: list[str], experiment: Experiment | None) -> dict[str, list[str]]:
    """Recorded components by the vector that they belong to."""
    if experiment is not None:
        components = experiment.top.components
        found = {name: components[slice(*ends)] for name, ends in experiment.top.vectors.items()}
        return {name: own for name, those in found.items() if (own := [one for one in those if one in names])}
    parts = [(match[1], match[0]) for name in names if (match := _COMPONENT.fullmatch(name))]
    return {vector: [name for one, name in parts if one == vector] for vector in dict.fromkeys(v for v, _ in parts)}


def label_of(name: str, experiment: Experiment | None) -> str:
    """Mathtext of a column; its plain name if the experiment is not known."""
    if experiment is not None:
        return column_label(experiment, name)
    return component_symbol(name) if _COMPONENT.fullmatch(name) else name.replace("$", r"\$")


def positive(values: Array) -> Array:
    """``values`` with nan for those that have no place on a logarithmic axis."""
    return np.where(values > 0.0, values, np.nan)


def deviations(data: dict[str, Array], names: list[str]) -> dict[str, Array]:
    """Absolute deviations of columns from their first values, for a logarithmic axis, without constant ones."""
    found = {DEVIATION + name: positive(np.abs(data[name] - data[name][0])) for name in names}
    return {name: values for name, values in found.items() if np.isfinite(values).any()}


def before_explosion(data: dict[str, Array], names: list[str]) -> dict[str, Array]:
    """Rows before the first at which a component is beyond ``EXPLODED`` times the largest one at the start."""
    largest = np.max([np.abs(data[name]) for name in names], axis=0)
    beyond = np.flatnonzero(~(largest <= EXPLODED * max(1.0, largest[0])))
    kept = int(beyond[0]) if len(beyond) and beyond[0] > 1 else len(largest)
    return {name: values[:kept] for name, values in data.items()}


def motion_panel(names: list[str], experiment: Experiment | None) -> Panel:
    """Panel of the components of one vector over time."""
    lines = tuple(Line(name, label_of(name, experiment)) for name in names)
    return Panel(lines, ", ".join(line.label for line in lines))


def deviation_panel(columns: list[str], experiment: Experiment | None) -> Panel:
    """Panel of the ``columns`` of ``deviations`` over time."""
    lines = tuple(Line(name, label_of(name.removeprefix(DEVIATION), experiment)) for name in columns)
    return Panel(lines, "deviation from the first value", log=True)


def series_pictures(path: Path, experiment: Experiment | None, h: float, name: str) -> Pictures | None:
    """Pictures of the series of one trajectory; None if it has no rows. ``name`` is unique within the page.

    Raises RunError if the series is damaged, and UsageError if it has no times.
    """
    names = [one for one in series_names(path) if one not in WORDS and not one.endswith(DECIMAL)]
    time = "t" if "t" in names else "n"
    if time not in names:
        raise UsageError("the config records neither t nor n")
    data = envelope(path, names)
    if not len(data[time]):
        return None
    data.setdefault("t", data[time] * h)
    vectors = vectors_of(names, experiment)
    moving = [one for own in vectors.values() for one in own]
    others = [one for one in names if one not in {"t", *INTEGERS, *moving}]
    bounded = before_explosion(data, moving) if moving else data
    cut = f", up to t = {bounded['t'][-1]:.6g} before the motion explodes" if len(bounded["t"]) < len(data["t"]) else ""
    pictures = []
    for vector, own in vectors.items():
        caption = f"{vector} over time t{cut}"
        pictures.append(Picture(svg_of(motion_panel(own, experiment), bounded, f"{name}-{vector}", caption), caption))
    moved = deviations(data, others)
    if moved:
        constant = [one for one in others if DEVIATION + one not in moved]
        note = f"; {', '.join(constant)} did not change" if constant else ""
        caption = f"absolute deviations from the first values over time t{note}"
        panel = deviation_panel(list(moved)[:MOST_LINES], experiment)
        pictures.append(Picture(svg_of(panel, data | moved, f"{name}-deviations", caption), caption))
    return Pictures("Pictures", pictures) if pictures else None
