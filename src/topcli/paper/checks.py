"""Checks that decide the claims: each measures a figure and says which figures a true statement may have.

A check takes the parameters that ``claims.yaml`` gives and knows neither the statement nor its recorded verdict. The
first line of its docstring is what it measures; limit and reason are known before anything is measured. A
*scene* is the name of a packaged config and overrides between blanks, each ``key=value`` or a name of ``OVERRIDES``;
a formula is a function of ``formulas``. ``sense=False`` tests the opposite: that a law is not obeyed.
"""

from __future__ import annotations

import cmath
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np

from topcli.analysis.order import observed_order
from topcli.analysis.reference import reference_states
from topcli.analysis.swings import first_swing_spacing, minima_times, spacing_law
from topcli.analysis.trajectory import Trajectory
from topcli.arithmetic.elimination import row_reduced
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome, Top
from topcli.engine.drive import orbit
from topcli.engine.machine import Machine
from topcli.engine.numbers import PreciseRun
from topcli.errors import RunError, counted
from topcli.paper.formulas import euler_poisson, kowalevski
from topcli.paper.numbers import Array60, Draws, arguments, derivative, digits60, exact, largest
from topcli.runs.plans import plans, trajectory_of
from topcli.runs.simulate import simulate
from topcli.schemes.kowalevski.bohlin import direct
from topcli.table import two_digits

PrintedFormula = Callable[..., Any]

TOLERANCE = 0.1
"""Deviation of an observed order from a whole number that the next term of the expansion in h explains."""
SIDES: Mapping[str, Callable[[float, float], bool]] = {
    "≤": operator.le,
    "≥": operator.ge,
    ">": operator.gt,
    "=": operator.eq,
    "≈": lambda figure, limit: abs(figure - limit) <= TOLERANCE,
}


@dataclass(frozen=True)
class Measured:
    """Figure of a check, and the figures that a true statement may have.

    Attributes
    ----------
    figure : float
        The figure.
    side : str
        Position of the figure of a true statement relative to the limit, a key of ``SIDES``.
    limit : float
        The limit.
    reason : str
        Theory that the limit comes from.
    note : str
        What the figure does not say, in a few words.
    unit : str
        Unit of the figure.
    corrected : float, optional
        Figure of a corrected reading of the statement.
    approximate : bool
        True if the statement is itself approximate ("very small").
    """

    figure: float
    side: str
    limit: float
    reason: str
    note: str = ""
    unit: str = ""
    corrected: float | None = None
    approximate: bool = False

    @property
    def verdict(self) -> str:
        """Verdict on the statement, which follows from the figure and the limit alone; nan never holds."""
        if SIDES[self.side](self.figure, self.limit):
            return "holds within" if self.approximate else "holds"
        fixed = self.corrected is not None and SIDES[self.side](self.corrected, self.limit)
        return "misprint" if fixed else "does not hold as stated"

    @property
    def bound(self) -> str:
        """Side and limit with the unit, such as ``≤ 1e-45`` or ``1.9 to 2.1``."""
        if self.side == "≈":
            return f"{self.limit - TOLERANCE:g} to {self.limit + TOLERANCE:g}"
        return f"{self.side} {two_digits(self.limit)} {self.unit}".rstrip()


# scenes, in doubles and in their precision

FIFTY = 50
OVERRIDES = {
    "rational": ("precision=rational", "h=1/10"),
    "fifty": (f"precision={FIFTY}", "h=1/10"),
    "generic": ("initial.omega=[0.7,-0.4,1.3]", "initial.gamma=[0.6,0.48,0.64]"),
}
"""Overrides by name: a run without rounding, whose initial state must be rational; a run with 50 digits; a state in
general position, whose decimals are rational numbers."""
TIED = {"lagrange": "B", "kowalevski": "A"}
"""Parameter of a form of a top that its equations in the paper do not leave open."""
VARIED = 3
"""Variants of a scene, with random parameters, state and h, on which a general law is tried beside the scene itself."""
RANDOM = (16, 10, 11, 13)
"""Largest numerator, and denominators, of random parameters and components of a state."""


