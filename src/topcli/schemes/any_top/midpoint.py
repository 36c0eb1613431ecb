"""Implicit midpoint rule for any field, solved by Newton's method.

The step of Newton's method is generated from a polynomial field (``field.implicit``). For any other field its Jacobian
consists of difference quotients, so that the last digits cost one iteration more; the solution is the same.

The unknowns are *changes* of the state: their rounding errors are proportional to the change, and the one addition
state + change rounds without bias. A step takes two iterations at h = 0.001, three at 0.01 and 0.1; one fewer would
leave errors of one sign above round-off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache, partial

from topcli.arithmetic.fused import defined, follow_precision
from topcli.contracts import Floats, NoOptions, StepFunction, Stepper, Top
from topcli.field.implicit import MidpointTangent, NewtonStep, generated
from topcli.field.polynomial import Field, NotPolynomialError, field_of, strongly_connected
from topcli.field.straight_line import compiled_function
from topcli.schemes.limits import quadratic_invariants
from topcli.schemes.registry import scheme
from topcli.schemes.steppers import first, stepper

NEWTON_LIMIT = 25
"""Maximum number of Newton iterations; three or four are typical."""
SETTLED = 2.0**-33
"""Tolerance of the last correction, relative; by quadratic convergence the error is far below the last bit.
"""
FAR = 2.0**-10
"""Largest sum of such corrections relative to the state. After a singular matrix the state is huge, its rates are the
square of that, and a correction as large as the state would be small beside them."""
NEAR, NEAREST = 2.0**-20, 2.0**-30
"""Distance of the arguments of a difference quotient: these parts of half of the change, and of the component."""
follow_precision(__name__, caps=("NEWTON_LIMIT",), SETTLED=0.5, NEAR=0.5, NEAREST=0.5)

LONG_STEPS = {
    **dict.fromkeys(("euler", "euler+gamma", "heavy"), ("resonance", "singular-step")),
    **dict.fromkeys(("kowalevski", "lagrange"), ("singular-step",)),
}
"""Hard cases of the tops of the paper in which Newton's method finds no solution."""

_CHANGE = """
def change(s, h, p):
    zero = ({zeros})  # numba refuses more than 30 items for a variable with several values
    u = zero
    status = nan
    iterations = 0.0
    for _ in range(NEWTON_LIMIT):
        iterations += 1.0
        v = newton(({state}{half}), h, p)
        settled = {settled}
        new = ({new})
        u = new
        if settled:
            status = 0.0
            break
    return ({changes}status, iterations)
"""


@lru_cache(maxsize=256)  # tops with one pattern share their machine code
def _generated_change(newton: NewtonStep) -> StepFunction:
    """Change in a step of the rule for a polynomial field.

    Components that occur in each other's products are of one kind, such as omega and gamma.
    """
    d = len(newton.field)
    kinds = strongly_connected([rate.nonlinear() for rate in newton.field], range(d))
    return _change(compiled_function(newton.graph, "newton", newton.outputs), d, kinds)


@lru_cache(maxsize=256)
def _differenced_change(field: Callable[[Floats, Floats], Floats], d: int) -> StepFunction:
    """Change in a step of the rule for any field of ``d`` components, by difference quotients.

    The step of Newton's method has the inputs and outputs of ``NewtonStep``. The second argument of a quotient lies in
    the direction of the motion, where a root or a logarithm has a value. The system is solved without a choice of
    pivots: a poor solution costs iterations, not digits.
    """
    every = range(d)
    mean = "".join(f"m{i}, " for i in every)
    lines = ["k = 0.5 * h", *(f"m{i} = s[{i}] + s[{d + i}]" for i in every), f"f = field(({mean}), p)"]
    for j in every:
        lines += [
            f"e, w = NEAR * (k * f[{j}]), NEAREST * abs(m{j})",
            "e = e + w if e >= 0.0 else e - w",
            "x = NEAR if e == 0.0 else e",
            f"x = m{j} + x",
            f"g = field(({mean.replace(f'm{j}, ', 'x, ')}), p)",
            f"w = k / (x - m{j})",
            *(f"a{i}_{j} = w * (g[{i}] - f[{i}])" for i in every),
        ]
    for i in every:
        lines += [
            f"z{i} = abs(k * f[{i}]) + " + " + ".join(f"abs(a{i}_{j} * m{j})" for j in every),
            f"b{i} = k * f[{i}] - s[{d + i}]",
            *(f"a{i}_{j} = {'1.0 ' if i == j else ''}-a{i}_{j}" for j in every),
        ]
    for j in every:
        for i in range(j + 1, d):
            lines += [f"w = a{i}_{j} / a{j}_{j}", *(f"a{i}_{k} = a{i}_{k} - w * a{j}_{k}" for k in range(j + 1, d))]
            lines += [f"b{i} = b{i} - w * b{j}"]
    for i in reversed(every):
        lines += [f"b{i} = (b{i}{''.join(f' - a{i}_{j} * b{j}' for j in range(i + 1, d))}) / a{i}_{i}"]
    outputs = "".join([*(f"s[{d + i}] + b{i}, " for i in every), *(f"z{i}, " for i in every)])
    text = "def newton(s, h, p):\n    " + "\n    ".join([*lines, f"return ({outputs})"])
    names = {"field": field, "NEAR": NEAR, "NEAREST": NEAREST, "__name__": __name__}
    newton = defined(text, f"difference quotients {d}", **names)["newton"]
    # at rest one iteration solves the equation, but its derivative has the error of the quotients until the next one
    return _change(newton, d, [(i,) for i in every], "iterations > 1.0")


