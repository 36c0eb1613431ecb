"""Hirota-Kimura (Kahan) scheme generated from the field of a top (``topcli.field``)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial

from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.field.implicit import KahanStep, KahanTangent, generated
from topcli.field.polynomial import required_field
from topcli.field.straight_line import function_of
from topcli.schemes.layout import (
    HIROTA_KIMURA,
    LONG_HK,
    NEAR_SINGULAR,
    SINGULAR,
    SMALL,
    CompensatedOption,
    Event,
    is_compensated,
    linear_invariants,
    with_counter,
)
from topcli.schemes.layout import stepper as summing_stepper
from topcli.schemes.registry import scheme


@dataclass(frozen=True)
class Kahan:
    """Kahan's step of a pattern of fields: functions ``step`` and ``change``, the event of a near-singular solve."""

    step: StepFunction
    change: StepFunction
    near_singular: Event


@lru_cache(maxsize=256)  # the methods of tops with one pattern share their functions, and so their machine code
def kahan(made: KahanStep) -> Kahan:
    """The functions of a generated step."""
    graph, divisors = made.graph, made.divisors()
    of = partial(function_of, graph)
    near_singular = any_small(of("divisors", divisors), len(divisors) // 2) if divisors else never
    return Kahan(of("step", made.outputs), of("change", made.changes()), near_singular)


def never(old: Floats, new: Floats, h: float, p: Floats) -> bool:
    """Event of a step without a division, such as that of a constant field."""
    return False


def any_small(divisors: StepFunction, count: int) -> Event:
    """Event: one of ``count`` divisors is near zero; each is followed by the size of its terms."""

    def event(old: Floats, new: Floats, h: float, p: Floats) -> bool:
        found = divisors(old, h, p)
        small = False
        for i in range(count):
            small = small or abs(found[2 * i]) < SMALL * found[2 * i + 1]
        return small

    return event


@lru_cache(maxsize=256)
def _tangent_step(made: KahanTangent) -> StepFunction:
    return function_of(made.graph, "tangent", made.outputs)


def kahan_tangent(top: Top) -> Stepper:
    """Kahan's step of the field of ``top`` with its tangent map."""
    field = required_field(top, "scheme 'hk'", 2)
    made = generated(KahanTangent, field, len(top.constants()))
    return Stepper(_tangent_step(made.code), 2 * len(field), constants=made.constants)


def kahan_stepper(top: Top, options: object) -> Stepper:
    """Kahan's step of the field of ``top``, compensated if ``options`` say so; it counts near-singular solves."""
    field = required_field(top, "scheme 'hk'", 2)
    made, d = generated(KahanStep, field, len(top.constants())), len(field)
    functions = kahan(made.code)
    stepper = Stepper(functions.step, d)
    if is_compensated(options):
        stepper = summing_stepper(functions.change, d, lost=(i for i in range(d) if field[i].terms), checked=d)
    return with_counter(
        replace(
            stepper,
            constants=made.constants,
            source=partial(made.source, "step"),
            tangent=partial(kahan_tangent, top),
        ),
        NEAR_SINGULAR,
        functions.near_singular,
    )


@scheme(
    "hk",
    top="heavy",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    citation="Kahan 1993; Hirota, Kimura 2000; Kimura, Hirota 2000; Sogo, Discrete Spinning Tops, section 2.1",
    formula=HIROTA_KIMURA,
    equations="(dEulerPoisson) of the paper, with the last line corrected so that it ends with gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build_heavy(top: Top, options: CompensatedOption) -> Stepper:
    """Kahan's method for quadratic equations of motion: each step solves one linear system, in closed form.

    The code of the step is generated from the equations of motion.

    HK conserves none of the three integrals gamma², m·gamma and E exactly; for small h their deviations are of size h².
    For the Kowalevski, Lagrange and Euler tops topcli has faster code for the same map, under the same name.
    """
    return kahan_stepper(top, options)


@scheme(
    "hk",
    top=(),
    later=partial(required_field, needed_by="scheme 'hk'", degree=2),
    title="Hirota-Kimura scheme (Kahan's method)",
    order=2,
    explicit=True,
    self_adjoint=True,
    conserves=linear_invariants,
    citation="Kahan 1993; Hirota, Kimura 2000; Celledoni, McLachlan, Owren, Quispel, J. Phys. A 46 (2013) 025201",
    formula=r"""
\frac{y_i' - y_i}{h} = \sum_{jk} a_{ijk}\,\tfrac12\,(y_j y_k' + y_j' y_k) + \sum_j b_{ij}\,\bar y_j + c_i, \qquad
\dot y_i = \sum_{jk} a_{ijk}\,y_j y_k + \sum_j b_{ij}\,y_j + c_i
""",
    equations="(y' - y)/h = 2 f((y + y')/2) - f(y)/2 - f(y')/2 for a quadratic field f",
    options=CompensatedOption,
)
def build_quadratic(top: Top, options: CompensatedOption) -> Stepper:
    """Kahan's method for quadratic equations of motion: each step solves one linear system, in closed form.

    The code of the step is generated from the equations of motion. In these equations every product y z of two
    variables becomes (y' z + y z')/2, and every linear term y becomes the mean (y + y')/2; a prime marks a value after
    the step. HK conserves linear integrals; for small h the deviations of the other integrals are of size h².
    """
    return kahan_stepper(top, options)
