"""The figures that topcli can draw.

Figures 1 to 4 are those of Sogo, *Discrete Spinning Tops*, section 3.2, at the paper's values.
"""

from __future__ import annotations

import numpy as np

from topcli.contracts import Array
from topcli.errors import UnknownNameError, nearest, quoted
from topcli.figures.comparison import ComparisonFigure
from topcli.figures.contract import Figure
from topcli.figures.growth import GrowthPanel
from topcli.figures.long_energy import LongEnergyFigure
from topcli.figures.order import OrderFigure
from topcli.figures.picture import Grid, Line, Panel
from topcli.figures.polhodes import Polhodes
from topcli.figures.roundoff import GrowthFigure
from topcli.figures.scenes import SceneFigure
from topcli.figures.sphere import Sphere
from topcli.figures.stress import StressFigure
from topcli.figures.sweep import Choice
from topcli.figures.sweep_studies import SweepStudyFigure, View
from topcli.figures.traces import BodyPanel, VectorPanel
from topcli.figures.work_precision import WorkPrecisionFigure


def _motion() -> tuple[Panel, Panel]:
    """Gamma on the left, omega on the right."""

    def lines(vector: str) -> tuple[Line, ...]:
        return tuple(Line(f"{vector}{i}") for i in (1, 2, 3))

    return (
        Panel(lines("gamma"), r"$\boldsymbol{\gamma}$", ylim=(-1.1, 1.1), title="(a) {scheme}"),
        Panel(lines("omega"), r"$\boldsymbol{\omega}$", title="(b) {scheme}"),
    )


_SPACING = "swing_spacing.first"
_SWINGING = tuple(
    f"scheme={name}" for name in ("hk", "bohlin-a", "hybrid", "hybrid-sym", "hk-projected", "dg4", "taylor")
)
"""Schemes of the figure of swings: one of each kind."""
_LAW = r"$2\sqrt{2}\,\ln(8\sqrt{7}/\epsilon)$"


def _law(eps: Array) -> Array:
    """Time between swings of the motion at the distance ``eps`` from the homoclinic orbit of the paper's scene."""
    return 2.0 * np.sqrt(2.0) * np.log(8.0 * np.sqrt(7.0) / eps)


_GAMMA = ("gamma1", "gamma2", "gamma3")

