"""Figures of growth over many steps: round-off in ``topcli roundoff``, and errors of the energy.

The figure ``long-energy`` has the energy of several schemes over a long time, with the same step for all. An integrable
or canonical map keeps the energy, or a function near it, over very long times; what remains is an oscillation that does
not grow. A scheme that conserves the energy exactly shows the growth of round-off instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.config.load import load_experiment
from topcli.contracts import Array
from topcli.engine.collect import Memory
from topcli.engine.drive import drive
from topcli.engine.machine import Machine
from topcli.engine.plan import Plan
from topcli.engine.watch import energy_of
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, Line, Panel, caption, label_ends
from topcli.figures.style import MARKERS, Styles
from topcli.schemes.display import display_name
from topcli.studies.entries import under_scheme
from topcli.studies.study import Result

if TYPE_CHECKING:
    from topcli.config.models import Experiment

ULP = 2.0**-52
GUIDE = "0.6"
"""Colour of the guide lines."""
MORE = 20.0
"""Factor by which the scale may be longer for the guide lines."""
STYLES = {"plain": "-", "compensated": "--"}


@dataclass(frozen=True)
class GrowthPanel:
    """Drifts, columns named ``invariant:form`` with their labels, against the column ``steps``, logarithmically.

    Invariants differ in colour and forms in line style; if there is one invariant only, forms differ in colour. Labels
    are at the right ends of the lines. Grey guide lines, from a common point, grow as sqrt(N) with one ulp per step and
    as N.
    """

    lines: tuple[tuple[str, str], ...]
    title: str

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw curves, guide lines and labels into ``axes``."""
        from matplotlib.ticker import NullFormatter

        n = data["steps"]
        alone = len({column.partition(":")[0] for column, _ in self.lines}) == 1
        colours: dict[str, str] = {}
        ends = []
        for i, (column, label) in enumerate(self.lines):
            name, _, form = column.partition(":")
            colour = colours.setdefault(column if alone else name, f"C{len(colours)}")
            drift = np.where(data[column] > 0.0, data[column], np.nan)  # a logarithmic axis has no zero
            look = {"linestyle": "-" if alone else STYLES[form], "marker": MARKERS[i % len(MARKERS)], "markersize": 3.0}
            axes.plot(n, drift, color=colour, **look)
            ends.append((float(n[-1]), float(drift[-1]), label, colour))
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(float(n[0]) / 1.3, float(n[-1]) * 1.3)
        low, high = axes.get_ylim()
        corner = ULP * float(np.sqrt(n[0]))
        low, high = min(low, 0.6 * corner), max(high, min(1.6 * corner * float(n[-1] / n[0]), MORE * high))
        axes.set_ylim(low, high)
        label_ends(axes, [*ends, *self._guides(axes, n, corner, high)])
        caption(axes, "number of steps $N$", "drift over $N$ steps (rms)", self.title)

    def _guides(self, axes: Any, n: Array, corner: float, high: float) -> list[tuple[float, float, str, Any]]:
        """Draw the guide lines from ``corner``; their last points below ``high``, with labels and colour."""
        ends = []
        for power, label in ((0.5, r"$\epsilon\sqrt{N}$"), (1.0, r"$\propto N$")):
            axes.plot(n, corner * (n / n[0]) ** power, color=GUIDE, linestyle="-", linewidth=0.9, zorder=1.0)
            last = min(float(n[-1]), float(n[0]) * (0.9 * high / corner) ** (1.0 / power))
            ends.append((last, corner * (last / float(n[0])) ** power, label, GUIDE))
        return ends


def growth_data(study: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], tuple[tuple[str, str], ...]]:
    """Columns of a study, and its lines with their labels; an invariant without drift at the end has no line."""
    forms = study["forms"]
    steps = np.array(forms[0]["invariants"][0]["steps"], dtype=float)
    data, lines = {"steps": steps}, []
    for i, first in enumerate(forms[0]["invariants"]):
        for form in forms:
            column = f"{first['name']}:{form['form']}"
            data[column] = np.array(form["invariants"][i]["rms"])
            lines.append((column, f"{first['symbol']}, {form['form']}" if len(forms) > 1 else first["symbol"]))
    return data, tuple(line for line in lines if data[line[0]][-1] > 0.0)