def settings(scene: str) -> tuple[str, list[str]]:
    """Config of a scene and its overrides.

    >>> settings("euler_hk rational N=20")
    ('euler_hk', ['precision=rational', 'h=1/10', 'N=20'])
    """
    config, *words = scene.split()
    return config, [text for word in words for text in OVERRIDES.get(word, (word,))]


@cache
def experiment_of(scene: str) -> Experiment:
    """Experiment of a scene."""
    return load_experiment(*settings(scene), any_precision=True)


@cache
def run_of(scene: str) -> Trajectory:
    """Run of a scene in its precision, which several claims look at. Raises RunError if a step fails."""
    run = trajectory_of(experiment_of(scene))
    if run.ending.outcome is not Outcome.COMPLETED:
        raise RunError(f"{scene}: {run.ending.message}")
    return run


def variants(scene: str, general: bool = True) -> list[str]:
    """The scene, and for a ``general`` law with random rational parameters of the top, initial states and h."""
    experiment, draws, scenes = experiment_of(scene), Draws(1), [scene]
    top = experiment.top
    for _ in range(VARIED if general else 0):
        h = Fraction(draws.choice((-1, 1)), draws.randint(7, 20))
        words = [scene, f"h={h}", f"N={min(experiment.N, 3)}"]
        for name in type(top).model_fields:
            if name != TIED.get(top.form):
                value = 1 + Fraction(draws.randint(0, 9), 10) if name in "ABC" else draws.fraction(*RANDOM)
                words.append(f"top.{name}={value}")
        for name in top.vectors:
            vector = draws.unit() if name in top.unit_vectors else [draws.fraction(*RANDOM) for _ in range(3)]
            words.append(f"initial.{name}=[{','.join(map(str, vector))}]")
        scenes.append(" ".join(words))
    return scenes


@cache
def step_of(scene: str) -> tuple[Machine, PreciseRun]:
    """Machine of a scene's step, and its top, step and numbers in a precision other than double."""
    plan = next(plans(experiment_of(scene)))
    assert plan.machine is not None
    assert plan.precise is not None
    return plan.machine, plan.precise


def law(scene: str, figure: float, steps: int, sense: bool = True, **words: Any) -> Measured:
    """Figure that rounding alone makes in a number of steps if a law is obeyed exactly."""
    eps = step_of(scene)[1].arithmetic.eps
    # a thousand rounding errors in a step are an upper bound for all schemes of the paper
    limit, reason = 1e3 * eps * steps, f"rounding with {FIFTY} digits" if eps else "rational numbers: no rounding"
    return Measured(figure, "≤" if sense else ">", limit, reason, **words)


def exactly(precise: PreciseRun, values: Any) -> Any:
    """Exact values of numbers: fractions, or with rounding numbers with 60 digits."""
    fractions = np.frompyfunc(precise.arithmetic.fraction, 1, 1)(values)
    return digits60(fractions) if precise.arithmetic.eps else fractions


def parameters_of(precise: PreciseRun) -> dict[str, Any]:
    """Parameters of the top, and the vectors of formulas that they make up."""
    at = {name: exactly(precise, getattr(precise.top, name)) for name in type(precise.top).model_fields}
    vectors = {"moments": ("A", "B", "C"), "g": ("x0", "y0", "z0")}
    return at | {name: exact(*(at[part] for part in parts)) for name, parts in vectors.items() if set(parts) <= set(at)}


def deviation_of(run: Trajectory, name: str) -> float:
    """Largest deviation of an invariant from its first value, relative to the size of its terms."""
    values, plan = run.rows.numbers(name), run.rows.plan
    scale = run.rows.scale([invariant.name for invariant in plan.invariants].index(name))
    return largest(values - values[0]) / float(scale.max())


def return_defect(scene: str, h: Fraction, y: Any) -> float:
    """Largest component of the error after a step of h and one of -h from the state ``y``."""
    machine, precise = step_of(scene)
    there = orbit(precise.top, machine, y, precise.arithmetic.number(h), 1).states[1]
    back = orbit(precise.top, machine, there, precise.arithmetic.number(-h), 1).states[1]
    return largest(back - y)


