"""Hard cases of ``topcli stress``, ``CASES``: cases that every top has, and cases of single tops."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Floats, Top
from topcli.errors import UnknownNameError, nearest, quoted
from topcli.field.polynomial import field_of
from topcli.schemes.plugins import origin_of
from topcli.studies.stress.checks import (
    Case,
    Check,
    does_not_drift,
    flips,
    keeps_order,
    returns,
    stays_bounded,
    swings_at,
)
from topcli.tops import CATALOGUE, TOPS, gentle_scene
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial


def state_before(top: Top, state: Floats, t: float) -> list[float]:
    """Return the state from which the motion of ``top`` reaches ``state`` after the time ``t``."""
    return _state_before(top, tuple(state), t)  # pyright: ignore[reportArgumentType] (frozen, hence hashable)


@cache
def _state_before(top: Top, state: Floats, t: float) -> list[float]:
    return reference_states(top, state, np.array([-t]))[0].tolist()


def initial(top: Top, state: Floats) -> dict[str, Any]:
    """Return the ``initial`` section of a config for ``state``, with its unit vectors normalized to the last bit."""
    normal = list(state)
    for name in top.unit_vectors:
        where = slice(*top.vectors[name])
        length = math.hypot(*state[where])
        normal[where] = [value / length for value in state[where]]
    return top.initial_section(normal)


def config(top: Top, state: Floats, h: float, N: int) -> dict[str, Any]:
    """Return a config without a scheme."""
    return {"top": top.section(), "initial": initial(top, state), "h": h, "N": N}


LARGEST_STEP = 60.0
OMEGA, GAMMA = (0.7, -0.4, 1.3), (0.6, 0.48, 0.64)
GENERIC = (*OMEGA, *GAMMA)
FAST = (3.0, -2.0, 6.0)
"""omega of a fast rotation, with a period of about 1."""


@cache
def singular_step(top: Top, state: Floats) -> float:
    """Return the least h > 0 at which HK's linear system, 1 - h/2 f', is singular at ``state``: 2 over an eigenvalue.

    Raises ValueError if there is none up to ``LARGEST_STEP``.
    """
    every = range(len(state))
    jacobian = [[float(rate.derivative(j).value(state)) for j in every] for rate in field_of(top)]
    steps = [2.0 / x.real for x in np.linalg.eigvals(jacobian) if x.imag == 0.0 and x.real > 2.0 / LARGEST_STEP]
    if not steps:
        raise ValueError(f"{top!r}: HK's linear system is not singular at {state} up to h = {LARGEST_STEP:g}")
    return min(steps)


def _case(
    name: str,
    question: str,
    top: Top,
    state: Floats | Callable[[], Floats],
    h: float | None = 0.02,
    N: int = 200,
    check: Check = keeps_order,
) -> Case:
    """Case from a ``state``, which a function may compute when it is asked for; h is None for the singular step."""

    def made() -> Mapping[str, Any]:
        start = state() if callable(state) else state
        step = singular_step(top, start) if h is None else h  # pyright: ignore[reportArgumentType] (hashable)
        return config(top, start, step, N)

    return Case(name, top.form, question, made, check)


def _scaled(state: Floats, factor: float) -> Floats:
    return tuple(value * factor if i < 3 else value for i, value in enumerate(state))


def general_cases(top: Top, regular: Floats = (), singular: bool = True) -> tuple[Case, ...]:
    """Return the cases for the schemes of ``top``'s form.

    ``regular`` is a state of a motion that is not chaotic, by default the generic one. ``singular`` is False if HK's
    determinant cannot vanish.
    """
    d = len(top.components)
    generic, fast = GENERIC[:d], (*FAST, *GAMMA)[:d]
    regular = regular or generic
    vector = next(iter(top.vectors))
    bounded = (
        "h = 1, about one turn per step: does the state stay bounded, and do the steps of implicit schemes converge?"
    )
    huge, tiny = _scaled(generic, 1e150), _scaled(generic, 1e-310)
    vanishes = (
        "h at which the determinant of HK's linear system vanishes in the first step: does the state stay "
        "about as large as in the exact motion?"
    )
    plain = _plain_cases(top, generic, regular)
    cases = (
        *plain[:2],
        _case("resonance", bounded, top, fast, 1.0, 2000, stays_bounded),
        _case("huge", f"{vector} of size 1e150, h of size 1e-152: does the scheme keep its order?", top, huge, 2e-152),
        _case("denormal", f"{vector} of size 1e-310, a denormal number: does the scheme keep its order?", top, tiny),
        *plain[2:],
        _case("singular-step", vanishes, top, generic, None, 50, stays_bounded),
    )
    return cases if singular else cases[:-1]


def _plain_cases(top: Top, generic: Floats, regular: Floats) -> tuple[Case, ...]:
    """The cases that make sense for any top."""
    back = "1e5 steps forward and 1e5 back: does the state return to the initial one, up to the growth of round-off?"
    slope = (
        "run up to t = 1e5: do the invariants that the scheme must conserve drift by more than the uncertainty of the "
        "fitted drift?"
    )
    return (
        _case("backwards", "h < 0: is the order the same as for h > 0?", top, generic, -0.02),
        _case(
            "one-step",
            "t = 0.1 in 1, 2 and 4 steps: does the error fall with the declared order?",
            top,
            generic,
            0.1,
            1,
        ),
        _case("there-and-back", back, top, regular, 0.02, 100_000, returns),
        _case("drift", slope, top, regular, 0.1, 1_000_000, does_not_drift),
    )


def swing_time(eps: float) -> float:
    """Time of the first swing of the Kowalevski top from gamma3 = eps near the relative equilibrium at omega1 = 2.

    sqrt 2 ln(8 sqrt 7/eps), to leading order in eps, for A = B = 2, C = 1, c0 = 1.
    """
    return math.sqrt(2.0) * math.log(8.0 * math.sqrt(7.0) / eps)


TOP = Kowalevski()
DELONE = (0.9, 0.3, 1.0, 0.72, 0.54, math.sqrt(1.0 - 0.72**2 - 0.54**2))
"""xi = 0 exactly."""
TORUS_E4 = (
    -0.3336095391673479,
    -0.8069759961673685,
    1.0071602889659599,
    -0.25098702032854125,
    0.7545542238714854,
    -0.6063443236844068,
)
"""S(e4) = 0: S(e4) >= 0 on all motions, and where it vanishes the torus has shrunk to a closed orbit and the gradients
of the four integrals are dependent. Found by Newton's method on the gradient of S(e4) with 40 digits."""
EVENT = 1.0
"""Time at which the motion passes the hard place."""