def loaded_roundoff(result: Result) -> Loaded:
    """The figure of ``topcli roundoff``; nothing is drawn if a run failed."""
    study = result.data
    data, lines = growth_data(study)
    panel = GrowthPanel(lines, f"{display_name(study['forms'][0]['scheme'])}, $h = {study['h']:g}$")
    source = {key: study[key] for key in ("config", "steps", "copies")}
    completed = all(form["outcome"] == "completed" for form in study["forms"])
    return Loaded((panel,) if completed else (), lambda: data, source, Grid(figsize=(5.4, 3.2)))


ENERGY_STEPS = 1 << 20
ENERGY_H = 0.05
PARTS = 6
"""Points of a curve in each octave of steps."""
SCHEMES = {
    "kowalevski_generic_hk": ("splitting", "dmv", "hk", "midpoint", "rk4"),
    "euler_hk": ("splitting", "dmv", "hk", "midpoint", "rk4"),
}
"""Schemes of each scene; the last one is the control, whose energy drifts."""


def _experiments() -> dict[str, Experiment]:
    """Experiment of each curve, by the name of its column."""
    return {
        f"{scene}:{name}": under_scheme(load_experiment(scene, [f"h={ENERGY_H}"]), name)
        for scene, names in SCHEMES.items()
        for name in names
    }


def ends_of_parts(steps: int) -> NDArray[np.int64]:
    """Numbers of steps up to ``steps``, at most ``PARTS`` evenly spaced ones in each octave."""
    return np.unique(np.round(2.0 ** np.arange(0.0, np.log2(steps) + 1e-9, 1.0 / PARTS)).astype(np.int64))


def _energy_errors(experiment: Experiment) -> Array:
    """Largest deviation of the energy up to each of the ends, relative to the size of its terms at the start."""
    top = experiment.top
    energy = energy_of(top)
    assert energy is not None
    first = np.array([experiment.y0])
    start, scale = float(energy.value(first)[0]), float(energy.scale(first)[0])
    plan = Plan(top, Machine(top, experiment.method()), first, experiment.h, ENERGY_STEPS, invariants=(energy,))
    memory = Memory([energy.name])
    drive(plan, [memory])
    errors = np.abs(memory.columns[energy.name][0, 1:] - start) / scale
    return np.maximum.accumulate(errors[~np.isnan(errors)])[ends_of_parts(ENERGY_STEPS) - 1]


def energy_columns() -> Mapping[str, Array]:
    """Columns of the figure: times ``t:<scene>``, and the largest energy error of each curve up to them."""
    ends = ENERGY_H * ends_of_parts(ENERGY_STEPS).astype(float)
    columns: dict[str, Array] = {f"t:{scene}": ends for scene in SCHEMES}
    for name, experiment in _experiments().items():
        errors = _energy_errors(experiment)
        columns[name] = np.where(errors > 0.0, errors, np.nan)  # a logarithmic axis has no zero
    return columns


ENERGIES = tuple(
    Panel(
        tuple(Line(f"{scene}:{name}", display_name(name)) for name in names),
        "largest relative energy error so far",
        x=f"t:{scene}",
        xlog=True,
        log=True,
        title=f"{title}, $h = {ENERGY_H}$",
    )
    for title, (scene, names) in zip(("(a) Kowalevski top", "(b) Euler top"), SCHEMES.items(), strict=True)
)


def load_long_energy(request: Request) -> Loaded:
    """Load the energy errors of the schemes, one panel for each scene."""
    return Loaded(
        ENERGIES,
        energy_columns,
        {"scenes": [each.digest for each in _experiments().values()]},
        Grid(figsize=(7.0, 3.2)),
    )