FIGURES: dict[str, Figure] = {
    figure.name: figure
    for figure in (
        SceneFigure("fig1", "Kowalevski top, HK scheme: gamma and omega", "kowalevski_hk", _motion()),
        SceneFigure("fig2", "Kowalevski top, Bohlin A: gamma and omega", "kowalevski_bohlin_a", _motion()),
        SceneFigure(
            "fig3",
            "Kowalevski top, Bohlin A: 2l and E, and E enlarged",
            "kowalevski_bohlin_a",
            (
                Panel((Line("energy"), Line("two_l")), ylim=(0.0, 6.0), title="(a) {scheme}"),
                Panel((Line("energy"),), title="(b) {scheme}"),
            ),
        ),
        SceneFigure("fig4", "Kowalevski top, hybrid scheme: gamma and omega", "kowalevski_hybrid", _motion()),
        SceneFigure(
            "polhodes",
            "Euler top: polhodes on the energy ellipsoid, and the tennis racket's",
            "euler_tennis_racket",
            (Polhodes((3.0, 2.0, 1.0)),),
            Grid(figsize=(6.0, 6.6)),
        ),
        SceneFigure(
            "modified",
            "Euler top, HK scheme: physical and modified integrals",
            "euler_modified",
            (
                Panel((Line("m_sq"), Line("modified_m_sq")), title="(a) {scheme}"),
                Panel(
                    (Line("m_sq"), Line("modified_m_sq"), Line("modified_k12")),
                    "relative deviation",
                    title="(b) {scheme}",
                    log=True,
                    deviation=True,
                    ylim=(1e-17, 1.0),
                ),
            ),
        ),
        SceneFigure(
            "sphere",
            "Kowalevski top: the vertical seen from the body, near the homoclinic orbit and on a generic one",
            "kowalevski_hybrid",
            (
                Sphere("near the homoclinic orbit", _GAMMA, elevation=48.0, azimuth=-35.0, axis="e_3", band=False),
                Sphere(
                    "generic",
                    ("kowalevski_generic_hk:gamma1", "kowalevski_generic_hk:gamma2", "kowalevski_generic_hk:gamma3"),
                    elevation=48.0,
                    azimuth=-35.0,
                    axis="e_3",
                    band=False,
                    width=0.5,
                ),
            ),
        ),
        SceneFigure(
            "nutation",
            "Lagrange top: the trace of its axis with cusps, loops and waves",
            "lagrange_cusps",
            tuple(
                Sphere(name, (f"lagrange_{name}:a1", f"lagrange_{name}:a2", f"lagrange_{name}:a3"))
                for name in ("cusps", "loops", "waves")
            ),
        ),
        SceneFigure(
            "body",
            "Bodies in space with the traces of their axes: free, Lagrange, Kowalevski",
            "euler_attitude",
            (
                BodyPanel("(a) Euler", until=0.45),
                BodyPanel("(b) Lagrange", "lagrange_attitude", until=0.93),
                BodyPanel("(c) Kowalevski", "kowalevski_attitude", until=0.5),
            ),
            Grid(figsize=(8.4, 3.0)),
        ),
        SceneFigure(
            "traces",
            "Traces of omega and gamma, seen from the body and from space",
            "euler_attitude",
            (
                VectorPanel(r"(a) Euler: $\boldsymbol{\omega}$ in the body", "omega"),
                VectorPanel(r"(b) Euler: $\boldsymbol{\omega}$ in space", "omega", in_space=True),
                VectorPanel(r"(c) Kowalevski: $\boldsymbol{\gamma}$ in the body", "gamma", "kowalevski_attitude"),
                VectorPanel(
                    r"(d) Kowalevski: $\boldsymbol{\omega}$ in space", "omega", "kowalevski_attitude", in_space=True
                ),
            ),
            Grid(2, figsize=(7.0, 6.4)),
        ),
        GrowthFigure(
            "roundoff",
            "Growth of round-off: biased, a random walk, compensated, and not at all",
            "lagrange_bs",
            (
                GrowthPanel(
                    (
                        ("a_sq:matrix", "matrix"),
                        ("a_sq:plain", "old + change"),
                        ("a_sq:compensated", "compensated"),
                    ),
                    r"(a) $\boldsymbol{a}^2$, Lagrange top, BS",
                ),
                GrowthPanel(
                    (("k_sq:hybrid", r"$\xi$ recomputed"), ("k_sq:hybrid-xi", r"$\xi$ carried")),
                    "(b) $k^2$, Kowalevski top, hybrid",
                ),
            ),
            Grid(figsize=(8.2, 3.2)),
        ),
        ComparisonFigure(
            "compare",
            "Kowalevski top: errors and swings of five schemes",
            "kowalevski_hk",
            ("hk", "bohlin-a", "bohlin-b", "bohlin-c", "hybrid"),
        ),
        OrderFigure(
            "order", "Kowalevski top, generic: error over h, orders and the plateau of round-off", "topcli order"
        ),
        SweepStudyFigure(
            "swings",
            "Kowalevski top: time between swings over eps and h, and each scheme's floor",
            "kowalevski_swings",
            (
                View(
                    "$h = 0.01$",
                    Choice("initial.gamma3", _SPACING, "scheme"),
                    (*_SWINGING, "h=0.01"),
                    "$\\epsilon = \\gamma_3(0)$",
                    "time between swings",
                    law=_law,
                    law_label=_LAW,
                ),
                View(
                    "$\\epsilon = 10^{-8}$",
                    Choice("h", _SPACING, "scheme"),
                    (*_SWINGING, "initial.gamma3=1e-8"),
                    "$h$",
                    "time between swings",
                    xlog=True,
                ),
            ),
            Grid(figsize=(8.6, 3.4)),
        ),
        SweepStudyFigure(
            "errors",
            "Kowalevski top, generic: error and drift of the energy of all schemes over h",
            "kowalevski_errors",
            (
                View("$0 \\leq t \\leq 100$", Choice("h", "error.max", "scheme"), (), "$h$", "largest error"),
                View("$0 \\leq t \\leq 100$", Choice("h", "deviation.energy", "scheme"), (), "$h$", "deviation of $E$"),
            ),
            Grid(figsize=(9.6, 4.4)),
        ),
        SweepStudyFigure(
            "heavy-drift",
            "Heavy tops, 100 at random: energy of five schemes",
            "heavy_drift",
            (
                View(
                    "median and quartiles",
                    Choice("scheme", "deviation.energy", aggregate="median"),
                    ylabel="deviation of $E$, $0 \\leq t \\leq 100$",
                ),
                View(
                    "median and quartiles",
                    Choice("scheme", "drift.energy", aggregate="median"),
                    ylabel="drift of $E$ per unit time",
                ),
            ),
            Grid(figsize=(8.6, 3.4)),
        ),
        LongEnergyFigure(
            "integrable",
            "Energy over a long time: integrable and canonical maps, exact conservation, drift",
            "euler_hk",
            (("kowalevski_generic_hk", "(a) Kowalevski top, $h = 0.05$"), ("euler_hk", "(b) Euler top, $h = 0.05$")),
            Grid(figsize=(8.2, 3.4)),
        ),
        WorkPrecisionFigure("work-precision", "Speed against error of schemes and peers", "topcli bench"),
        StressFigure("stress", "Every scheme in the hard cases of its top", "topcli stress"),
    )
}


def find_figure(name: str) -> Figure:
    """Return the figure called ``name``. Raises UnknownNameError with the nearest names."""
    try:
        return FIGURES[name.lower()]
    except KeyError:
        raise UnknownNameError(f"unknown figure {quoted(name)}; {nearest(name, FIGURES)}") from None
