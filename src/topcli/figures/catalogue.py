"""The figures that topcli can draw.

Figures 1 to 4 are those of Sogo, *Discrete Spinning Tops*, section 3.2, at the paper's values.
"""

from __future__ import annotations

from collections.abc import Callable

from topcli.analysis.swings import spacing_law
from topcli.errors import SchemeCodeError, UnknownNameError, nearest, quoted
from topcli.figures.figure import Figure, Loaded, Request, deferred
from topcli.figures.picture import Grid, Line, Panel
from topcli.figures.scene3d import Polhodes, Sphere
from topcli.figures.scenes import BodyPanel, VectorPanel, scene_figure
from topcli.figures.sweep import LAW, Choice, View, sweep_views
from topcli.schemes.plugins import failed_plugin, known_failures, origin_of, plugin_failures, plugin_table

Load = Callable[[Request], Loaded]


def _headed(figsize: tuple[float, float]) -> Grid:
    """One row of panels under a line with the scheme, h and the distance from the upright position at the start."""
    return Grid(figsize=figsize, heading=r"{scheme}, $h = {h}$, $\epsilon = \gamma_3(0) = {gamma3}$")


def _components(vector: str) -> tuple[str, str, str]:
    return f"{vector}1", f"{vector}2", f"{vector}3"


def _motion_figure(name: str, method: str, scene: str) -> Figure:
    """Figure of gamma on the left and omega on the right."""
    panels = (
        Panel(tuple(map(Line, _components("gamma"))), r"$\boldsymbol{\gamma}$", ylim=(-1.1, 1.1), title="(a)"),
        Panel(tuple(map(Line, _components("omega"))), r"$\boldsymbol{\omega}$", title="(b)"),
    )
    title = f"Kowalevski top, {method}: gamma and omega"
    return scene_figure(name, title, scene, panels, _headed((7.0, 2.9)), rank=0)


def _spheres() -> tuple[Sphere, Sphere]:
    """Traces of gamma, seen from the body."""
    alike = {"azimuth": 35.0, "axes": ("e_1", "e_2", "e_3"), "band": False}
    near = "near the homoclinic orbit, dots at $t = 0, 1, 2, ...$"
    return (
        Sphere(near, _components("gamma"), elevation=-55.0, time="t", **alike),
        Sphere("generic", _components("kowalevski_generic_hk:gamma"), elevation=25.0, width=0.5, **alike),
    )


_TO_100 = "$0 \\leq t \\leq 100$"
_GENERIC = f"Kowalevski top, generic, {_TO_100}"
_HEAVY = f"100 heavy tops at random, $h = 0.01$, {_TO_100}: medians and quartiles"
_SPACING = "swing_spacing.first"


def _schemes(*names: str) -> tuple[str, ...]:
    """Conditions of a view that shows the rows of these schemes."""
    return tuple(f"scheme={name}" for name in names)


_SWINGING = _schemes("hk", "bohlin-a", "hybrid", "hybrid-sym", "hk-projected", "dg4", "taylor")
"""Schemes of the figure of swings: one of each kind."""
_ERRING = _schemes("hk", "bohlin-a", "hybrid", "hk-projected", "splitting", "backlund", "rk4", "taylor")
"""Schemes of the figure of errors: one of each kind; each takes seconds to compile."""

