"""Figures 1 to 4 of Sogo, *Discrete Spinning Tops*, section 3.2, at the paper's values, and the periods in them.

The scene lies at the distance eps = 1e-3 from a homoclinic orbit, and the time between swings there is
2 sqrt 2 ln(8 sqrt 7/eps). The error of a scheme acts like a larger eps, of the size of sqrt(h) for Bohlin's method A,
which is of order 1 and is followed down to h = 1e-6. Whether a scheme is reversible makes no difference: RK2, RK4 and
the hybrid are not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from topcli.analysis.swings import first_swing_spacing, minima_times, spacing_law
from topcli.contracts import Array
from topcli.figures.figure import Columns, figure
from topcli.figures.style import labelled, legend_above, looks
from topcli.runs.simulate import simulate
from topcli.schemes.display import display_name
from topcli.schemes.registry import find_scheme

_SCENES = {"HK": "kowalevski_hk", "Bohlin A": "kowalevski_bohlin_a", "hybrid": "kowalevski_hybrid"}
_VECTORS = {"gamma": r"vertical $\boldsymbol{\gamma}$", "omega": r"angular velocity $\boldsymbol{\omega}$"}
INTEGRALS = {"energy": "$E$", "two_l": r"$2\ell$"}


def _motion_figure(name: str, scheme: str) -> None:
    """Register the figure of gamma on the left and omega on the right."""

    def draw(canvas: Any, columns: Columns) -> None:
        for axes, letter, (vector, label) in zip(canvas.subplots(1, 2), "ab", _VECTORS.items(), strict=True):
            for i in (1, 2, 3):
                axes.plot(columns["t"], columns[f"{vector}{i}"], label=rf"$\{vector}_{i}$")
            labelled(axes, "time $t$", label, f"({letter})", xlim=columns["t"][[0, -1]])
            legend_above(axes)
        canvas.axes[0].set_ylim(-1.1, 1.1)
        canvas.suptitle(_heading(scheme), fontsize="medium")

    @figure(name, f"Kowalevski top, {scheme}: gamma and omega", draw)
    def data() -> Columns:
        run = simulate(_SCENES[scheme])
        return {"t": run.t, **{f"{vector}{i}": run[f"{vector}{i}"] for vector in _VECTORS for i in (1, 2, 3)}}


def _heading(scheme: str) -> str:
    return rf"Kowalevski top, {scheme}, $h = 10^{{-3}}$, $\epsilon = \gamma_3(0) = 10^{{-3}}$"


_motion_figure("fig1", "HK")
_motion_figure("fig2", "Bohlin A")


def draw_integrals(canvas: Any, columns: Columns) -> None:
    """Draw the changes of E and 2l, and the values themselves in a corner."""
    axes = canvas.subplots()
    inset = axes.inset_axes((0.07, 0.52, 0.33, 0.43))
    for name, symbol in INTEGRALS.items():
        axes.plot(columns["t"], columns[name] - columns[name][0], label=symbol)
        inset.plot(columns["t"], columns[name])
    labelled(axes, "time $t$", "change since $t = 0$", xlim=columns["t"][[0, -1]])
    legend_above(axes)
    inset.set(xlim=axes.get_xlim(), ylim=(0.0, 6.0))
    inset.tick_params(labelsize="small")
    inset.set_ylabel(", ".join(INTEGRALS.values()), fontsize="small")
    canvas.suptitle(_heading("Bohlin A"), fontsize="medium")


@figure("fig3", "Kowalevski top, Bohlin A: energy E and 2l, and their changes", draw_integrals, (7.0, 3.1))
def integrals() -> Columns:
    """Columns of Figure 3."""
    run = simulate(_SCENES["Bohlin A"])
    return {"t": run.t, **{name: run[name] for name in INTEGRALS}}


_motion_figure("fig4", "hybrid")

TIME = 50.0
SAMPLING = 0.01
"""Longest time between two recorded states."""
PAPER_STEP = _EPS = 1e-3
"""Step size of the paper, and the distance of its scene from the homoclinic orbit, gamma_3(0)."""
LAW = r"$2\sqrt{2}\,\ln(8\sqrt{7}/\epsilon)$, $\epsilon = 10^{-3}$"
USUAL = tuple(np.arange(-1.0, -4.1, -0.5))
LADDERS = dict.fromkeys(("hk", "rk2", "rk4", "hybrid"), USUAL) | {"bohlin-a": tuple(np.arange(-2.0, -6.1, -0.5))}
"""Exponents k of the step sizes 10^k of each scheme."""
_EXACT = "exact"
MOTIONS = ((_EXACT, PAPER_STEP), *((name, PAPER_STEP) for name in LADDERS), ("bohlin-a", 1e-5), ("bohlin-a", 1e-6))
"""Motions that are shown: scheme and step."""
ROW = 2.6
"""Distance between two rows, in units of gamma_1."""


def _kind(name: str) -> str:
    """Order and symmetry of a scheme in words."""
    scheme = find_scheme(name, "kowalevski")
    order = scheme.order_for(scheme.options())
    return f"order {order}, {'reversible' if scheme.self_adjoint else 'not reversible'}"


def draw_period(canvas: Any, columns: Columns) -> None:
    """Draw gamma_1 under each scheme, and the time between swings against the step size."""
    rows, steps = canvas.subplots(1, 2)
    styles = looks(LADDERS, markers=True)

    # (a) one row for each motion, the exact one at the top
    for swing in columns["swings"]:
        rows.axvline(swing, color="0.6", linewidth=0.9, linestyle="--", zorder=1.0)
    for i, (name, h) in enumerate(MOTIONS):
        colour = "black" if name == _EXACT else styles[name]["color"]
        rows.plot(columns["t"], columns[f"gamma1:{name}:{h:g}"] - ROW * i, "-", color=colour)
    names = [f"{display_name(name)}, $h = 10^{{{round(np.log10(h))}}}$" for name, h in MOTIONS[1:]]
    rows.set_yticks([0.7 - ROW * i for i in range(len(MOTIONS))], ["exact motion", *names], fontsize=8.6)
    rows.tick_params(axis="y", length=0)
    rows.grid(visible=False)
    labelled(rows, "time $t$", "", r"(a) $\gamma_1$; dashed: swings of the exact motion", xlim=(0.0, TIME))
    rows.set_ylim(-ROW * (len(MOTIONS) - 1) - 1.4, 1.4)

    # (b) filled markers for the reversible scheme; the right axis has the distance to which each time belongs
    steps.axhline(float(spacing_law(np.array(_EPS))), color="black", linewidth=1.0, linestyle="--", label=LAW)
    for name in LADDERS:
        kind = _kind(name)
        look = {**styles[name], "markersize": 4.0, "markerfacecolor": "white" if "not" in kind else None}
        steps.plot(columns[f"h:{name}"], columns[f"spacing:{name}"], label=f"{display_name(name)}: {kind}", **look)
    scaling, colour = "order 1:\n" + r"$\epsilon \propto \sqrt{h}$", styles["bohlin-a"]["color"]
    steps.text(6.5e-6, 21.4, scaling, ha="right", va="top", fontsize=9, color=colour)
    title = "(b) the same scene, other step sizes"
    labelled(steps, "step size $h$", "time between swings", title, xscale="log", ylim=(6.0, 33.0))
    steps.legend(loc="lower left", fontsize=8, handlelength=2.0)
    steps.tick_params(axis="y", right=False)
    scale = steps.secondary_yaxis("right")
    scale.set_yticks(spacing_law(np.array([1e-1, 1e-2, 1e-3])), ["$10^{-1}$", "$10^{-2}$", "$10^{-3}$"])
    scale.set_ylabel(r"distance $\epsilon$ that the law gives for this time")


def _gamma1(scheme: str, h: float) -> tuple[Array, Array]:
    """Times and gamma_1 of a run with a step near ``h`` that divides the time, each (m,)."""
    N = round(TIME / h)
    sets = [f"scheme={scheme}", f"h={TIME / N!r}", f"N={N}", f"output.every={max(1, round(SAMPLING / h))}"]
    run = simulate(_SCENES["HK"], sets)
    return run.t, run["gamma1"]


@figure("period", "Kowalevski top: why the period in Figure 2 differs from that in Figure 1", draw_period, (7.0, 4.4))
def period() -> Columns:
    """Columns of the motions shown, the swings of the exact one, and the time between swings for each step size."""
    columns: dict[str, Array] = {"t": SAMPLING * np.arange(round(TIME / SAMPLING) + 1)}
    runs = {(name, h): _gamma1(name, h) for name, h in MOTIONS}
    for (name, h), run in runs.items():
        columns[f"gamma1:{name}:{h:g}"] = np.interp(columns["t"], *run)
    columns["swings"] = minima_times(*runs[MOTIONS[0]])
    for name, exponents in LADDERS.items():
        sizes = [TIME / round(TIME / 10.0**k) for k in exponents]
        spacings = [first_swing_spacing(minima_times(*_gamma1(name, h))) for h in sizes]
        columns[f"h:{name}"] = np.array(sizes)
        columns[f"spacing:{name}"] = np.array([np.nan if s is None else s for s in spacings])
    return columns
