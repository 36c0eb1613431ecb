"""The figures that topcli can draw, each a scene and the panels made from its columns.

Figures 1 to 4 are those of Sogo, *Discrete Spinning Tops*, section 3.2, at the paper's values.
"""

from __future__ import annotations

from dataclasses import dataclass

from topcli.errors import UnknownNameError, nearest
from topcli.figures.picture import Line, Panel
from topcli.figures.sphere import Sphere


@dataclass(frozen=True)
class FigureSpec:
    """One figure: its ``name``, what it shows, the ``scene`` whose run it reads, and its panels.

    A column written as ``scene:column`` is read from the run of another scene.
    """

    name: str
    title: str
    scene: str
    panels: tuple[Panel | Sphere, ...]

    @property
    def columns(self) -> list[str]:
        """The columns of the run that the panels use, in the order of first use."""
        used: list[str] = []
        for panel in self.panels:
            used += panel.columns if isinstance(panel, Sphere) else (panel.x, *(line.column for line in panel.lines))
        return list(dict.fromkeys(used))

    @property
    def sources(self) -> dict[str, dict[str, str]]:
        """The scenes read, each with the columns taken from its run and the names they get in the figure's data."""
        found: dict[str, dict[str, str]] = {}
        for name in self.columns:
            scene, _, column = name.rpartition(":")
            found.setdefault(scene or self.scene, {})[column] = name
        return found


_GAMMA = Panel(
    tuple(Line(f"gamma{i}", rf"$\gamma_{i}$") for i in (1, 2, 3)), r"$\boldsymbol{\gamma}$", ylim=(-1.1, 1.1)
)
_OMEGA = Panel(tuple(Line(f"omega{i}", rf"$\omega_{i}$") for i in (1, 2, 3)), r"$\boldsymbol{\omega}$")

FIGURES: dict[str, FigureSpec] = {
    spec.name: spec
    for spec in (
        FigureSpec("fig1", "Kowalevski top, HK scheme: gamma and omega", "kowalevski_hk", (_GAMMA, _OMEGA)),
        FigureSpec("fig2", "Kowalevski top, Bohlin A: gamma and omega", "kowalevski_bohlin_a", (_GAMMA, _OMEGA)),
        FigureSpec(
            "fig3",
            "Kowalevski top, Bohlin A: 2l and E, and E enlarged",
            "kowalevski_bohlin_a",
            (
                Panel((Line("energy", "$E$"), Line("two_l", r"$2\ell$")), r"$E,\ 2\ell$", ylim=(0.0, 6.0)),
                Panel((Line("energy", "$E$"),), "$E$"),
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
        FigureSpec("fig4", "Kowalevski top, hybrid scheme: gamma and omega", "kowalevski_hybrid", (_GAMMA, _OMEGA)),
    )
}


def figure_spec(name: str) -> FigureSpec:
    """The figure called ``name``. Raises UnknownNameError with the nearest names."""
    try:
        return FIGURES[name.lower()]
    except KeyError:
        raise UnknownNameError(f"unknown figure {name!r}; {nearest(name, FIGURES)}") from None
