"""Picture of each scheme for its page: a short run beside the exact motion, and what happens to the integrals."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Scheme
from topcli.schemes.display import display_name

STEP, STEPS = 0.05, 1000
SCENES = {
    "kowalevski": "kowalevski_generic_hk",
    "euler": "euler_hk",
    "euler+gamma": "euler_gamma_hk",
    "lagrange": "lagrange_hk",
    "lagrange/inertial": "lagrange_bs",
    "heavy": "heavy_hk",
}
"""Scene of each top on which its schemes are shown; tops of the catalogue have gentle scenes."""
SOURCES = Path(__file__).resolve().parent.parent / "src" / "topcli"
SMALLEST = 1e-17
"""Deviations of 0 are drawn here."""


def scene_of(form: str) -> str:
    """Scene on which the schemes of a top are shown."""
    return SCENES.get(form, f"{form.replace('-', '_')}_gentle")


def command(scheme: Scheme) -> str:
    """Command whose result the picture shows."""
    settings = (f"scheme={scheme.name}", f"h={STEP}", f"N={STEPS}", "name=trial")
    return f"topcli run {scene_of(scheme.top)} {' '.join(f'--set {text}' for text in settings)}"


@cache
def exact_motion(scene: str) -> NDArray[np.float64]:
    """States of the reference solution of a scene at the times of the picture."""
    import topcli
    from topcli.analysis.reference import reference_states

    start = topcli.simulate(scene, h=STEP, N=1)
    return reference_states(start.top, start.states[0], STEP * np.arange(STEPS + 1))


def draw(scheme: Scheme, path: Path) -> None:
    """Draw the picture of a scheme as PNG."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    import topcli
    from topcli.figures.picture import component_symbol
    from topcli.figures.style import looks, styled

    scene = scene_of(scheme.top)
    run = topcli.simulate(scene, scheme=scheme.name, h=STEP, N=STEPS)
    place = run.top.components.index(run.top.swing)
    rows = run.n
    with styled():
        figure = Figure(figsize=(7.0, 2.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.plot(run.t, exact_motion(scene)[rows, place], color="0.75", linewidth=3, label="exact motion")
        shown = display_name(scheme.name)
        colour = looks([scheme.name])[scheme.name]["color"]
        left.plot(run.t, run.states[:, place], color=colour, linestyle="-", linewidth=1, label=shown)
        left.set(xlabel="$t$", ylabel=component_symbol(run.top.swing))
        left.legend(loc="upper center", bbox_to_anchor=(0.5, 1.22), ncols=2)
        cycle = mpl.rcParams["axes.prop_cycle"]
        for invariant, look in zip(run.top.invariants(), cycle, strict=False):
            values = np.abs(run[invariant.name] - run[invariant.name][0])
            right.semilogy(run.t, np.maximum(values, SMALLEST), **look, linewidth=1, label=f"${invariant.tex}$")
        right.set(xlabel="$t$", ylabel="deviation of the integrals", ylim=(SMALLEST, None))
        right.legend(loc="upper center", bbox_to_anchor=(0.5, 1.22), ncols=5, columnspacing=1.0, handlelength=1.5)
        figure.savefig(path, dpi=150)


@cache
def newest_source() -> float:
    """Time of the last change of a source of topcli."""
    return max(one.stat().st_mtime for one in SOURCES.rglob("*.py"))


def draw_if_old(scheme: Scheme, path: Path) -> None:
    """Draw the picture of a scheme unless there is one that is newer than all sources of topcli."""
    if not path.is_file() or path.stat().st_mtime < newest_source():
        path.parent.mkdir(parents=True, exist_ok=True)
        draw(scheme, path)
