"""Figures of what schemes conserve and cost: chaos, points on a torus, energies, modified integrals, CPU time.

The HK scheme of Kowalevski's top is not an integrable map: with the step size, chaotic orbits appear and spread. That
of Lagrange's top is integrable, and so is ``backlund``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.lyapunov import Growth, growth_of, shares_of_chaos
from topcli.contracts import Array
from topcli.engine.consumers import energy_of
from topcli.figures.figure import Columns, NothingMeasuredError, figure
from topcli.figures.style import DASHES, MARKERS, labelled, legend_above, legend_below, looks
from topcli.runs.simulate import simulate
from topcli.schemes.display import display_name
from topcli.schemes.registry import find_scheme
from topcli.store.identity import digest_of_texts
from topcli.studies.bench import draw_speed_against_error
from topcli.studies.report import read_record
from topcli.tops import TOPS

ORBIT_STEPS = 10_000
"""Steps of an orbit: 97 % of the verdicts are those of orbits 20 times longer (``benchmarks/indicators.py``)."""
MAP_STEPS, MAP_SIZE = 4_000, 100
ORBITS = 1024
STEP_SIZES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.6, 0.8)
MAPS = {
    "HK, Kowalevski": ("hk", "kowalevski"),
    "HK, Lagrange": ("hk", "lagrange"),
    "Bäcklund, Kowalevski": ("backlund", "kowalevski"),
}
"""Scheme and top of each map."""


def chaotic_share(growth: Growth) -> tuple[float, float]:
    """Share of chaotic orbits among those with a verdict, and its standard error (of at least half an orbit)."""
    chaotic = shares_of_chaos(growth.verdicts)
    count = max(1, int(np.isfinite(chaotic).sum()))
    share = float(np.nansum(chaotic)) / count
    return share, max(np.sqrt(share * (1.0 - share) / count), 0.5 / count)


def _growth(label: str, h: float, steps: int, y: Array) -> Growth:
    """Growth of tangent vectors along the orbits of one of the ``MAPS`` from the states ``y`` (m, d)."""
    name, form = MAPS[label]
    top, scheme = TOPS[form].new(), find_scheme(name, form)
    return growth_of(top, scheme, scheme.build(top, scheme.options()), h, steps, y)


def draw_chaos(canvas: Any, columns: Columns) -> None:
    """Draw the exponents over step size and initial state, and the shares of chaotic orbits."""
    left, right = canvas.subplots(1, 2)

    # a cell is coloured if chaotic, white if regular (exponent 0), grey without a verdict
    h, omega = np.unique(columns["map:h"]), np.unique(columns["map:omega"])
    exponents = columns["map:exponent"].reshape(len(h), len(omega)).T
    left.set_facecolor("0.75")
    left.pcolormesh(h, omega, np.ma.masked_not_equal(exponents, 0.0), cmap="Greys", rasterized=True)
    positive = np.ma.masked_less_equal(np.ma.masked_invalid(exponents), 0.0)
    chaotic = left.pcolormesh(h, omega, positive, cmap="viridis_r", rasterized=True)
    canvas.colorbar(chaotic, ax=left, pad=0.02, label="exponent of chaotic orbits per unit of time")
    left.grid(visible=False)
    speed = r"initial angular speed $|\boldsymbol{\omega}(0)|$"
    labelled(left, "step size $h$", speed, "(a) HK, Kowalevski top; white: regular")

    for i, (label, (scheme, _)) in enumerate(MAPS.items()):
        share, error = (100.0 * columns[f"{kind}:{label}"] for kind in ("share", "error"))
        look = {"color": looks([scheme])[scheme]["color"], "linestyle": DASHES[i], "marker": MARKERS[i]}
        # the later ones smaller, so that markers at one place are seen
        right.errorbar(columns["h"], share, error, label=label, markersize=5.0 - i, capsize=2.0, **look)
    labelled(right, "step size $h$", "chaotic orbits in %", "(b) random orbits")
    right.legend(loc="upper left", fontsize="small")


@figure("chaos", "Chaotic orbits of the HK scheme of the Kowalevski top against the step size", draw_chaos)
def chaos() -> Columns:
    """Exponents over step size and the size of omega in a fixed direction; shares of chaotic orbits, with errors."""
    sizes, lengths = np.linspace(0.02, 0.8, MAP_SIZE), np.linspace(0.05, 4.0, MAP_SIZE)
    y = np.column_stack([lengths[:, None] * [0.6, 0.64, 0.48], np.tile([0.8, 0.0, 0.6], (MAP_SIZE, 1))])
    rows = []
    for h in sizes.tolist():
        growth = _growth("HK, Kowalevski", h, MAP_STEPS, y)
        share = shares_of_chaos(growth.verdicts)
        rows.append(np.where(share == 1.0, growth.exponents, share))
    columns = {"map:h": np.repeat(sizes, MAP_SIZE), "map:omega": np.tile(lengths, MAP_SIZE)}
    columns |= {"map:exponent": np.concatenate(rows), "h": np.array(STEP_SIZES)}
    # omega normal with a standard deviation of 1.5, gamma in a random direction
    y = np.random.default_rng(7).normal(size=(ORBITS, 6)) * np.repeat([1.5, 1.0], 3)
    y[:, 3:] /= np.linalg.norm(y[:, 3:], axis=1, keepdims=True)
    for label in MAPS:
        shares = [chaotic_share(_growth(label, h, ORBIT_STEPS, y)) for h in STEP_SIZES]
        columns[f"share:{label}"], columns[f"error:{label}"] = map(np.array, zip(*shares, strict=True))
    return columns


MAP_POINTS = 1_000_000
FLOW = ("scheme=taylor", "h=0.02", "N=500000", "section.component=omega1", "section.direction=both")
THICKNESS = 0.01
"""Largest ``abs(omega1)`` of a point of a map on the section omega1 = 0."""


def draw_torus_points(canvas: Any, columns: Columns) -> None:
    """Draw the points of each map over the section of the torus of the motion, in grey."""
    for axes, letter, scheme in zip(canvas.subplots(1, 2), "ab", ("backlund", "hk"), strict=True):
        x, y = columns[f"{scheme}:omega2"], columns[f"{scheme}:gamma2"]
        look = {"markeredgewidth": 0.0, "rasterized": True, "color": looks([scheme])[scheme]["color"]}
        grey = {**look, "color": "0.75", "markersize": 3.4}
        axes.plot(columns["flow:omega2"], columns["flow:gamma2"], "s", label="motion", **grey)
        axes.plot(x, y, ".", label=display_name(scheme), markersize=1.8 if len(x) > 1000 else 3.0, **look)
        count = int(columns[f"{scheme}:points"][0])
        title = f"({letter}) {display_name(scheme)}: {count:,} points" + (", then lost" if count < MAP_POINTS else "")
        labelled(axes, r"$\omega_2$", r"$\gamma_2$", title, xlim=(-2.1, 2.1), ylim=(-1.7, 1.7))
    canvas.suptitle(rf"Kowalevski top, $h = 1$: points with $|\omega_1| < {THICKNESS:g}$", fontsize="medium")
    legend_below(canvas, 3, markerscale=3.0)


@figure("torus-points", "Kowalevski top, h = 1: points of two maps near a section", draw_torus_points, (7.0, 3.8))
def torus_points() -> Columns:
    """Points near the section and number of all points of each map, and the motion's crossings of the section.

    A map with fewer points than ``MAP_POINTS`` has left the energy surface after them.
    """
    columns: dict[str, Array] = {}
    for scheme in ("backlund", "hk"):
        sets = [f"scheme={scheme}", f"N={MAP_POINTS - 1}", "output.every=1"]
        run = simulate("kowalevski_generic_backlund", sets)
        states = run.states[: run.ending.left]
        near = states[np.abs(states[:, 0]) < THICKNESS]
        columns |= {f"{scheme}:points": np.array([len(states)])}
        columns |= {f"{scheme}:omega2": near[:, 1], f"{scheme}:gamma2": near[:, 4]}
    flow = simulate("kowalevski_generic_backlund", FLOW)
    return {**columns, "flow:omega2": flow["omega2"], "flow:gamma2": flow["gamma2"]}


ENERGY_STEPS = 1 << 20
ENERGY_H = 0.05
PER_OCTAVE = 6
"""Points of a curve in each octave of steps."""
ENERGY_SCENES = {"kowalevski_generic_hk": "(a) Kowalevski top", "euler_hk": "(b) Euler top"}
ENERGY_SCHEMES = ("splitting", "dmv", "hk", "midpoint", "rk4")
"""The last one is the control, whose energy drifts."""


def draw_long_energy(canvas: Any, columns: Columns) -> None:
    """Draw the largest energy error so far under each scheme."""
    styles = looks(map(display_name, ENERGY_SCHEMES))
    for axes, (scene, title) in zip(canvas.subplots(1, 2), ENERGY_SCENES.items(), strict=True):
        for name in ENERGY_SCHEMES:
            error = columns[f"{scene}:{name}"]
            positive = np.where(error > 0.0, error, np.nan)  # a logarithmic axis has no zero
            axes.plot(columns["t"], positive, label=display_name(name), **styles[display_name(name)])
        scales = {"xscale": "log", "yscale": "log", "xlim": columns["t"][[0, -1]]}
        labelled(axes, "time $t$", "largest relative energy error so far", f"{title}, $h = {ENERGY_H}$", **scales)
    legend_below(canvas, len(ENERGY_SCHEMES), loc="outside upper center")


@figure("long-energy", "Kowalevski and Euler tops: energy errors over a long time", draw_long_energy, (7.0, 3.2))
def long_energy() -> Columns:
    """Times, and the largest energy error up to them relative to the size of its terms at the start."""
    ends = np.unique(np.round(2.0 ** np.arange(0.0, np.log2(ENERGY_STEPS) + 1e-9, 1.0 / PER_OCTAVE)).astype(int))
    columns = {"t": ENERGY_H * ends}
    for scene in ENERGY_SCENES:
        for name in ENERGY_SCHEMES:
            run = simulate(scene, [f"scheme={name}", f"h={ENERGY_H}", f"N={ENERGY_STEPS}", "output.every=1"])
            states, energy = run.states, energy_of(run.top)
            assert energy is not None
            error = np.abs(energy.value(states) - energy.value(states[:1])) / energy.scale(states[:1])
            columns[f"{scene}:{name}"] = np.maximum.accumulate(error)[ends]
    return columns


MODIFIED = {"m_sq": r"$\boldsymbol{m}^2$", "modified_m_sq": r"$\boldsymbol{m}^2/K$", "modified_k12": r"$\kappa_{12}$"}


def draw_modified(canvas: Any, columns: Columns) -> None:
    """Draw an integral and modified integrals, and their largest relative deviations so far."""
    left, right = canvas.subplots(1, 2)
    for name, symbol in MODIFIED.items():
        values = columns[name]
        deviation = np.maximum.accumulate(np.abs(values / values[0] - 1.0))
        # the last one coincides with another: rings instead of a line
        ring = {"ls": "none", "marker": "o", "ms": 3.2, "mfc": "none", "mew": 0.8, "markevery": len(values) // 40}
        look = ring if name == "modified_k12" else {}
        right.plot(columns["t"], np.where(deviation > 0.0, deviation, np.nan), label=symbol, **look)
        if not look:
            left.plot(columns["t"], values, label=symbol)
    limits = columns["t"][[0, -1]]
    labelled(left, "time $t$", r"$\boldsymbol{m}^2$, $\boldsymbol{m}^2/K$", "(a)", xlim=limits)
    options = {"xlim": limits, "yscale": "log", "ylim": (1e-17, 1.0)}
    labelled(right, "time $t$", "largest relative deviation so far", "(b)", **options)
    legend_above(left)
    legend_above(right)
    canvas.suptitle("Euler top, HK, $h = 0.1$", fontsize="medium")


@figure("modified", "Euler top, HK: an integral, and modified integrals that HK conserves", draw_modified)
def modified_integrals() -> Columns:
    """Times, an integral and two modified integrals."""
    run = simulate("euler_hk", ["h=0.1", "N=1000"])
    return {"t": run.t, **{name: run[name] for name in MODIFIED}}


FOLDER = Path("results") / "bench"
"""Folder of the reports, ``topcli bench --save results/bench/NAME.json``; there is a panel for each."""
POINT_KEYS = ("scheme", "peer", "error", "seconds", "set_up")
"""Keys of the points that are drawn."""


def draw_work_precision(canvas: Any, columns: Columns) -> None:
    """Draw a panel for each scene: our fastest schemes in colours, others in grey."""
    titles = list(dict.fromkeys(key.partition("|")[0] for key in columns))
    rows = -(-len(titles) // 2)
    canvas.set_size_inches(7.0, 1.0 + 2.8 * rows)
    for i, title in enumerate(titles, 1):
        values = zip(*(columns[f"{title}|{key}"] for key in POINT_KEYS), strict=True)
        axes = canvas.add_subplot(rows, min(2, len(titles)), i)
        draw_speed_against_error([dict(zip(POINT_KEYS, row, strict=True)) for row in values], axes, looks)
        axes.set_title(title, loc="left")
    legend_below(canvas, 3)


def stored_digests() -> str:
    """Digest of the stored reports."""
    return digest_of_texts(file.read_text(encoding="utf-8") for file in sorted(FOLDER.glob("*.json")))


@figure("work-precision", "CPU time against error, of topcli and others", draw_work_precision, takes=stored_digests)
def work_precision() -> Columns:
    """Points of all curves, ``scene|key``.

    Raises NothingMeasuredError if no benchmark is stored.
    """
    records = [read_record(file) for file in sorted(FOLDER.glob("*.json"))]
    if not records:
        raise NothingMeasuredError(f"no report in {FOLDER}; topcli bench --save {FOLDER / 'NAME.json'} writes one")
    scenes = {record["config"]["name"]: record["tables"][-1]["rows"] for record in records}
    return {
        f"{name}|{key}": np.array(["" if row[key] is None else row[key] for row in rows])
        for name, rows in scenes.items()
        for key in POINT_KEYS
    }
