"""The figures that topcli can draw, each a scene and the panels made from its columns.

Figures 1 to 4 are those of Sogo, *Discrete Spinning Tops*, section 3.2, at the paper's values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from topcli.contracts import Array
from topcli.errors import UnknownNameError, nearest, quoted
from topcli.figures.growth import GrowthPanel
from topcli.figures.picture import Drawable, Line, Panel
from topcli.figures.polhodes import Polhodes
from topcli.figures.sphere import Sphere
from topcli.figures.work_precision import work_precision

Measured = Callable[[Path], tuple[Sequence[Drawable], dict[str, np.ndarray], str]]
"""From the folder of results: the panels, their data, and what they were made from."""


@dataclass(frozen=True)
class Study:
    """Where a figure's columns come from when not from runs: ``columns()`` makes them, ``code()`` tells by what."""

    columns: Callable[[], Mapping[str, Array]]
    code: Callable[[], str]


@dataclass(frozen=True)
class FigureSpec:
    """One figure: its ``name``, what it shows, the ``scene`` whose run it reads, and its panels.

    A column written as ``scene:column`` is read from the run of another scene. A figure with a ``study`` reads none:
    the study makes its columns. A ``measured`` figure has no scene and no panels of its own: it is drawn from finished
    measurements, and where there are none, not at all.
    """

    name: str
    title: str
    scene: str
    panels: tuple[Drawable, ...]
    study: Study | None = None
    measured: Measured | None = None

    @property
    def columns(self) -> list[str]:
        """The columns of the run that the panels use, in the order of first use."""
        used = [name for panel in self.panels for name in panel.columns]
        return list(dict.fromkeys(used))

    @property
    def sources(self) -> dict[str, dict[str, str]]:
        """The scenes read, each with the columns taken from its run and the names they get in the figure's data."""
        found: dict[str, dict[str, str]] = {}
        for name in () if self.study else self.columns:
            scene, _, column = name.rpartition(":")
            found.setdefault(scene or self.scene, {})[column] = name
        return found


def _growth_columns() -> Mapping[str, Array]:
    from topcli.studies.growth import growth_columns

    return growth_columns()


def _growth_code() -> str:
    from topcli.studies.growth import growth_code

    return growth_code()


def _motion() -> tuple[Panel, Panel]:
    """Gamma on the left, omega on the right."""

    def lines(vector: str) -> tuple[Line, ...]:
        return tuple(Line(f"{vector}{i}") for i in (1, 2, 3))

    return (
        Panel(lines("gamma"), r"$\boldsymbol{\gamma}$", ylim=(-1.1, 1.1), title="(a) {scheme}"),
        Panel(lines("omega"), r"$\boldsymbol{\omega}$", title="(b) {scheme}"),
    )


_GAMMA = ("gamma1", "gamma2", "gamma3")

FIGURES: dict[str, FigureSpec] = {
    spec.name: spec
    for spec in (
        FigureSpec("fig1", "Kowalevski top, HK scheme: gamma and omega", "kowalevski_hk", _motion()),
        FigureSpec("fig2", "Kowalevski top, Bohlin A: gamma and omega", "kowalevski_bohlin_a", _motion()),
        FigureSpec(
            "fig3",
            "Kowalevski top, Bohlin A: 2l and E, and E enlarged",
            "kowalevski_bohlin_a",
            (
                Panel((Line("energy"), Line("two_l")), ylim=(0.0, 6.0), title="(a) {scheme}"),
                Panel((Line("energy"),), title="(b) {scheme}"),
            ),
        ),
        FigureSpec("fig4", "Kowalevski top, hybrid scheme: gamma and omega", "kowalevski_hybrid", _motion()),
        FigureSpec(
            "polhodes",
            "Euler top: polhodes on the energy ellipsoid, and the tennis racket's",
            "euler_tennis_racket",
            (Polhodes((3.0, 2.0, 1.0)),),
        ),
        FigureSpec(
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
        FigureSpec(
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
        FigureSpec(
            "nutation",
            "Lagrange top: the trace of its axis with cusps, loops and waves",
            "lagrange_cusps",
            tuple(
                Sphere(name, (f"lagrange_{name}:a1", f"lagrange_{name}:a2", f"lagrange_{name}:a3"))
                for name in ("cusps", "loops", "waves")
            ),
        ),
        FigureSpec(
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
                    figsize=(8.2, 3.2),
                ),
                GrowthPanel(
                    (("k_sq:hybrid", r"$\xi$ recomputed"), ("k_sq:hybrid-xi", r"$\xi$ carried")),
                    "(b) $k^2$, Kowalevski top, hybrid",
                ),
            ),
            Study(_growth_columns, _growth_code),
        ),
        FigureSpec("work-precision", "Speed against error, from topcli bench", "", (), measured=work_precision),
    )
}


def figure_spec(name: str) -> FigureSpec:
    """The figure called ``name``. Raises UnknownNameError with the nearest names."""
    try:
        return FIGURES[name.lower()]
    except KeyError:
        raise UnknownNameError(f"unknown figure {quoted(name)}; {nearest(name, FIGURES)}") from None