# formulas at random points

POINTS = 20
"""Points at which an identity is tried.

The formulas are rational, of a degree below 20 in each variable, which takes some hundred values: a wrong identity
passes all points with a probability below 1e-14.
"""
ROUNDING, DIGITS60 = 1e-30, "rounding with 60 digits, or 40 in a derivative"


def _rates(point: Mapping[str, Any]) -> dict[str, Array60]:
    """Rates of omega and gamma at a point by the equations of its top."""
    if "c0" in point:
        return dict(zip("wc", kowalevski(point["c0"], point["w"], point["c"]), strict=True))
    moments, g = next(value for name, value in point.items() if name.endswith("top"))
    m_rate, c_rate = euler_poisson(moments, g, point["w"], point["c"])
    return {"w": m_rate / moments, "c": c_rate}


def identity(difference: PrintedFormula, law: int | None = None, misprint: bool = False) -> Measured:
    """Largest difference between two sides, or rate of change of an integral, at 20 random points.

    With ``law``, the rate along the motion of that one of some integrals. For a misprint, the formula as printed gives
    the figure, and the corrected one is measured too.
    """

    def figure(**reading: bool) -> float:
        draws, formula = Draws(1), partial(difference, **reading)
        points = [draws.point(difference) for _ in range(POINTS)]
        if law is None:
            return max(largest(formula(**point)) for point in points)
        return max(largest(derivative(formula, point, **_rates(point))[law]) for point in points)

    measured = Measured(figure(), "≤", ROUNDING, DIGITS60)
    return replace(measured, figure=figure(as_printed=True), corrected=measured.figure) if misprint else measured


def linear(equation: PrintedFormula, width: int = 3, sense: bool = True) -> Measured:
    """Largest second difference of an equation in its unknown, which is 0 if it is linear.

    The unknown has ``width`` numbers.
    """
    figure = 0.0
    for seed in range(POINTS):
        draws = Draws(100 + seed)
        x, u, v = (draws.vector(width) for _ in range(3))
        values = [exact(*equation(**Draws(seed).point(equation, new=new))) for new in (x + u + v, x + u, x + v, x)]
        figure = max(figure, largest(values[0] - values[1] - values[2] + values[3]))
    return Measured(figure, "≤" if sense else ">", ROUNDING, DIGITS60)


def independent(integrals: PrintedFormula, count: int, sense: bool = True) -> Measured:
    """Largest rank of the gradients of the quantities at random states."""
    draws, figure = Draws(1), 0
    for _ in range(5):
        point = draws.point(integrals)
        axes = [{"w": axis[:3], "c": axis[3:]} for axis in np.eye(6, dtype=int)]
        gradients = np.array([derivative(integrals, point, **axis) for axis in axes], dtype=float)
        sizes = np.linalg.norm(gradients, axis=0)
        figure = max(figure, int(np.linalg.matrix_rank(gradients / np.where(sizes > ROUNDING, sizes, 1.0), tol=1e-9)))
    limit, side = (count, "=") if sense else (count - 1, "≤")
    return Measured(figure, side, limit, f"{count} independent functions have this rank")


# maps in their precision


def elliptic(scene: str, component: int) -> Measured:
    """Largest rank of the 6 symmetric biquadratic monomials of successive values u, u' along some orbits.

    A translation on an elliptic curve, and a function of order 2 on it, obey one symmetric biquadratic relation
    between u and u' (Euler's addition theorem), so that the 6 monomials have rank 5.
    """
    figure = 0
    for variant in variants(scene):
        values = run_of(f"{variant} N=9").rows.states[:, component]
        rows = [(u * u * v * v, u * v * (u + v), u * u + v * v, u * v, u + v, 1) for u, v in pairwise(values)]
        figure = max(figure, len(row_reduced(rows)[1]))
    return Measured(figure, "≤", 5, "an elliptic function gives one relation between the 6 monomials")


