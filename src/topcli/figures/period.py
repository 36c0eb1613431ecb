"""Figure ``period``: the periods of the paper's Figures 1 and 2 differ because of the order of the scheme.

The scene lies at the distance eps = 1e-3 from a homoclinic orbit, and the time between swings there is
2 sqrt 2 ln(8 sqrt 7/eps). The error of a scheme acts like a larger eps, of the size of sqrt(h) for Bohlin's method A,
which is of order 1 and is followed down to h = 1e-6. Whether a scheme is reversible makes no difference: RK2, RK4 and
the hybrid are not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.swings import first_swing_spacing, minima_times, spacing_law
from topcli.config.load import load_experiment
from topcli.contracts import Array
from topcli.engine.collect import orbit
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import Grid, caption, halo
from topcli.figures.style import Styles, looks
from topcli.schemes.display import display_name
from topcli.studies.entries import under_scheme

if TYPE_CHECKING:
    from topcli.config.models import Experiment

SCENE = "kowalevski_hk"
EPS = 1e-3
"""Distance of the scene from the homoclinic orbit, gamma_3(0)."""
TIME = 50.0
SAMPLING = 0.01
"""Longest time between two recorded states."""
PAPER_STEP = 1e-3
LAW = r"$2\sqrt{2}\,\ln(8\sqrt{7}/\epsilon)$"
"""Time between the swings at the distance eps from the homoclinic orbit."""


@dataclass(frozen=True)
class DrawnScheme:
    """A scheme of the figure, its order, its symmetry, and the exponents k of the steps 10^k."""

    name: str
    order: int
    reversible: bool
    exponents: tuple[float, ...]


_USUAL = (-1.0, -1.5, -2.0, -2.5, -3.0, -3.5, -4.0)
SCHEMES = (
    DrawnScheme("hk", 2, True, _USUAL),
    DrawnScheme("rk2", 2, False, _USUAL),
    DrawnScheme("rk4", 4, False, _USUAL),
    DrawnScheme("hybrid", 2, False, _USUAL),
    DrawnScheme("bohlin-a", 1, False, (-2.0, -2.5, -3.0, -3.5, -4.0, -4.5, -5.0, -5.5, -6.0)),
)
EXACT = "exact"
SHOWN: tuple[tuple[str, float], ...] = (
    (EXACT, PAPER_STEP),
    *((scheme.name, PAPER_STEP) for scheme in SCHEMES),
    ("bohlin-a", 1e-5),
    ("bohlin-a", 1e-6),
)
"""Motions that are shown: scheme and step."""


ABOVE = 0.27
"""Height of the axes from which the legend leaves room."""
ROW = 2.6
"""Distance between two rows, in units of gamma_1."""
ORDINALS = {1: "order 1", 2: "order 2", 4: "order 4"}


def _power(h: float) -> str:
    return rf"$h = 10^{{{round(np.log10(h))}}}$"


def _kind(scheme: DrawnScheme) -> str:
    return f"{ORDINALS[scheme.order]}, {'reversible' if scheme.reversible else 'not reversible'}"


def _row_label(name: str, h: float) -> str:
    """Text at the left of a row."""
    if name == EXACT:
        return "exact motion\n(closed form)"
    scheme = next(scheme for scheme in SCHEMES if scheme.name == name)
    return f"{display_name(name)}, {_power(h)}\n{_kind(scheme)}"


@dataclass(frozen=True)
class MotionRows:
    """Gamma_1 of the motion and of the schemes, one row each, with vertical lines at the swings of the motion."""

    title: str

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the rows into ``axes``, the first one at the top."""
        styles_of = {**looks(scheme.name for scheme in SCHEMES), EXACT: {"color": "black"}}
        heights = [-ROW * i for i in range(len(SHOWN))]
        for swing in data["swings"][np.isfinite(data["swings"])]:  # columns have the same length
            axes.axvline(float(swing), color="0.6", linewidth=0.9, linestyle="--", zorder=1.0)
        for height, (name, h) in zip(heights, SHOWN, strict=True):
            axes.plot(data["t"], data[motion_column(name, h)] + height, **{**styles_of[name], "linestyle": "-"})
        axes.set_xlim(0.0, float(data["t"][-1]))
        axes.set_ylim(heights[-1] - 1.4, 1.4)
        axes.set_yticks([height + 0.4 for height in heights], [_row_label(name, h) for name, h in SHOWN], fontsize=8.6)
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False)
        caption(axes, "time $t$", "", self.title)