def separation(state: Floats) -> tuple[float, float, float]:
    """``(S(e4), S(e5), g2³ - 27 g3²)`` of Kowalevski's curve for A = B = 2, C = c0 = 1: 0 on degenerate tori.

    S(s) = 4 s³ - g2 s - g3; e4, e5 = (l1 ± k)/2 (Kowalevski 1889).
    """
    w1, w2, w3, g1, g2, g3 = state
    l1 = (w1 * w1 + w2 * w2 + 0.5 * w3 * w3 + g1) / 3.0
    ell = w1 * g1 + w2 * g2 + 0.5 * w3 * g3
    k = math.hypot(w1 * w1 - w2 * w2 - g1, 2.0 * w1 * w2 - g2)
    q2 = k * k - 1.0 + 3.0 * l1 * l1
    q3 = l1 * (k * k - 1.0 - l1 * l1) + ell**2

    def cubic(s: float) -> float:
        return 4.0 * s**3 - q2 * s - q3

    return cubic(0.5 * (l1 + k)), cubic(0.5 * (l1 - k)), q2**3 - 27.0 * q3**2


@cache
def degenerate(which: int, low: float, high: float) -> Floats:
    """Scale omega of the generic state, by a factor in (low, high), to a zero of ``separation(...)[which]``."""

    def at(factor: float) -> Floats:
        return (*(factor * w for w in GENERIC[:3]), *GENERIC[3:])

    sign = math.copysign(1.0, separation(at(low))[which])
    while low < 0.5 * (low + high) < high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if sign * separation(at(middle))[which] > 0.0 else (low, middle)
    return at(low)


