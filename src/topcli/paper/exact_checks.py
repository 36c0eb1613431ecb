"""Checks of claims in rational numbers or with 50 digits: identities, symmetries, equal maps, roots.

A check takes the parameters that the ledger gives and returns what it measures. It knows neither the statement nor its
recorded verdict.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from topcli.arithmetic.elimination import row_reduced
from topcli.engine.numbers import longest
from topcli.errors import counted
from topcli.paper import identities, printed
from topcli.paper.algebra import Draws, arguments, dual, exact, largest, rates
from topcli.paper.claim import Measurement
from topcli.paper.scenes import DIGITS, OVERRIDES, ExactMap, LedgerScene, exact_map, exact_maps
from topcli.runs.simulate import simulate
from topcli.schemes.kowalevski.bohlin import direct

POINTS = 20
"""Points at which an identity is tried.

The formulas are rational, of a degree below 20 in each variable, which takes some hundred values: a wrong identity
passes all points with a probability below 1e-14.
"""
RANK_POINTS = 5
ROUNDINGS = 1000.0
"""Rounding errors of a step that an exact law may show: an upper bound for all schemes of the ledger."""


def _formula(name: Any) -> Any:
    """Function of ``identities`` or ``printed`` with this name; anything else as it is."""
    if not isinstance(name, str):
        return name
    for module in (identities, printed):
        if callable(function := getattr(module, name, None)):
            return function
    raise ValueError(f"neither identities.py nor printed.py has a function {name!r}")


Formula = Annotated[Callable[..., Any], BeforeValidator(_formula)]
"""Function of ``identities`` or ``printed``; the ledger gives its name."""


def _moving(function: Callable[..., Any], draws: Draws) -> dict[str, Any]:
    """Arguments of a function of the state, with omega and gamma that move by the equations of the drawn top."""
    point = draws.point(function)
    w, c = point["w"], point["c"]
    if "c0" in point:
        w_rate, c_rate = printed.kowalevski(point["c0"], w, c)
    else:
        moments, g = next(value for name, value in point.items() if name.endswith("top"))
        m_rate, c_rate = printed.euler_poisson(moments, g, w, c)
        w_rate = m_rate / moments
    return point | {"w": dual(w, w_rate), "c": dual(c, c_rate)}


def identity(difference: Formula, law: int | None = None, misprint: bool = False) -> Measurement:
    """Largest magnitude of a difference; with ``law``, of the rate of change of that one of some integrals.

    For a misprint, the formula as printed gives the figure, and the corrected one is measured too.
    """

    def figure(**reading: bool) -> float:
        draws = Draws(1)
        if law is None:
            return max(largest(difference(**draws.point(difference), **reading)) for _ in range(POINTS))
        moving = (difference(**_moving(difference, draws), **reading) for _ in range(POINTS))
        return max(largest(rates(values)[law]) for values in moving)

    return Measurement(figure(as_printed=True), corrected=figure()) if misprint else Measurement(figure())


def linear(equation: Formula, width: int = 3) -> Measurement:
    """Largest second difference of an equation in its unknown of ``width`` numbers, which is 0 if it is linear."""
    figure = 0.0
    for seed in range(POINTS):
        draws = Draws(100 + seed)
        x, u, v = (draws.numbers(width) for _ in range(3))
        whole, first, second, base = (
            exact(*equation(**Draws(seed).point(equation, new=new))) for new in (x + u + v, x + u, x + v, x)
        )
        figure = max(figure, largest(whole - first - second + base))
    return Measurement(figure)


def independence(integrals: Formula, count: int) -> Measurement:
    """Largest rank of the gradients of ``count`` functions of omega and gamma at random states."""
    draws, figure = Draws(1), 0
    for _ in range(RANK_POINTS):
        point = draws.point(integrals)
        columns = []
        for seed in np.eye(6, dtype=int):
            state = {"w": dual(point["w"], seed[:3]), "c": dual(point["c"], seed[3:])}
            columns.append(rates(integrals(**point | state)))
        figure = max(figure, len(row_reduced(columns)[1]))
    return Measurement(float(figure), limit=float(count))


ELLIPTIC_STEPS = 9


def elliptic(scene: LedgerScene, component: int) -> Measurement:
    """Largest rank of the symmetric biquadratic monomials of successive values u, v of a component, along some orbits.

    A translation on an elliptic curve, and a function of order 2 on it, obey one symmetric biquadratic relation
    between u and v (Euler's addition theorem), so that the 6 monomials have rank 5.
    """
    figure = 0
    for scheme in exact_maps(scene):
        states = scheme.fractions(scheme.orbit(scheme.y0, scheme.run.h, ELLIPTIC_STEPS))
        rows = [
            (u * u * v * v, u * v * (u + v), u * u + v * v, u * v, u + v, 1) for u, v in pairwise(states[:, component])
        ]
        figure = max(figure, len(row_reduced(rows)[1]))
    return Measurement(float(figure))


def _rounding(scheme: ExactMap, steps: int) -> dict[str, Any]:
    """Limit, and its reason, on what rounding does to an exact law in a number of steps."""
    reason = f"rounding with {DIGITS} digits" if scheme.eps else "rational numbers: no rounding"
    return {"limit": scheme.eps * ROUNDINGS * steps, "reason": reason}


def conservation(scene: LedgerScene, invariants: list[str], varied: bool = True) -> Measurement:
    """Smallest among the largest relative deviations of some invariants; of several variants, the largest of all."""
    maps = exact_maps(scene, varied)
    figures = []
    for scheme in maps:
        states = scheme.orbit(scheme.y0, scheme.run.h, scheme.experiment.N)
        figures.append(min(float(scheme.deviations(name, states, scheme.run.h).max()) for name in invariants))
    return Measurement(max(figures), **_rounding(maps[0], maps[0].experiment.N))


def _return_defect(scheme: ExactMap, h: Fraction, start: Any) -> float:
    """Largest component of the error after a step of h and one of -h."""
    there = scheme.step(start, scheme.number(h))
    back = scheme.step(there, scheme.number(-h))
    with scheme.run.arithmetic.active():
        return max(float(abs(value)) for value in back - start)


STEP = Fraction(1, 10)
ALONG = 100
"""States along a run of the paper at which the defect of reversal is measured too."""


def reversal(scene: LedgerScene, paper: LedgerScene | None = None, varied: bool = True) -> Measurement:
    """Largest error after a step of 0.1 and one of -0.1, from the initial states of a scene and its variants.

    The note adds the order in h, and the largest error at states along the scene ``paper``, in doubles, with its h.
    """
    maps = exact_maps(scene, varied)
    figures = [_return_defect(scheme, STEP, scheme.y0) for scheme in maps]
    rounding, notes = _rounding(maps[0], 2), []
    if figures[0] > rounding["limit"]:
        order = math.log2(figures[0] / _return_defect(maps[0], STEP / 2, maps[0].y0))
        notes.append(f"scales as h^{order:.2f}")
    if paper is not None:
        run, scheme = paper.trajectory(), exact_map(paper.with_sets(*OVERRIDES["fifty"]))
        states = [scheme.numbers(y.tolist()) for y in run.states[:: len(run) // ALONG]]
        defect = max(_return_defect(scheme, Fraction(str(run.h)), y) for y in states)
        notes.append(f"{defect:.1e} along the paper's run at h = {run.h:g}")
    return Measurement(max(figures), note="; ".join(notes), **rounding)


EQUAL_STEPS = 3
VECTORS = {"moments": ("A", "B", "C"), "g": ("x0", "y0", "z0")}
"""Parameters of a top that an equation takes together."""


def equal_maps(
    scene: LedgerScene,
    equation: Formula | None = None,
    other: LedgerScene | None = None,
    parameters: dict[str, Any] | None = None,
) -> Measurement:
    """Largest difference between a scheme, with its variants, and another map, in rational numbers.

    The other map is an ``equation`` between the old and the new state, or the scene ``other`` of a top whose
    ``parameters`` are numbers, or names of parameters of the first top.
    """
    figure = 0.0
    for scheme in exact_maps(scene):
        h = scheme.fractions(scheme.run.h)
        states = scheme.fractions(scheme.orbit(scheme.y0, scheme.run.h, EQUAL_STEPS))
        if equation:
            needed = arguments(equation)
            known = {name: exact(*map(scheme.parameter, VECTORS[name])) for name in needed if name in VECTORS}
            for old, new in pairwise(states):
                known |= {"h": h, "w": old, "old": old, "new": new}
                figure = max(figure, largest(equation(**{name: known[name] for name in needed})))
        if other:
            values = {name: scheme.parameter(x) if isinstance(x, str) else x for name, x in (parameters or {}).items()}
            second = exact_map(other.with_sets(*(f"top.{name}={value}" for name, value in values.items())))
            orbit = second.orbit(second.numbers(states[0]), second.number(h), EQUAL_STEPS)
            figure = max(figure, largest(states - second.fractions(orbit)))
    return Measurement(figure)


def formula(scene: LedgerScene, quantity: Formula, corrected: Formula | None = None) -> Measurement:
    """Largest deviation of a printed formula along a run, and that of a corrected reading."""
    scheme = exact_map(scene)
    states = scheme.orbit(scheme.y0, scheme.run.h, scheme.experiment.N)

    def deviation(reading: Callable[..., Any]) -> float:
        with scheme.run.arithmetic.active():
            values = [reading(scheme.run.top.constants()[0], y[:3], y[3:]) for y in states]
            return max(float(abs(value - values[0])) for value in values)

    return Measurement(
        deviation(quantity),
        corrected=deviation(corrected) if corrected else None,
        **_rounding(scheme, scheme.experiment.N),
    )


def exchange(scene: LedgerScene, equation: Formula) -> Measurement:
    """Largest residual of an equation after steps of a scheme and its variants, also exchanged and with h reversed."""
    maps, figure = exact_maps(scene), 0.0
    for scheme in maps:
        h, old = scheme.run.h, scheme.y0
        new = scheme.step(old, h)
        with scheme.run.arithmetic.active():
            for at in ((h, old, new), (-h, new, old)):
                residual = equation(scheme.run.top.constants()[0], *at, scheme.run.arithmetic.math)
                figure = max(figure, largest(residual))
    return Measurement(figure, **_rounding(maps[0], 1))


GROWTH_STEPS = 5


def digits(scene: LedgerScene) -> Measurement:
    """Growth of the length of rational numbers in the last step of an orbit."""
    scheme = exact_map(scene)
    before, last = (longest(state) for state in scheme.orbit(scheme.y0, scheme.run.h, GROWTH_STEPS)[-2:])
    least = 2.0 * (GROWTH_STEPS / (GROWTH_STEPS - 1)) ** 2
    return Measurement(last / before, limit=least, note=f"{last} bits after {GROWTH_STEPS} steps")


ROOT_POINTS = 50
PERIODS = 3
"""Multiples of a period of the angle, of either sign, that are tried."""


def _farthest(fraction: float, period: float) -> float:
    """Largest distance, relative to |w|, of a root w of w² = z from the nearest sqrt(R) e^{i phi}.

    z = R e^{i Phi} with Phi from atan2, and phi = ``fraction`` Phi modulo ``period``.
    """
    draws, distance = Draws(1), 0.0
    for _ in range(ROOT_POINTS):
        root = complex(float(draws.number()), float(draws.number()))
        z = root * root
        angle, size = fraction * math.atan2(z.imag, z.real), math.sqrt(abs(z))
        listed = [cmath.rect(size, angle + k * period) for k in range(-PERIODS, PERIODS + 1)]
        for wanted in (root, -root):
            distance = max(distance, min(abs(wanted - w) for w in listed) / size)
    return distance


def angles(fraction: float, halves: int, corrected: int | None = None) -> Measurement:
    """Distance of the farther root of w² = z from the angles ``fraction`` Phi modulo ``halves`` pi.

    ``corrected`` is the right number of times pi.
    """
    return Measurement(
        _farthest(fraction, halves * math.pi), corrected=corrected and _farthest(fraction, corrected * math.pi)
    )


def _wrong(orbits: Mapping[str, Any]) -> tuple[int, int]:
    """Number of orbits on which a step takes the root farther from its prediction, and number of orbits."""
    runs = simulate("kowalevski_bohlin_a", **orbits)
    wrong = 0
    for index in range(len(runs.endings)):
        run = runs[index]
        old, new = run.states[:-1].T, run.states[1:].T
        x, y = direct(tuple(old), run.h, run.top.constants())
        # the other root, minus this one, is nearer to the prediction where their scalar product is negative
        wrong += bool((new[0] * x + new[1] * y < 0.0).any())
    return wrong, len(runs.endings)


SIGN = {"name": "bohlin-a", "branch": "sign"}


def roots(orbits: dict[str, Any], crossing: int = 0, beside_axis: float | None = None) -> Measurement:
    """Number of orbits of Bohlin's method with a wrong root.

    If ``crossing`` is given, the orbits begin at as many states whose omega_1 + i omega_2 crosses the negative real
    axis, where the argument jumps. The note adds the number at states beside that axis, in one step of ``beside_axis``.
    """
    if crossing:
        states = [{"omega": [-0.8, 1e-3 * k, 0.5], "gamma": [0.6, -0.48, -0.64]} for k in range(crossing)]
        orbits = orbits | {"ensemble": {"states": states, "store": "trajectories"}}
    wrong, count = _wrong(orbits)
    note = ""
    if beside_axis is not None:
        near = "{} of {} states".format(*_wrong(next_to_axis(beside_axis)))
        note = f"and at {near} next to the negative real axis, in one step of h = {beside_axis:g}"
    return Measurement(float(wrong), note=note, unit=f"of {counted(count, 'orbit')}")


def next_to_axis(h: float, count: int = 200) -> dict[str, Any]:
    """Choice by sign at random states whose predicted omega is within h² of the negative real axis."""
    draws = np.random.default_rng(1)
    states = []
    for _ in range(count):
        omega1, omega3, gamma = -draws.uniform(0.3, 2.0), draws.uniform(-1.5, 1.5), draws.normal(size=3)
        gamma /= np.linalg.norm(gamma)
        omega2 = 0.5 * h * (omega3 * omega1 - gamma[2]) + h * h * draws.uniform(-1.0, 1.0)
        states.append({"omega": [omega1, omega2, omega3], "gamma": gamma.tolist()})
    return {"h": h, "N": 1, "scheme": SIGN, "ensemble": {"states": states, "store": "trajectories"}}