@dataclass(frozen=True)
class SpacingOverStep:
    """Time between swings against h for each scheme, the law, and the distance eps to which each time belongs."""

    title: str

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the points, the law and the second scale into ``axes``."""
        styles_of = looks((scheme.name for scheme in SCHEMES), markers=True)
        law = float(spacing_law(np.array(EPS)))
        axes.axhline(law, color="black", linewidth=1.0, linestyle="--", zorder=1.0)
        for scheme in SCHEMES:
            h, spacing = data[f"h:{scheme.name}"], data[f"spacing:{scheme.name}"]
            hollow = {} if scheme.reversible else {"markerfacecolor": "white"}
            label = f"{display_name(scheme.name)}: {_kind(scheme)}"
            look = {**styles_of[scheme.name], "markersize": 4.0, **hollow}
            axes.plot(h, spacing, label=label, **look)
        axes.axvline(PAPER_STEP, ABOVE, color="0.75", linewidth=0.9, linestyle=":", zorder=1.0)
        axes.text(PAPER_STEP * 1.15, 31.6, "the paper's $h$", fontsize=8, color="0.35", va="center")
        halo(axes.text(1.2e-6, law + 0.35, LAW + r", $\epsilon = 10^{-3}$", fontsize=9, va="bottom"))
        axes.annotate(
            "order 1:\n" + r"$\epsilon \propto \sqrt{h}$",
            (1e-5, 21.8),
            (-6, -4),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=9,
            color=styles_of["bohlin-a"]["color"],
        )
        axes.set_xscale("log")
        axes.tick_params(axis="y", right=False)
        axes.set_ylim(8.0, 33.0)
        caption(axes, "step size $h$", "time between swings", self.title)
        axes.legend(loc="lower left", fontsize=8, handlelength=2.0)
        powers = (-1, -2, -3)
        scale = axes.secondary_yaxis("right")
        scale.set_yticks(spacing_law(10.0 ** np.array(powers)), [f"$10^{{{k}}}$" for k in powers])
        scale.set_ylabel(r"distance $\epsilon$ that the law gives for this time")


PANELS = (
    MotionRows(r"(a) $\gamma_1$; dashed: swings of the exact motion"),
    SpacingOverStep("(b) the same scene, other step sizes"),
)


def load_period(request: Request) -> Loaded:
    """Load the motions of the paper's scene, and the time between swings against h."""
    source = {"scenes": [_experiment(name).digest for name, _ in _steps(SCHEMES, SHOWN)]}
    return Loaded(PANELS, lambda: period_columns(request.on_progress), source, Grid(figsize=(7.0, 4.4)))


def motion_column(name: str, h: float) -> str:
    """Name of the column of gamma_1 under a scheme with the step ``h``."""
    return f"gamma1:{name}:{h:g}"


def _steps(schemes: Sequence[DrawnScheme], shown: Sequence[tuple[str, float]]) -> list[tuple[str, int]]:
    """Every run: name of the scheme and number of steps."""
    pairs = [(scheme.name, 10.0**k) for scheme in schemes for k in scheme.exponents]
    return list(dict.fromkeys((name, round(TIME / h)) for name, h in (*shown, *pairs)))


def _experiment(name: str) -> Experiment:
    return under_scheme(load_experiment(SCENE), name)


def _gamma1(experiment: Experiment, N: int) -> tuple[Array, Array]:
    """Times and gamma_1 of a run in N steps, each (m,)."""
    h = TIME / N
    run = orbit(experiment.top, experiment.method(), experiment.y0, h, N, max(1, round(SAMPLING / h)))
    return run.n * h, run.states[:, 3]


def period_columns(
    on_progress: Callable[[int, int], None],
    schemes: Sequence[DrawnScheme] = SCHEMES,
    shown: Sequence[tuple[str, float]] = SHOWN,
) -> Mapping[str, Array]:
    """Columns of the figure.

    ``t`` and ``gamma1:<scheme>:<h>`` of the motions shown, ``swings``, the times of the minima of the first of them,
    and for each scheme ``h:<scheme>`` and ``spacing:<scheme>``.
    """
    todo = _steps(schemes, shown)
    total = sum(N for _, N in todo)
    done, runs = 0, {}
    for name, N in todo:
        runs[name, N] = _gamma1(_experiment(name), N)
        done += N
        on_progress(done, total)
    columns: dict[str, Array] = {"t": SAMPLING * np.arange(round(TIME / SAMPLING) + 1)}
    for name, h in shown:
        columns[motion_column(name, h)] = np.interp(columns["t"], *runs[name, round(TIME / h)])
    columns["swings"] = minima_times(*runs[EXACT, round(TIME / PAPER_STEP)])
    for scheme in schemes:
        own = {N: run for (name, N), run in runs.items() if name == scheme.name}
        spacings = {N: first_swing_spacing(*run) for N, run in sorted(own.items())}
        columns[f"h:{scheme.name}"] = np.array([TIME / N for N in spacings])
        columns[f"spacing:{scheme.name}"] = np.array([np.nan if s is None else s for s in spacings.values()])
    return columns