def _near_homoclinic(eps: float) -> Case:
    exponent, due = round(math.log10(eps)), swing_time(eps)
    question = (
        f"start near the upright rotation, at gamma3 = eps = 1e{exponent}: does the first swing (minimum "
        f"of gamma1) come at t = sqrt 2 ln(8 sqrt 7/eps) = {due:.4f}?"
    )
    state = (2.0, 0.0, 0.0, math.sqrt(1.0 - eps * eps), 0.0, eps)
    return _case(f"homoclinic-1e{exponent}", question, TOP, state, 1e-3, round((due + 6.0) / 1e-3), swings_at(due))


def _passing(name: str, question: str, state: Floats) -> Case:
    """Case of a motion that reaches ``state`` at ``EVENT``, in the middle and on a step."""
    return _case(name, question, TOP, lambda: tuple(state_before(TOP, state, EVENT)), N=100)


RATE = math.sqrt(1.0 / 3.0)
"""Growth rate away from the middle axis for moments 3, 2, 1 and omega2 = 1."""


def _racket(offset: float, top: Top = Euler()) -> Case:  # noqa: B008 (never changed)
    """Case of the tennis racket; omega2 first crosses 0 after about ln(constant/offset)/rate."""
    state = (offset, 1.0, 0.0, 0.0, 1.0, 0.0)[: len(top.components)]
    question = (
        f"omega at a distance of {offset:g} from the middle axis: does the first change of sign of omega2 (the "
        "body flips over) come at the same time as in the closed form?"
    )
    steps = round((math.log(4.0 / offset) / RATE + 4.0) / 0.01)
    return _case(f"racket-1e{round(math.log10(offset))}", question, top, state, 0.01, steps, flips)