FIGURES: dict[str, Figure] = {
    figure.name: figure
    for figure in (
        _motion_figure("fig1", "HK scheme", "kowalevski_hk"),
        _motion_figure("fig2", "Bohlin A", "kowalevski_bohlin_a"),
        scene_figure(
            "fig3",
            "Kowalevski top, Bohlin A: E and 2l, and their changes",
            "kowalevski_bohlin_a",
            (Panel((Line("energy"), Line("two_l")), change=True, whole=(0.0, 6.0)),),
            _headed((7.0, 3.1)),
            rank=0,
        ),
        _motion_figure("fig4", "hybrid scheme", "kowalevski_hybrid"),
        scene_figure(
            "polhodes",
            "Euler top: polhodes on the energy ellipsoid, and the tennis racket's",
            "euler_tennis_racket",
            (Polhodes((3.0, 2.0, 1.0)),),
            Grid(figsize=(4.6, 5.6)),
        ),
        scene_figure(
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
        scene_figure(
            "sphere",
            "Kowalevski top: the vertical seen from the body, near the homoclinic orbit and on a generic one",
            "kowalevski_hybrid",
            _spheres(),
            Grid(figsize=(6.4, 3.3)),
            ("kowalevski_generic_hk",),
        ),
        scene_figure(
            "nutation",
            "Lagrange top: the trace of its axis with cusps, loops and waves",
            "lagrange_cusps",
            (
                Sphere("cusps", _components("lagrange_cusps:a")),
                Sphere("loops", _components("lagrange_loops:a")),
                Sphere("waves", _components("lagrange_waves:a")),
            ),
            Grid(figsize=(7.0, 2.5)),
            ("lagrange_loops", "lagrange_waves"),
        ),
        Figure(
            "bifurcation",
            "Kowalevski top: bifurcation diagrams with the classes of tori, and the scenes",
            "kowalevski_hk",
            deferred("motion:load_bifurcation"),
        ),
        Figure(
            "catalogue",
            "Tops of the catalogue: motions of their gentle and hard scenes",
            "volterra_gentle",
            deferred("portraits:load_portraits"),
        ),
        Figure(
            "torus",
            "Kowalevski top: a torus with the lines of the flows of E and k²",
            "kowalevski_torus",
            deferred("torus:load_torus"),
        ),
        scene_figure(
            "body",
            "Bodies in space with the traces of their axes: free, Lagrange, Kowalevski",
            "euler_attitude",
            (
                BodyPanel("(a) Euler", until=0.45),
                BodyPanel("(b) Lagrange", "lagrange_attitude", until=0.93),
                BodyPanel("(c) Kowalevski", "kowalevski_attitude", until=0.5),
            ),
            Grid(figsize=(7.0, 2.6)),
            ("lagrange_attitude", "kowalevski_attitude"),
        ),
        scene_figure(
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
            ("kowalevski_attitude",),
        ),
        Figure(
            "roundoff",
            "Growth of round-off: biased, a random walk, compensated, and not at all",
            "lagrange_bs",
            deferred("growth:load_growth"),
            rank=1,
        ),
        Figure(
            "compare",
            "Kowalevski top: errors and swings of five schemes",
            "kowalevski_hk",
            deferred("comparison:load_comparison"),
            takes_overrides=True,
        ),
        Figure(
            "period",
            "Kowalevski top: why Figure 2 has another period than Figure 1",
            "kowalevski_hk",
            deferred("period:load_period"),
        ),
        Figure(
            "order",
            "Kowalevski top, generic: error over h, orders and the plateau of round-off",
            "topcli order",
            deferred("errors:load_order"),
        ),
        sweep_views(
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
            Grid(figsize=(7.0, 3.7), ncols=4, title="scheme"),
        ),
        sweep_views(
            "errors",
            "Kowalevski top, generic: error and drift of the energy of eight schemes over h",
            "kowalevski_errors",
            (
                View("", Choice("h", "error.max", "scheme"), _ERRING, "$h$", "largest error"),
                View("", Choice("h", "deviation.energy", "scheme"), _ERRING, "$h$", "deviation of $E$"),
            ),
            Grid(figsize=(7.0, 5.2), ncols=4, title="scheme: slopes in (a), (b)", heading=_GENERIC),
        ),
        sweep_views(
            "heavy-drift",
            "Heavy tops, 100 at random: energy of five schemes",
            "heavy_drift",
            (
                View("", Choice("scheme", "deviation.energy", aggregate="median"), ylabel="deviation of $E$"),
                View("", Choice("scheme", "drift.energy", aggregate="median"), ylabel="drift of $E$ per unit time"),
            ),
            Grid(figsize=(7.0, 3.1), heading=_HEAVY),
        ),
        Figure(
            "integrable",
            "Energy over a long time: integrable and canonical maps, exact conservation, drift",
            "euler_hk",
            deferred("growth:load_long_energy"),
            rank=1,
        ),
        Figure(
            "chaos",
            "Chaotic orbits of HK over the step size, and of a heavy top over its centre of gravity",
            "kowalevski_generic_hk",
            deferred("chaos:load_chaos"),
            rank=1,
        ),
        Figure(
            "error-and-cost",
            "Kowalevski top, generic: error of the integrable map and others over h and over time",
            "kowalevski_generic_hk",
            deferred("errors:load_error_and_cost"),
            rank=1,
        ),
        Figure(
            "torus-points",
            "Kowalevski top: a million points of the integrable map at h = 1 on the torus, and HK's",
            "kowalevski_generic_backlund",
            deferred("torus:load_torus_points"),
            rank=1,
        ),
        Figure(
            "work-precision",
            "Speed against error of schemes and peers",
            "topcli bench",
            deferred("comparison:load_work_precision"),
        ),
        Figure(
            "stress",
            "Every scheme in the hard cases of its top",
            "topcli stress",
            deferred("outcomes:load_stress"),
            rank=1,
        ),
    )
}


plugin_table(FIGURES)


def figure(name: str, *, title: str, scene: str = "") -> Callable[[Load], Load]:
    """Register the decorated function as a figure of ``topcli plot``.

    Parameters
    ----------
    name : str
        Name of the figure and its files, in lower case.
    title : str
        Description in one line.
    scene : str, optional
        Scene or command that the results come from.

    Returns
    -------
    callable
        Decorator that registers the function and returns it unchanged. The function takes a
        ``topcli.figures.figure.Request`` and returns a ``Loaded``: panels, and the data that they draw.

    Raises
    ------
    ValueError
        If there is a figure of this name.
    """

    def register(load: Load) -> Load:
        if name in FIGURES:
            raise ValueError(f"figure {name!r} is already registered by {FIGURES[name].origin}")
        FIGURES[name] = Figure(name, title, scene, load, origin=origin_of(load))
        return load

    return register


def find_figure(name: str) -> Figure:
    """Return the figure called ``name``.

    Raises UnknownNameError with the nearest names, and SchemeCodeError for one whose plugin has failed.
    """
    wanted = name.lower()
    if wanted not in FIGURES:
        failure = failed_plugin(wanted)
        if failure and wanted not in FIGURES:
            raise SchemeCodeError(f"figure {wanted!r}: {failure}")
        plugin_failures()
    try:
        return FIGURES[wanted]
    except KeyError:
        failures = map(str, known_failures()[:2])
        raise UnknownNameError(f"unknown figure {quoted(name)}; {nearest(name, FIGURES)}", *failures) from None
