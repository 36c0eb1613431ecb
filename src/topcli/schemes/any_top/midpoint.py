"""Implicit midpoint rule of every polynomial field, by Newton's method, whose step is generated (``field.implicit``).

The unknowns are *changes* of the state: their rounding errors are proportional to the change, and the one addition
state + change rounds without bias. A step takes two iterations at h = 0.001, three at 0.01 and 0.1; one fewer would
leave errors of one sign above round-off.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache, partial

from topcli.arithmetic.fused import defined, follow_precision
from topcli.contracts import Floats, NoOptions, StepFunction, Stepper, Top
from topcli.field.implicit import MidpointTangent, NewtonStep, generated
from topcli.field.polynomial import required_field, strongly_connected
from topcli.field.straight_line import compiled_function
from topcli.schemes.registry import quadratic_invariants, scheme
from topcli.schemes.steppers import first, stepper

_NEEDED_BY = "scheme 'midpoint'"
_NEWTON_LIMIT = 25
"""Maximum number of Newton iterations; three or four are typical."""
_SETTLED = 2.0**-33
"""Tolerance of the last correction, relative; by quadratic convergence the error is far below the last bit.
"""
FAR = 2.0**-10
"""Largest sum of such corrections relative to the state. After a singular matrix the state is huge, its rates are the
square of that, and a correction as large as the state would be small beside them."""
follow_precision(__name__, caps=("_NEWTON_LIMIT",), _SETTLED=0.5)

_CHANGE = """
def change(s, h, p):
    zero = ({zeros})  # numba refuses more than 30 items for a variable with several values
    u = zero
    status = nan
    iterations = 0.0
    for _ in range(_NEWTON_LIMIT):
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
def _change(newton: NewtonStep) -> StepFunction:
    """Change in a step of the midpoint rule by Newton's method, with its status and the number of iterations.

    The iteration ends if the corrections are small against the size of their kind: components that occur in each
    other's products are of one kind, such as omega and gamma. The change is twice the last half change: evaluated from
    the field once more, at a mean that is rounded, it would make all quadratic integrals decrease by 1e-19 a step.
    """
    d = len(newton.field)
    kinds = strongly_connected([rate.nonlinear() for rate in newton.field], range(d))

    def total(text: str, kind: Iterable[int]) -> str:
        return " + ".join(text.format(i=i, size=d + i) for i in kind)

    tests = (
        f"{total('abs(v[{i}] - u[{i}])', kind)} <= _SETTLED * ({total('abs(s[{i}]) + abs(v[{size}])', kind)})"
        for kind in kinds
    )
    near = f"{total('abs(v[{i}] - u[{i}])', range(d))} <= FAR * ({total('abs(s[{i}]) + abs(v[{i}])', range(d))})"
    text = _CHANGE.format(
        zeros="0.0, " * d,
        state=_listed("s[{i}]", d),
        half=_listed("u[{i}]", d),
        settled=" and ".join((*tests, near)),
        new=_listed("v[{i}]", d),
        changes=_listed("2.0 * u[{i}]", d),
    )
    step = compiled_function(newton.graph, "newton", newton.outputs)
    limits = {"nan": math.nan, "_NEWTON_LIMIT": _NEWTON_LIMIT, "_SETTLED": _SETTLED, "FAR": FAR}
    return defined(text, f"midpoint rule {d}", newton=step, __name__=__name__, **limits)["change"]


def _listed(text: str, d: int) -> str:
    """Text of each component ``i``, of which ``v`` is the place in the vector behind the state, with commas."""
    return "".join(text.format(i=i, v=d + i) + ", " for i in range(d))


_TANGENT = """
def step(s, h, p):
    x = change(({state}), h, p)
    w = tangent(({state}{half}{vector}), h, p)
    return ({new}{image}x[{d}])
"""


@lru_cache(maxsize=256)
def _with_tangent(newton: NewtonStep, count: int) -> Stepper:
    """The rule with its tangent map, for a top with ``count`` constants; the last slot is the status."""
    d = len(newton.field)
    tangent = generated(MidpointTangent, newton.field, count + len(newton.constants))
    parts = {"state": "s[{i}]", "half": "0.5 * x[{i}]", "vector": "s[{v}]", "new": "s[{i}] + x[{i}]", "image": "w[{i}]"}
    functions = {
        "change": _change(newton),
        "tangent": compiled_function(tangent.graph, "tangent", tangent.outputs),
        "__name__": __name__,
    }
    text = _TANGENT.format(d=d, **{name: _listed(part, d) for name, part in parts.items()})

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*y, 0.0)

    step = defined(text, f"tangent map of the midpoint rule {d}", **functions)["step"]
    constants = (*newton.constants, *tangent.constants)
    return Stepper(step, 2 * d + 1, enter, first(2 * d), iterative=True, constants=constants)


@scheme(
    "midpoint",
    top=None,
    requires=partial(required_field, needed_by=_NEEDED_BY),
    order=2,
    explicit=False,
    self_adjoint=True,
    conserves=quadratic_invariants,
    changes=True,
)
def build_midpoint(top: Top, options: NoOptions) -> Stepper:
    r"""Implicit midpoint rule.

    An implicit step: Newton's method solves its equation, y' = y + h f((y + y')/2), to round-off.

    The step is self-adjoint. For any top the midpoint rule conserves every quadratic integral exactly, such as gamma²,
    m·gamma and the energy of a heavy top. Kowalevski's integral k² has degree four and is conserved only approximately.
    The code of the step is generated from the equations of motion, which must be polynomials. If a step does not
    converge, the run ends as `no_convergence`.

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
    resonance (euler, euler+gamma, heavy), singular-step (euler, euler+gamma, heavy, kowalevski, lagrange)
        If h is the time of one revolution of the body or longer, Newton's method may find no solution. The run then
        ends as `no_convergence`.
    """
    count = len(top.constants())
    newton = generated(NewtonStep, required_field(top, _NEEDED_BY), count)
    return replace(
        stepper(_change(newton), len(top.components), counters=("iterations",), iterative=True),
        constants=newton.constants,
        source=partial(newton.source, "newton"),
        tangent=partial(_with_tangent, newton, count),
    )