_LAGRANGE = Lagrange()
_SLEEPING = math.sqrt(4.0 * _LAGRANGE.A * _LAGRANGE.mu) / _LAGRANGE.C
"""omega3 at which the upright top is just stable: C omega3 = 2 sqrt(A mu)."""
_TILT = 1e-6
_SPACING = 2.0 * swing_time(1e-3)
_SPACED = (
    "initial state of the paper's figures, gamma3 = 1e-3: is the time between the first two swings (minima of gamma1) "
    f"{_SPACING:.4f}?"
)
CASES = [
    *map(_near_homoclinic, (1e-3, 1e-6, 1e-9)),
    _case(
        "homoclinic-spacing",
        _SPACED,
        TOP,
        (2.0, 0.0, 0.0, math.sqrt(1.0 - 1e-6), 0.0, 1e-3),
        1e-3,
        50_000,
        swings_at(_SPACING, spacing=True),
    ),
    _passing(
        "pole",
        "gamma passes through (0, 0, -1), where its stereographic coordinate z, used by bohlin-b, is infinite: "
        "does the scheme keep its order?",
        (0.7, -0.4, 1.3, 0.0, 0.0, -1.0),
    ),
    _passing(
        "branch-point",
        "omega1 + i omega2 passes through 0, where the square root that gives it in Bohlin's method is singular: "
        "does the scheme keep its order?",
        (0.0, 0.0, 1.3, *GAMMA),
    ),
    _passing(
        "near-branch-point",
        "omega1 + i omega2 passes 0 at a distance of 1e-3: does the scheme keep its order?",
        (0.0, 1e-3, 1.3, *GAMMA),
    ),
    _case("at-rest", "omega = 0 at the start: does the scheme keep its order?", TOP, (0.0, 0.0, 0.0, *GAMMA)),
    _case(
        "rest-on-axis",
        "omega = 0 and gamma = (0, 0, 1) at the start, hence Kowalevski's integral k² = 0: does the "
        "scheme keep its order?",
        TOP,
        (0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    ),
    _passing(
        "real-axis",
        "omega1 + i omega2 crosses the negative real axis, where Bohlin's method with the option "
        "branch=sign takes the wrong square root: does the scheme keep its order?",
        (-0.8, 0.0, 0.5, 0.6, -0.48, -0.64),
    ),
    _case(
        "delone",
        "k = 0 (Delone's motion), where the gradient of k² vanishes: does the scheme keep its order?",
        TOP,
        DELONE,
    ),
    _case(
        "delone-sleeping",
        "gamma = omega = (0, 0, 1) at the start (k = 0, E = 2 l²), where the gradients of the four "
        "integrals are linearly dependent: does the scheme keep its order?",
        TOP,
        (0.0, 0.0, 1.0, 0.0, 0.0, 1.0),
    ),
    _case(
        "torus-e4",
        "torus that has shrunk to a closed orbit (e4 is a double zero of Kowalevski's polynomial), where "
        "the gradients of the four integrals are linearly dependent: does the scheme keep its order?",
        TOP,
        TORUS_E4,
    ),
    _case(
        "torus-e5",
        "degenerate torus (e5 is a double zero of Kowalevski's polynomial): does the scheme keep its order?",
        TOP,
        lambda: degenerate(1, 0.585, 0.59),
    ),
    _case(
        "torus-double-root",
        "degenerate torus (two of e1, e2 and e3, zeros of Kowalevski's polynomial, coincide): does the "
        "scheme keep its order?",
        TOP,
        lambda: degenerate(2, 0.62, 0.625),
    ),
    _case("free", "c0 = 0, no gravity: does the scheme keep its order?", Kowalevski(c0=0.0), GENERIC),
    _case(
        "strong-gravity",
        "c0 = 1e6, very strong gravity, with h = 2e-5: does the scheme keep its order?",
        Kowalevski(c0=1e6),
        GENERIC,
        2e-5,
    ),
    _case(
        "negative-gravity", "c0 = -1, gravity reversed: does the scheme keep its order?", Kowalevski(c0=-1.0), GENERIC
    ),
    _case(
        "vanishing",
        "c0 = 0 and omega of size 1e-310, a denormal number: does the scheme keep its order?",
        Kowalevski(c0=0.0),
        (7e-311, -4e-311, 1.3e-310, *GAMMA),
    ),
    *general_cases(TOP),
    *map(_racket, (1e-3, 1e-6, 1e-9, 1e-12)),
    _case(
        "spherical",
        "A = B = C, so that omega is constant: does the scheme keep omega constant, at least to its order?",
        Euler(A=1.5, B=1.5, C=1.5),
        OMEGA,
    ),
    _case(
        "middle-axis",
        "rotation about the middle axis, an unstable fixed point: does the scheme stay there, at least to its order?",
        Euler(),
        (0.0, 1.0, 0.0),
    ),
    *general_cases(Euler()),
    _racket(1e-9, EulerGamma()),
    _case(
        "spherical",
        "A = B = C, so that omega is constant and gamma turns about it steadily: does the scheme keep its order?",
        EulerGamma(A=1.5, B=1.5, C=1.5),
        GENERIC,
    ),
    *general_cases(EulerGamma()),
    _case("at-rest", "omega = 0 at the start: does the scheme keep its order?", Heavy(), (0.0, 0.0, 0.0, *GAMMA)),
    _case(
        "spherical",
        "equal moments of inertia, A = B = C, with gravity: does the scheme keep its order?",
        Heavy(A=1.5, B=1.5, C=1.5),
        GENERIC,
    ),
    *general_cases(Heavy(), (0.05, -0.04, 0.06, -0.70, -0.42, -0.577581)),
    _case(
        "sleeping-threshold",
        "axis upright within 1e-6 rad, with the spin C omega3 = 2 sqrt(A mu) at the limit of stability: "
        "does the scheme keep its order?",
        _LAGRANGE,
        (0.0, 0.0, _SLEEPING, math.sin(_TILT), 0.0, math.cos(_TILT)),
        0.02,
        1000,
    ),
    _case(
        "sleeping",
        "spin about the exactly upright axis, a fixed point: does the scheme keep its order?",
        _LAGRANGE,
        (0.0, 0.0, 5.0, 0.0, 0.0, 1.0),
    ),
    _case(
        "at-rest",
        "omega = 0 at the start, so that the top swings as a plane pendulum: does the scheme keep its order?",
        _LAGRANGE,
        (0.0, 0.0, 0.0, 0.6, 0.0, 0.8),
    ),
    _case(
        "hanging",
        "mu = -1, centre of gravity below the fixed point at the start: does the scheme keep its order?",
        Lagrange(mu=-1.0),
        GENERIC,
    ),
    *general_cases(_LAGRANGE),
    _case(
        "sleeping-threshold",
        "axis upright within 1e-6 rad, with the spin m.a = 2 at the limit of stability: does the scheme "
        "keep its order?",
        LagrangeInertial(),
        (2.0 * math.sin(_TILT), 0.0, 2.0 * math.cos(_TILT), math.sin(_TILT), 0.0, math.cos(_TILT)),
        0.02,
        1000,
    ),
    *general_cases(LagrangeInertial(), singular=False),
]
"""Cases of topcli."""
OWN: dict[tuple[str, str], Case] = {}
"""Cases of plugins by name and form."""


def case(
    name: str, *, top: str, question: str, check: Check = keeps_order
) -> Callable[[Callable[[], Mapping[str, Any]]], Callable[[], Mapping[str, Any]]]:
    """Register the decorated function, which returns a config without a scheme, as a hard case of ``topcli stress``.

    Parameters
    ----------
    name : str
        Name of the case, in lower case.
    top : str
        Name of the top whose schemes the case tests (``Top.form``), such as ``euler`` or ``lagrange/inertial``.
    question : str
        Question that the case answers for each scheme, such as "is the order kept?".
    check : callable, optional
        Function that answers the question. ``check(trial)`` runs the scheme with ``trial.run`` and returns a
        ``topcli.studies.stress.checks.Finding``. The default check tests that the error falls with h as the order of
        the scheme says.

    Returns
    -------
    callable
        Decorator that registers the function and returns it unchanged.

    Raises
    ------
    ValueError
        If the top already has a case with this name.

    Examples
    --------
    >>> import topcli
    >>> @topcli.case("slow", top="euler", question="omega of size 1e-3: does the scheme keep its order?")
    ... def slow():
    ...     return {"top": "euler", "initial": {"omega": [1e-3, 2e-3, 0]}, "h": 1.0, "N": 200}
    """

    def register(config: Callable[[], Mapping[str, Any]]) -> Callable[[], Mapping[str, Any]]:
        if any((each.name, each.form) == (name, top) for each in (*CASES, *OWN.values())):
            raise ValueError(f"case {name!r} for top {top!r} is already registered")
        OWN[name, top] = Case(name, top, question, config, check, origin_of(config))
        return config

    return register


def cases_of(form: str) -> list[Case]:
    """Cases of a form of a top; for one that topcli has none for, those that make sense for any top."""
    own = [case for case in OWN.values() if case.form == form]
    return [*([case for case in CASES if case.form == form] or _cases_of_declared(TOPS[form], _starts.get(form))), *own]


_starts: dict[str, tuple[Top, Floats]] = {}
"""Top and initial state of a config by the form of the top, for the cases that suit any top."""


def start_from(top: Top, state: Floats) -> None:
    """Try a top without cases of its own with the parameters and from the initial state of a config."""
    _starts[top.form] = top, state


@cache
def _cases_of_declared(declared: type[Top], start: tuple[Top, Floats] | None) -> tuple[Case, ...]:
    if start is not None:
        top, state = start
        return _plain_cases(top, state, state)
    if declared.form in CATALOGUE:
        scene = load_experiment(gentle_scene(declared.form))
        return _plain_cases(scene.top, scene.y0, scene.y0)
    top = declared.new()
    state = (GENERIC * len(top.components))[: len(top.components)]
    return _plain_cases(top, state, state)


def case_names() -> list[str]:
    """Names of the cases; one name may be shared by cases that ask the same question about several tops."""
    return list(dict.fromkeys(case.name for case in (*CASES, *OWN.values())))


def cases_named(name: str) -> list[Case]:
    """Cases called ``name``, matched without case. Raises UnknownNameError with the nearest names."""
    named = [case for case in (*CASES, *OWN.values()) if case.name == name.lower()]
    if not named:
        raise UnknownNameError(f"unknown case {quoted(name)}; {nearest(name, case_names())}")
    return named
