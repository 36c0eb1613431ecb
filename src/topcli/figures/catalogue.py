"""The figures that topcli can draw.

Figures 1 to 4 are those of Sogo, *Discrete Spinning Tops*, section 3.2, at the paper's values.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from topcli.errors import SchemeCodeError, UnknownNameError, nearest, quoted
from topcli.figures.figure import Figure, Loaded, Request, deferred
from topcli.figures.picture import Grid, Line, Panel, component_symbol
from topcli.figures.scenes import scene_figure
from topcli.figures.space import Polhodes, Sphere
from topcli.schemes.plugins import origin_of, plugin_failures

Load = Callable[[Request], Loaded]


def _headed(scheme: str, figsize: tuple[float, float]) -> Grid:
    """One row of panels under a line with top, scheme, h and the distance from the upright position at the start."""
    heading = rf"Kowalevski top, {scheme}, $h = 10^{{-3}}$, $\epsilon = \gamma_3(0) = 10^{{-3}}$"
    return Grid(figsize=figsize, heading=heading)


def _components(vector: str) -> tuple[str, str, str]:
    return f"{vector}1", f"{vector}2", f"{vector}3"


def _lines(vector: str) -> tuple[Line, ...]:
    return tuple(Line(name, component_symbol(name)) for name in _components(vector))


def _motion_figure(name: str, scheme: str, scene: str) -> Figure:
    """Figure of gamma on the left and omega on the right."""
    panels = (
        Panel(_lines("gamma"), r"vertical $\boldsymbol{\gamma}$", ylim=(-1.1, 1.1), title="(a)"),
        Panel(_lines("omega"), r"angular velocity $\boldsymbol{\omega}$", title="(b)"),
    )
    title = f"Kowalevski top, {scheme}: gamma and omega"
    return scene_figure(name, title, scene, panels, _headed(scheme, (7.0, 2.9)))


def _traces() -> tuple[Sphere, ...]:
    """Traces of the axis of Lagrange's top in space, and of the vertical in the body frame of Kowalevski's top."""
    in_body: dict[str, Any] = {"elevation": -20.0, "azimuth": 35.0, "axes": ("e_1", "e_2", "e_3"), "band": False}
    return (
        Sphere("(a) Lagrange: cusps", _components("a")),
        Sphere("(b) Lagrange: loops", _components("lagrange_loops:a")),
        Sphere("(c) Lagrange: waves", _components("lagrange_waves:a")),
        Sphere("(d) Kowalevski: near homoclinic", _components(f"{_HYBRID}:gamma"), time=f"{_HYBRID}:t", **in_body),
        Sphere("(e) Kowalevski: generic", _components(f"{_GENERIC}:gamma"), width=0.5, **in_body),
    )


_HYBRID, _GENERIC = "kowalevski_hybrid", "kowalevski_generic_hk"
_MODIFIED = (
    Line("m_sq", r"$\boldsymbol{m}^2$"),
    Line("modified_m_sq", r"$\boldsymbol{m}^2/K$"),
    Line("modified_k12", r"$\kappa_{12}$", dots=40),
)
_MODIFIED_COLUMNS = ["t", *(line.column for line in _MODIFIED)]

FIGURES: dict[str, Figure] = {
    figure.name: figure
    for figure in (
        _motion_figure("fig1", "HK", "kowalevski_hk"),
        _motion_figure("fig2", "Bohlin A", "kowalevski_bohlin_a"),
        scene_figure(
            "fig3",
            "Kowalevski top, Bohlin A: energy E and vertical angular momentum 2l, and their changes",
            "kowalevski_bohlin_a",
            (
                Panel(
                    (Line("energy", "$E$"), Line("two_l", r"$2\ell$")),
                    "change since $t = 0$",
                    change=True,
                    whole=(0.0, 6.0),
                ),
            ),
            _headed("Bohlin A", (7.0, 3.1)),
        ),
        _motion_figure("fig4", "hybrid", "kowalevski_hybrid"),
        scene_figure(
            "polhodes",
            "Euler top: curves of omega in the body (polhodes), and one that starts near the middle axis",
            "euler_tennis_racket",
            (Polhodes((3.0, 2.0, 1.0)),),
            Grid(figsize=(5.0, 5.9)),
        ),
        scene_figure(
            "modified",
            "Euler top, HK scheme: deviations of an integral and of modified integrals that HK conserves",
            "euler_hk",
            (
                Panel(_MODIFIED[:2], r"$\boldsymbol{m}^2$, $\boldsymbol{m}^2/K$", title="(a)"),
                Panel(
                    _MODIFIED,
                    "largest relative deviation so far",
                    title="(b)",
                    log=True,
                    deviation=True,
                    ylim=(1e-17, 1.0),
                ),
            ),
            Grid(figsize=(7.0, 2.9), heading="Euler top, HK, $h = 0.1$"),
            overrides=("name=euler_modified", "h=0.1", "N=1000", f"output.columns={_MODIFIED_COLUMNS}"),
        ),
        scene_figure(
            "traces",
            "Traces on the sphere: axis of the Lagrange top, and vertical in the body frame of the Kowalevski top",
            "lagrange_cusps",
            _traces(),
            Grid(
                2,
                figsize=(7.0, 5.3),
                ncols=5,
                heading=r"(a)-(c) axis $\boldsymbol{a}$ in space; (d), (e) vertical $\boldsymbol{\gamma}$ in the body",
                first=("trace", "on the far side"),
            ),
            ("lagrange_loops", "lagrange_waves", _HYBRID, _GENERIC),
        ),
        Figure(
            "bifurcation",
            "Kowalevski top: bifurcation diagrams with the classes of tori, and packaged scenes as points",
            "kowalevski_hk",
            deferred("motion:load_bifurcation"),
        ),
        Figure(
            "body",
            "Euler, Lagrange and Kowalevski tops: the bodies in space with the traces of their axes",
            "euler_attitude",
            deferred("scenes:load_body"),
        ),
        Figure(
            "period",
            "Kowalevski top: why the period in Figure 2 differs from that in Figure 1",
            "kowalevski_hk",
            deferred("period:load_period"),
        ),
        Figure(
            "long-energy",
            "Kowalevski and Euler tops: long-time energy errors under integrable, canonical and other schemes",
            "euler_hk",
            deferred("growth:load_long_energy"),
        ),
        Figure(
            "chaos",
            "Chaotic orbits of the HK scheme of the Kowalevski top against the step size",
            "kowalevski_generic_hk",
            deferred("chaos:load_chaos"),
        ),
        Figure(
            "torus-points",
            "Kowalevski top: section of a torus with points of an integrable map at h = 1 and of HK",
            "kowalevski_generic_backlund",
            deferred("torus:load_torus_points"),
        ),
        Figure(
            "work-precision",
            "CPU time against error: schemes of topcli and integrators of other packages",
            "topcli bench",
            deferred("comparison:load_work_precision"),
        ),
    )
}


def figure(name: str, *, title: str, scene: str = "") -> Callable[[Load], Load]:
    """Register the decorated function as a figure of ``topcli plot``.

    Parameters
    ----------
    name : str
        Name of the figure and of its files, in lower case.
    title : str
        Description on one line.
    scene : str, optional
        Name of the scene whose results the figure shows, or the command that computes these results.

    Returns
    -------
    callable
        Decorator that registers the function and returns it unchanged. The decorated function
        takes a ``topcli.figures.figure.Request`` and returns a ``topcli.figures.figure.Loaded``, which contains panels
        and the data that they draw.

    Raises
    ------
    ValueError
        If there is already a figure with this name.
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
    failures = [] if wanted in FIGURES else plugin_failures()
    if wanted in FIGURES:
        return FIGURES[wanted]
    if failed := next((failure for failure in failures if failure.name.lower() == wanted), None):
        raise SchemeCodeError(f"figure {wanted!r}: {failed}")
    raise UnknownNameError(f"unknown figure {quoted(name)}; {nearest(name, FIGURES)}", *map(str, failures[:2]))
