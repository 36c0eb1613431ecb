"""The figures that topcli can draw.

Figures 1 to 4 are those of Sogo, *Discrete Spinning Tops*, section 3.2, at the paper's values.
"""

from __future__ import annotations

from topcli.analysis.swings import spacing_law
from topcli.errors import UnknownNameError, nearest, quoted
from topcli.figures.bifurcation import BelowGrid, BifurcationFigure, Window
from topcli.figures.comparison import ComparisonFigure
from topcli.figures.contract import Figure
from topcli.figures.curves import SlopeLegend
from topcli.figures.error_and_cost import ErrorAndCostFigure
from topcli.figures.growth import GrowthPanel
from topcli.figures.long_energy import LongEnergyFigure
from topcli.figures.order import OrderFigure
from topcli.figures.period import LAW, PeriodFigure
from topcli.figures.picture import Grid, Line, Panel
from topcli.figures.polhodes import Polhodes
from topcli.figures.roundoff import GrowthFigure
from topcli.figures.scenes import PaperFigure, SceneFigure
from topcli.figures.sphere import Sphere
from topcli.figures.stress import StressFigure
from topcli.figures.sweep import Choice
from topcli.figures.sweep_studies import SweepStudyFigure, View
from topcli.figures.torus import TorusFigure
from topcli.figures.torus_points import TorusPointsFigure
from topcli.figures.traces import BodyPanel, VectorPanel
from topcli.figures.work_precision import WorkPrecisionFigure


def _headed(figsize: tuple[float, float]) -> Grid:
    """One row of panels under a line with the scheme, h and the distance from the upright position at the start."""
    return Grid(figsize=figsize, heading=r"{scheme}, $h = {h}$, $\epsilon = \gamma_3(0) = {gamma3}$")


def _motion_figure(name: str, method: str, scene: str) -> SceneFigure:
    """Figure of gamma on the left and omega on the right."""

    def lines(vector: str) -> tuple[Line, ...]:
        return tuple(Line(f"{vector}{i}") for i in (1, 2, 3))

    panels = (
        Panel(lines("gamma"), r"$\boldsymbol{\gamma}$", ylim=(-1.1, 1.1), title="(a)"),
        Panel(lines("omega"), r"$\boldsymbol{\omega}$", title="(b)"),
    )
    return PaperFigure(name, f"Kowalevski top, {method}: gamma and omega", scene, panels, _headed((7.0, 2.9)))


_TO_100 = "$0 \\leq t \\leq 100$"
_GENERIC = f"Kowalevski top, generic, {_TO_100}"
_HEAVY = f"100 heavy tops at random, $h = 0.01$, {_TO_100}: medians and quartiles"
_SPACING = "swing_spacing.first"
_SWINGING = tuple(
    f"scheme={name}" for name in ("hk", "bohlin-a", "hybrid", "hybrid-sym", "hk-projected", "dg4", "taylor")
)
"""Schemes of the figure of swings: one of each kind."""
_GAMMA = ("gamma1", "gamma2", "gamma3")
_BODY = ("e_1", "e_2", "e_3")