def _change(newton: StepFunction, d: int, kinds: Sequence[Sequence[int]], *conditions: str) -> StepFunction:
    """Change in a step of the midpoint rule by Newton's method, with its status and the number of iterations.

    The iteration ends if the corrections of every kind of components are small against its size, and the ``conditions``
    hold. The change is twice the last half change: evaluated from the field once more, at a mean that is rounded, it
    would make all quadratic integrals decrease by 1e-19 a step.
    """

    def total(text: str, kind: Iterable[int]) -> str:
        return " + ".join(text.format(i=i, size=d + i) for i in kind)

    def listed(text: str) -> str:
        return "".join(text.format(i=i) + ", " for i in range(d))

    tests = (
        f"{total('abs(v[{i}] - u[{i}])', kind)} <= SETTLED * ({total('abs(s[{i}]) + abs(v[{size}])', kind)})"
        for kind in kinds
    )
    near = f"{total('abs(v[{i}] - u[{i}])', range(d))} <= FAR * ({total('abs(s[{i}]) + abs(v[{i}])', range(d))})"
    text = _CHANGE.format(
        zeros=listed("0.0"),
        state=listed("s[{i}]"),
        half=listed("u[{i}]"),
        settled=" and ".join((*tests, near, *conditions)),
        new=listed("v[{i}]"),
        changes=listed("2.0 * u[{i}]"),
    )
    limits = {"nan": math.nan, "NEWTON_LIMIT": NEWTON_LIMIT, "SETTLED": SETTLED, "FAR": FAR}
    return defined(text, f"midpoint rule {d}", newton=newton, __name__=__name__, **limits)["change"]


_TANGENT = """
def step(s, h, p):
    x = change(({state}), h, p)
    w = tangent(({state}{half}{vector}), h, p)
    return ({new}{image}x[{d}])
"""


@lru_cache(maxsize=256)
def _tangent_stepper(newton: NewtonStep, tangent: MidpointTangent) -> Stepper:
    """The rule with its tangent map; the last slot is the status."""
    d = len(newton.field)

    def listed(text: str) -> str:
        return "".join(text.format(i=i, v=d + i) + ", " for i in range(d))

    parts = {"state": "s[{i}]", "half": "0.5 * x[{i}]", "vector": "s[{v}]", "new": "s[{i}] + x[{i}]", "image": "w[{i}]"}
    functions = {
        "change": _generated_change(newton),
        "tangent": compiled_function(tangent.graph, "tangent", tangent.outputs),
        "__name__": __name__,
    }
    text = _TANGENT.format(d=d, **{name: listed(part) for name, part in parts.items()})

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, 0.0)

    step = defined(text, f"tangent map of the midpoint rule {d}", **functions)["step"]
    constants = (*newton.constants, *tangent.constants)
    return Stepper(step, 2 * d + 1, enter, first(2 * d), iterative=True, constants=constants)


def _midpoint_tangent(field: Field, top: Top, newton: NewtonStep) -> Stepper:
    """The midpoint rule with its tangent map."""
    tangent = generated(MidpointTangent, field, len(top.constants()) + len(newton.constants))
    return _tangent_stepper(newton, tangent)


@scheme(
    "midpoint",
    top=None,
    requires=lambda top: None,
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=quadratic_invariants,
    limits=lambda top: LONG_STEPS.get(top.form, ()),
    changes=True,
)
def build_midpoint(top: Top, options: NoOptions) -> Stepper:
    r"""Implicit midpoint rule.

    An implicit step: Newton's method solves its equation, y' = y + h f((y + y')/2), to round-off.

    The step is self-adjoint. For any top the midpoint rule conserves every quadratic integral exactly, such as gamma²,
    m·gamma and the energy of a heavy top. Kowalevski's integral k² has degree four and is conserved only approximately.
    If the equations of motion are polynomials, the code of the step is generated from them; otherwise Newton's method
    uses difference quotients. If a step does not converge, the run ends as `no_convergence`.

    Source
    ------
    Cooper 1987; Sogo, Discrete Spinning Tops, section 1.2 (for Euler's top)

    Equations
    ---------
    y' - y = h f((y' + y)/2); for Euler's top the last difference equations of section 1.2 of the paper

    Formula
    -------
    y' = y + h\,f(\bar y)

    Limits
    ------
    resonance, singular-step
        If h is the time of one revolution of the body or longer, Newton's method may find no solution. The run then
        ends as `no_convergence`.
    """
    d = len(top.components)
    of_change = partial(stepper, d=d, counters=("iterations",), iterative=True)
    try:
        field = field_of(top)
    except NotPolynomialError:
        return of_change(_differenced_change(top.field, d))
    newton = generated(NewtonStep, field, len(top.constants()))
    return replace(
        of_change(_generated_change(newton)),
        constants=newton.constants,
        source=partial(newton.source, "newton"),
        tangent=partial(_midpoint_tangent, field, top, newton),
    )