def conserved(scene: str, invariants: Sequence[str], sense: bool = True) -> Measured:
    """Largest relative deviation of a quantity.

    The smallest for some invariants; the largest for several variants.
    """
    runs = [run_of(variant) for variant in variants(scene, sense)]
    figure = max(min(deviation_of(run, name) for name in invariants) for run in runs)
    return law(scene, figure, experiment_of(scene).N, sense)


def formula_conserved(scene: str, quantity: PrintedFormula, corrected: PrintedFormula) -> Measured:
    """Largest deviation of a formula along a run."""
    precise = step_of(scene)[1]
    states, c0 = exactly(precise, run_of(scene).rows.states), parameters_of(precise)["c0"]

    def deviation(formula: PrintedFormula) -> float:
        values = exact(*(formula(c0, y[:3], y[3:]) for y in states))
        return largest(values - values[0])

    return law(scene, deviation(quantity), experiment_of(scene).N, corrected=deviation(corrected))


def reversible(scene: str, paper: str = "", sense: bool = True) -> Measured:
    """Largest component of the change of a state by a step of h = 0.1 followed by a step of h = -0.1.

    The note adds the order in h, and the largest change at states along the scene ``paper`` with its h.
    """
    h, y0, notes = Fraction(1, 10), step_of(scene)[1].y0, []
    figures = [return_defect(variant, h, step_of(variant)[1].y0) for variant in variants(scene, sense)]
    measured = law(scene, max(figures), 2, sense)
    if figures[0] > measured.limit:
        notes.append(f"scales as h^{math.log2(figures[0] / return_defect(scene, h / 2, y0)):.2f}")
    if paper:
        run, number = run_of(paper), step_of(scene)[1].arithmetic.number
        states = [exact(*(number(Fraction(x)) for x in y.tolist())) for y in run.states[:: len(run) // 100]]
        defect = max(return_defect(scene, Fraction(str(run.h)), y) for y in states)
        notes.append(f"{defect:.1e} along the paper's run at h = {run.h:g}")
    return replace(measured, note="; ".join(notes))


def same_map(scene: str, other: str, top: Mapping[str, Any]) -> Measured:
    """Largest difference between two maps over three steps.

    The second is the scene ``other`` of a ``top`` whose parameters are numbers, or names of parameters of the first.
    """
    figure = 0.0
    for variant in variants(scene):
        states, precise = run_of(f"{variant} N=3").rows.states, step_of(variant)[1]
        at = parameters_of(precise)
        machine, second = step_of(" ".join([other, *(f"top.{name}={at.get(x, x)}" for name, x in top.items())]))
        figure = max(figure, largest(states - orbit(second.top, machine, states[0], precise.h, 3).states))
    return law(scene, figure, 3)


def solves(scene: str, equation: PrintedFormula, reverse: bool = False) -> Measured:
    """Largest residual of an equation between the old and the new state over three steps of a scheme.

    For ``reverse``, also with the two states exchanged and with -h.
    """
    figure = 0.0
    for variant in variants(scene):
        precise = step_of(variant)[1]
        h, states = exactly(precise, precise.h), exactly(precise, run_of(f"{variant} N=3").rows.states)
        forward = [(h, old, new) for old, new in pairwise(states)]
        for h, old, new in (*forward, *((-h, new, old) for h, old, new in forward if reverse)):
            at = parameters_of(precise) | {"h": h, "old": old, "w": old, "new": new}
            figure = max(figure, largest(equation(**{name: at[name] for name in arguments(equation)})))
    return law(scene, figure, 3)


# runs in doubles

LADDER = (0.02, 0.01, 0.005)
ORDER_TIME = 10.0


def _order(what: str, errors: Sequence[Any], side: str, limit: float, shift: int = 0) -> Measured:
    """Observed order in h of the largest of some errors, less ``shift``; nan if rounding hides it."""
    sizes = [float(np.abs(error).max()) for error in errors]
    exponent = observed_order(LADDER, sizes, 1e-12)
    note, reason = f"{what} {sizes[-1]:.1e} at h = {LADDER[-1]:g}", "a quantity of order p scales as h^p"
    return Measured(math.nan if exponent is None else exponent - shift, side, limit, reason, note)


def _ladder(scene: str) -> list[Trajectory]:
    """Runs over a fixed time at the steps of ``LADDER``."""
    return [run_of(f"{scene} h={h:g} N={round(ORDER_TIME / h)}") for h in LADDER]


def deviation_order(scene: str, invariant: str, order: int) -> Measured:
    """Exponent of h in the largest deviation of a quantity up to t = 10, from h = 0.02, 0.01, 0.005."""
    return _order("deviation", [run[invariant] - run[invariant][0] for run in _ladder(scene)], "≈", order)


def convergence_order(scene: str, order: int) -> Measured:
    """Exponent of h in the error at t = 10, from h = 0.02, 0.01, 0.005."""
    runs = _ladder(scene)
    end = reference_states(runs[0].top, runs[0].states[0].tolist(), np.array([0.0, ORDER_TIME]))[-1]
    return _order("error", [run.states[-1] - end for run in runs], "≥", order - TOLERANCE)


def equation_order(scene: str, equation: PrintedFormula, order: int) -> Measured:
    """Exponent of h in the residual of an equation along the exact motion, minus one, from h = 0.02, 0.01, 0.005."""
    experiment, residuals = experiment_of(scene), []
    for h in LADDER:
        times = h * np.arange(round(ORDER_TIME / h) + 1)
        states = reference_states(experiment.top, experiment.y0, times).T
        residuals.append(equation(experiment.top.constants()[0], h, states[:, :-1], states[:, 1:]))
    return _order("residual", residuals, "≈", order, shift=1)


def extremes(scene: str, column: str, low: float, high: float, last_digit: float) -> Measured:
    """Largest difference between the extremes of a quantity and the two numbers in the paper."""
    values = run_of(scene)[column]
    figure = max(abs(float(values.min()) - low), abs(float(values.max()) - high))
    note = f"{values.min():.9f} to {values.max():.9f}"
    return Measured(figure, "≤", 0.5 * last_digit, "half a unit of the last printed digit", note, approximate=True)


def small(scene: str, invariants: Sequence[str]) -> Measured:
    """Largest deviation of an integral of the exact motion, relative to the size of its terms."""
    run = run_of(scene)
    limit = (run.h * jacobian_norm(run.top, run.states)) ** 2
    reason = "a scheme of order 2 deviates by about (h|J|)², where J is the Jacobian of the field"
    return Measured(max(deviation_of(run, name) for name in invariants), "≤", limit, reason, approximate=True)


def jacobian_norm(top: Top, states: Array) -> float:
    """Largest spectral norm of the Jacobian of the field along ``states`` (m, d); differences, exact for quadratics."""
    p, shifts, norms = top.constants(), 0.5 * np.eye(len(top.components)), []
    for y in states[:: max(1, len(states) // 200)]:
        columns = [np.subtract(top.field(tuple(y + shift), p), top.field(tuple(y - shift), p)) for shift in shifts]
        norms.append(float(np.linalg.norm(np.array(columns), 2)))
    return max(norms)


def quality(scenes: Sequence[str], invariants: Sequence[str]) -> Measured:
    """Largest ratio of the deviations of a quantity under several schemes."""
    ratios, notes, runs = [], [], [run_of(scene) for scene in scenes]
    symbols = {invariant.name: invariant.symbol for invariant in runs[0].top.invariants()}
    for name in invariants:
        deviations = {run.scheme: float(np.abs(run[name] - run[name][0]).max()) for run in runs}
        ratios.append(max(deviations.values()) / min(deviations.values()))
        listed = ", ".join(f"{scheme} {value:.2g}" for scheme, value in deviations.items())
        notes.append(f"{symbols[name]}: {listed}")
    reason = "schemes of the same order whose error constants differ by less than a factor of 2"
    return Measured(max(ratios), "≤", 2, reason, "; ".join(notes))


def levels_between_swings(run: Trajectory, column: str) -> tuple[Array, float, str]:
    """Values of a column at the start, halfway between swings and at the end, its range over the run, and a note.

    A swing is a deep minimum of gamma_1 with time before it: one in the first tenth of the run belongs to the start.
    """
    swings = minima_times(run.t, run["gamma1"])
    swings = swings[swings > run.t[-1] / 10]
    at = np.concatenate([[0.0], 0.5 * (swings[1:] + swings[:-1]), [run.t[-1]]])
    levels, size = np.interp(at, run.t, run[column]), float(np.ptp(run[column]))
    listed = ", ".join(f"{value:.10g}" for value in np.round(levels, 9))
    return levels, size, f"{run.scheme}: range {size:.1e}, levels between swings {listed}"


def oscillates(scenes: Sequence[str], column: str) -> Measured:
    """Largest deviation of a level between swings from the first level, divided by the range of the quantity."""
    runs = [levels_between_swings(run_of(scene), column) for scene in scenes]
    figure = max(float(np.abs(levels - levels[0]).max()) / size for levels, size, _ in runs)
    reason = "an oscillating quantity returns: between swings it differs from its first value by a tenth of its range"
    return Measured(figure, "≤", 0.1, reason, "; ".join(note for *_, note in runs))


def rises(scene: str, column: str) -> Measured:
    """Smallest rise from one level between swings to the next, divided by the mean rise."""
    levels, size, note = levels_between_swings(run_of(scene), column)
    figure = float(np.diff(levels).min()) * (len(levels) - 1) / size
    return Measured(figure, "≥", 0.5, "equal rises at all swings give 1, an oscillation gives 0", note)


# pictures

WIDTH, HEIGHT = 45.0, 33.75
"""Size of a panel of the paper in millimetres: 4.5 cm wide, in the usual proportion of 4 to 3."""
LINE = 0.5 * 25.4 / 72.0
"""Width in millimetres of a line of 0.5 points, the thinnest usual one."""
SPACING = 0.1 * LINE
"""Distance between neighbouring points of a curve, which a distance between curves may be off by."""
LINE_REASON = "the width of a line of 0.5 pt in a panel of 45 mm by 34 mm"


def curve_distance(a: Array, b: Array) -> float:
    """Largest distance of a point of one curve (m, 2) from the nearest point of the other, both ways."""
    from scipy.spatial import KDTree

    return max(float(KDTree(a).query(b)[0].max()), float(KDTree(b).query(a)[0].max()))


def resampled(x: Array, y: Array) -> Array:
    """Points (m, 2) on a curve, ``SPACING`` apart along it."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    at = np.arange(0.0, along[-1], SPACING)
    return np.column_stack([np.interp(at, along, x), np.interp(at, along, y)])


def same_picture(scene: str, others: Sequence[str], sense: bool = True) -> Measured:
    """Largest distance between the printed curves of gamma and omega of one scene and of others."""
    figure = 0.0
    for other in others:
        runs = run_of(scene), run_of(other)
        span = max(float(run.t[-1]) for run in runs)
        for panel in ("gamma", "omega"):
            columns = [f"{panel}{axis}" for axis in (1, 2, 3)]
            size = np.ptp(np.concatenate([run[name] for run in runs for name in columns]))
            for name in columns:
                curves = (resampled(run.t / span * WIDTH, run[name] / size * HEIGHT) for run in runs)
                figure = max(figure, curve_distance(*curves))
    return Measured(figure, "≤" if sense else "≥", LINE, LINE_REASON, unit="mm", approximate=sense)


def straight_line(scene: str, column: str, axis: float) -> Measured:
    """Height of the printed curve on an axis of length ``axis``."""
    values = run_of(scene)[column]
    figure, note = float(np.ptp(values)) / axis * HEIGHT, f"{values.min():.6g} to {values.max():.6g}"
    return Measured(figure, "≤", LINE, LINE_REASON, note, "mm", approximate=True)


def other_period(scenes: Sequence[str]) -> Measured:
    """Smallest relative deviation of the time between two swings from that of the exact motion."""
    runs = [run_of(scene) for scene in scenes]
    law = float(spacing_law(runs[0]["gamma3"][:1])[0])
    spacings = {run.scheme: first_swing_spacing(minima_times(run.t, run["gamma1"])) or math.nan for run in runs}
    figure = min(abs(spacing / law - 1.0) for spacing in spacings.values())
    listed = ", ".join(f"{name} {spacing:.4f}" for name, spacing in spacings.items())
    note = f"time between swings: {listed}; exact motion {law:.4f}"
    reason = "the width of a line on the paper's axis from 0 to 50"
    return Measured(figure, "≥", LINE / WIDTH * float(runs[0].t[-1]) / law, reason, note)


# signs of chaos

NEAR = 1e-9


def neighbours_part(scene: str, pairs: int = 0) -> Measured:
    """Decades by which the distance of two motions, 1e-9 at the start, grows until the end of the run.

    Or the most over ``pairs`` of random orbits of a map of the Kowalevski top that both complete.
    """
    experiment = experiment_of(scene)
    draws, starts = np.random.default_rng(1), [np.array(experiment.y0)]
    if pairs:
        drawn = [(draws.normal(scale=1.5, size=3), draws.normal(size=3)) for _ in range(pairs)]
        starts = [np.concatenate([omega, gamma / np.linalg.norm(gamma)]) for omega, gamma in drawn]
    shift = NEAR * (np.arange(len(starts[0])) == 0)
    ends = simulate(*settings(scene), states=[state for y in starts for state in (y, y + shift)]).states[:, -1]
    decades = np.log10(np.abs(ends[::2] - ends[1::2]).max(axis=1) / NEAR)
    decades = decades[np.isfinite(decades)]  # of the pairs that both completed
    # a map is judged by its number of steps, a motion by its time
    least = math.log10(experiment.N if pairs else experiment.duration) + 2.0
    reason = "integrable motions part in proportion to time; 100 times that is allowed"
    note = f"more than the bound for {(decades > least).sum()} of {len(decades)} pairs of orbits"
    return Measured(float(decades.max()), "≥", least, reason, note if pairs else "", "decades")


# square roots


def root_angles(fraction: float, halves: int, right: int) -> Measured:
    """Largest distance of a root w of w² = z from the nearest value of the formula, relative to |w|.

    The value is sqrt(R) e^{i phi} for z = R e^{i Phi} with Phi from atan2, and phi = ``fraction`` Phi modulo
    ``halves`` pi; ``right`` is the right number of times pi.
    """

    def farthest(halves: int) -> float:
        draws, distance = Draws(1), 0.0
        for _ in range(50):
            root = complex(float(draws.number()), float(draws.number()))
            z = root * root
            angle, size = fraction * math.atan2(z.imag, z.real), math.sqrt(abs(z))
            listed = [cmath.rect(size, angle + k * halves * math.pi) for k in range(-3, 4)]
            distance = max(distance, *(min(abs(sign * root - w) for w in listed) / size for sign in (1, -1)))
        return distance

    reason = "rounding of a square, a root and an angle in doubles"
    return Measured(farthest(halves), "≤", 1e-14, reason, corrected=farthest(right))


def right_root(orbits: Mapping[str, Any]) -> Measured:
    """Number of orbits on which a step takes the root that is farther from the ω that Euler's rule predicts."""
    run = simulate("kowalevski_bohlin_a", **orbits)
    old, new = np.moveaxis(run.states[:, :-1], -1, 0), np.moveaxis(run.states[:, 1:], -1, 0)
    x, y = direct(tuple(old), run.h, run.top.constants())
    # the other root, minus this one, is nearer to the prediction where their scalar product is negative
    wrong = (new[0] * x + new[1] * y < 0.0).any(axis=1)
    reason = "the right root is the one nearer to the predicted ω"
    return Measured(int(wrong.sum()), "≤", 0, reason, unit=f"of {counted(len(wrong), 'orbit')}")