FIGURES: dict[str, Figure] = {
    figure.name: figure
    for figure in (
        _motion_figure("fig1", "HK scheme", "kowalevski_hk"),
        _motion_figure("fig2", "Bohlin A", "kowalevski_bohlin_a"),
        PaperFigure(
            "fig3",
            "Kowalevski top, Bohlin A: E and 2l, and their changes",
            "kowalevski_bohlin_a",
            (Panel((Line("energy"), Line("two_l")), change=True, whole=(0.0, 6.0)),),
            _headed((7.0, 3.1)),
        ),
        _motion_figure("fig4", "hybrid scheme", "kowalevski_hybrid"),
        SceneFigure(
            "polhodes",
            "Euler top: polhodes on the energy ellipsoid, and the tennis racket's",
            "euler_tennis_racket",
            (Polhodes((3.0, 2.0, 1.0)),),
            Grid(figsize=(4.6, 5.6)),
        ),
        SceneFigure(
            "modified",
            "Euler top, HK scheme: physical and modified integrals",
            "euler_modified",
            (
                Panel((Line("m_sq"), Line("modified_m_sq")), title="(a)"),
                Panel(
                    (Line("m_sq"), Line("modified_m_sq"), Line("modified_k12", dots=40)),
                    "relative deviation",
                    title="(b)",
                    log=True,
                    deviation=True,
                    ylim=(1e-17, 1.0),
                ),
            ),
            Grid(figsize=(7.0, 2.9), heading="{scheme}, $h = {h}$"),
        ),
        SceneFigure(
            "sphere",
            "Kowalevski top: the vertical seen from the body, near the homoclinic orbit and on a generic one",
            "kowalevski_hybrid",
            (
                Sphere(
                    "near the homoclinic orbit, dots at $t = 0, 1, 2, ...$",
                    _GAMMA,
                    elevation=-55.0,
                    azimuth=35.0,
                    axes=_BODY,
                    band=False,
                    time="t",
                ),
                Sphere(
                    "generic",
                    ("kowalevski_generic_hk:gamma1", "kowalevski_generic_hk:gamma2", "kowalevski_generic_hk:gamma3"),
                    elevation=25.0,
                    azimuth=35.0,
                    axes=_BODY,
                    band=False,
                    width=0.5,
                ),
            ),
            Grid(figsize=(6.4, 3.3)),
        ),
        SceneFigure(
            "nutation",
            "Lagrange top: the trace of its axis with cusps, loops and waves",
            "lagrange_cusps",
            tuple(
                Sphere(name, (f"lagrange_{name}:a1", f"lagrange_{name}:a2", f"lagrange_{name}:a3"))
                for name in ("cusps", "loops", "waves")
            ),
            Grid(figsize=(7.0, 2.5)),
        ),
        BifurcationFigure(
            "bifurcation",
            "Kowalevski top: bifurcation diagrams with the classes of tori, and the scenes",
            "kowalevski_hk",
            (
                Window((-0.9, 4.9), (0.0, 3.0), "kowalevski_generic_hk"),
                Window((-0.9, 2.9), (0.0, 2.0), "kowalevski_torus"),
                Window((1.66, 2.06), (0.0, 0.1), two_l=1.85),
                Window((3.0, 12.5), (0.0, 20.0), "kowalevski_hk"),
            ),
            BelowGrid(2, figsize=(7.0, 6.2)),
        ),
        TorusFigure(
            "torus",
            "Kowalevski top: a torus with the lines of the flows of E and k²",
            "kowalevski_torus",
            elevation=32.0,
            azimuth=165.0,
            layout=Grid(figsize=(5.4, 4.8)),
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
            Grid(figsize=(7.0, 2.6)),
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
            Grid(figsize=(7.0, 3.0)),
        ),
        ComparisonFigure(
            "compare",
            "Kowalevski top: errors and swings of five schemes",
            "kowalevski_hk",
            ("hk", "bohlin-a", "bohlin-b", "bohlin-c", "hybrid"),
        ),
        PeriodFigure(
            "period",
            "Kowalevski top: why Figure 2 has another period than Figure 1",
            "kowalevski_hk",
            Grid(figsize=(7.0, 4.4)),
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
                    law=spacing_law,
                    law_label=LAW,
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
            SlopeLegend(figsize=(7.0, 3.7), title="scheme"),
        ),
        SweepStudyFigure(
            "errors",
            "Kowalevski top, generic: error and drift of the energy of all schemes over h",
            "kowalevski_errors",
            (
                View("", Choice("h", "error.max", "scheme"), (), "$h$", "largest error"),
                View("", Choice("h", "deviation.energy", "scheme"), (), "$h$", "deviation of $E$"),
            ),
            SlopeLegend(figsize=(7.0, 5.2), ncols=4, title="scheme: slopes in (a), (b)", heading=_GENERIC),
        ),
        SweepStudyFigure(
            "heavy-drift",
            "Heavy tops, 100 at random: energy of five schemes",
            "heavy_drift",
            (
                View("", Choice("scheme", "deviation.energy", aggregate="median"), ylabel="deviation of $E$"),
                View("", Choice("scheme", "drift.energy", aggregate="median"), ylabel="drift of $E$ per unit time"),
            ),
            Grid(figsize=(7.0, 3.1), heading=_HEAVY),
        ),
        LongEnergyFigure(
            "integrable",
            "Energy over a long time: integrable and canonical maps, exact conservation, drift",
            "euler_hk",
            (("kowalevski_generic_hk", "(a) Kowalevski top, $h = 0.05$"), ("euler_hk", "(b) Euler top, $h = 0.05$")),
            Grid(figsize=(7.0, 3.2)),
        ),
        ErrorAndCostFigure(
            "error-and-cost",
            "Kowalevski top, generic: error of the integrable map and others over h and over time",
            "kowalevski_generic_hk",
        ),
        TorusPointsFigure(
            "torus-points",
            "Kowalevski top: a million points of the integrable map at h = 1 on the torus, and HK's",
            "kowalevski_generic_backlund",
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
