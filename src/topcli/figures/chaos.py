"""Figure ``chaos``: Lyapunov exponents of an orbit, and the share of chaotic orbits of several maps.

The HK scheme of Kowalevski's top is not an integrable map: with the step size, chaotic orbits appear and spread. That
of Lagrange's top is integrable, and so is ``backlund``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.lyapunov import Growth, growth_of, shares_of_chaos
from topcli.contracts import Array
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, Line, Panel, caption
from topcli.figures.style import DASHES, MARKERS, Styles, looks
from topcli.schemes.display import display_name
from topcli.schemes.registry import find_scheme
from topcli.studies.study import Result
from topcli.tops import TOPS

REGULAR = "regular"


def loaded_lyapunov(result: Result) -> Loaded:
    """The figure of ``topcli lyapunov``; nothing is drawn of an orbit that broke off."""
    study, columns = result.data, dict(result.arrays)
    if study["verdict"] == "broke off" or "t" not in columns:
        return Loaded((), dict, study["config"], Grid())
    t, names = columns["t"], [name for name in columns if name.startswith("exponent")]
    # the growth of a regular orbit of this unit of time, which the study gives at the end
    unit = np.expm1(study["regular_exponent"] * t[-1]) / t[-1]
    columns[REGULAR] = np.log1p(unit * t) / t
    alone = len(names) == 1
    lines = [Line(name, "exponent" if alone else rf"$\lambda_{i + 1}$") for i, name in enumerate(names)]
    lines.append(Line(REGULAR, "regular orbit: $\\ln(t)/t$"))
    config = study["config"]
    panel = Panel(
        tuple(lines),
        ylabel="exponent per unit of time",
        xlog=True,
        log=alone and bool((columns[names[0]] > 0.0).all()),
        title=f"{display_name(config['scheme']['name'])}, $h = {config['h']:g}$: {study['verdict']}",
    )
    return Loaded((panel,), lambda: columns, config, Grid(figsize=(5.4, 3.2)))


STEPS = 10_000
"""Steps of an orbit: 97 % of the verdicts are those of orbits 20 times longer (``benchmarks/indicators.py``)."""
MAP_STEPS, MAP_SIZE = 4_000, 100
MAP_STEP_SIZES = (0.02, 0.8)
ORBITS = 1024
STEP_SIZES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8)
MAPS = (
    ("hk", "kowalevski", "HK, Kowalevski"),
    ("hk", "lagrange", "HK, Lagrange"),
    ("backlund", "kowalevski", "Bäcklund, Kowalevski"),
)


def random_orbits(count: int, seed: int = 7) -> Array:
    """States (count, 6): omega normal with a standard deviation of 1.5, gamma a unit vector in a random direction."""
    y = np.random.default_rng(seed).normal(size=(count, 6)) * np.repeat([1.5, 1.0], 3)
    y[:, 3:] /= np.linalg.norm(y[:, 3:], axis=1, keepdims=True)
    return y


def growth_under(name: str, form: str, h: float, steps: int, y: Array) -> Growth:
    """Growth of tangent vectors along the orbits of a scheme from the states ``y`` (m, d)."""
    top, scheme = TOPS[form].new(), find_scheme(name, form)
    return growth_of(top, scheme, scheme.build(top, scheme.options()), h, steps, y)


def chaotic_share(growth: Growth) -> tuple[float, float]:
    """Share of chaotic orbits among those with a verdict, and its standard error (of at least half an orbit)."""
    chaotic = shares_of_chaos(growth.verdicts)
    count = max(1, int(np.isfinite(chaotic).sum()))
    share = float(np.nansum(chaotic)) / count
    return share, max(np.sqrt(share * (1.0 - share) / count), 0.5 / count)


def _map_columns() -> Iterator[tuple[str, Array]]:
    """Exponent of each cell of the map: step size, and the size of omega in a fixed direction."""
    sizes = np.linspace(*MAP_STEP_SIZES, MAP_SIZE)
    lengths = np.linspace(0.05, 4.0, MAP_SIZE)
    y = np.zeros((MAP_SIZE, 6))
    y[:, :3], y[:, 3:] = lengths[:, None] * np.array([0.6, 0.64, 0.48]), (0.8, 0.0, 0.6)
    rows = []
    for h in sizes.tolist():
        growth = growth_under("hk", "kowalevski", h, MAP_STEPS, y)
        chaotic = shares_of_chaos(growth.verdicts)
        rows.append(np.where(chaotic == 1.0, growth.exponents, chaotic))
    yield "map:h", np.repeat(sizes, MAP_SIZE)
    yield "map:omega", np.tile(lengths, MAP_SIZE)
    yield "map:exponent", np.concatenate(rows)


def chaos_columns() -> Mapping[str, Array]:
    """Columns of the figure: those of the map, and shares of chaotic orbits with their errors."""
    columns, y = dict(_map_columns()), random_orbits(ORBITS)
    columns["h"] = np.array(STEP_SIZES)
    for name, form, label in MAPS:
        shares = [chaotic_share(growth_under(name, form, h, STEPS, y)) for h in STEP_SIZES]
        columns[f"share:{label}"], columns[f"error:{label}"] = map(np.array, zip(*shares, strict=True))
    return columns


@dataclass(frozen=True)
class ChaosMap:
    """Exponents over step size and initial state; regular orbits are white, those without a verdict grey."""

    title: str

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the map with its scale."""
        shape = (MAP_SIZE, MAP_SIZE)
        count = MAP_SIZE * MAP_SIZE
        h, omega, found = (data[f"map:{name}"][:count].reshape(shape) for name in ("h", "omega", "exponent"))
        axes.set_facecolor("0.75")
        drawn = axes.pcolormesh(h, omega, np.where(found == 0.0, np.nan, found), cmap="viridis_r", rasterized=True)
        calm = np.where(found == 0.0, 0.0, np.nan)
        axes.pcolormesh(h, omega, calm, cmap="Greys", vmin=0.0, vmax=1.0, rasterized=True)
        bar = axes.figure.colorbar(drawn, ax=axes, pad=0.02)
        bar.set_label("exponent of chaotic orbits per unit of time")
        axes.grid(False)
        caption(axes, "step size $h$", r"initial angular speed $|\boldsymbol{\omega}(0)|$", self.title)


@dataclass(frozen=True)
class SharePanel:
    """Shares of chaotic orbits of the maps over the step size, with error bars."""

    title: str

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the shares in percent."""
        h = data["h"][np.isfinite(data["h"])]
        for i, (scheme, _, label) in enumerate(MAPS):
            share, error = (100.0 * data[f"{kind}:{label}"][: len(h)] for kind in ("share", "error"))
            look = {"color": looks([scheme])[scheme]["color"], "linestyle": DASHES[i], "marker": MARKERS[i]}
            size = 2.0 + len(MAPS) - i  # so that markers at one place are seen
            axes.errorbar(h, share, error, label=label, markersize=size, capsize=2.0, **look)
        caption(axes, "step size $h$", "chaotic orbits in %", self.title)
        axes.legend(loc="upper left", fontsize="small")


def load_chaos(request: Request) -> Loaded:
    """Load the map and the shares of chaotic orbits."""
    panels = ChaosMap("(a) HK, Kowalevski top; white: regular"), SharePanel("(b) random orbits")
    return Loaded(panels, chaos_columns, {}, Grid(figsize=(7.0, 2.9)))
