"""Hirota-Kimura (Kahan) scheme generated from the field of a top (``topcli.field``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

from topcli.contracts import Floats, StepFunction, Stepper, Top
from topcli.field.implicit import KahanStep, planned
from topcli.field.polynomial import Field, field_of
from topcli.field.straight_line import function_of
from topcli.schemes.layout import (
    HIROTA_KIMURA,
    LONG_HK,
    NEAR_SINGULAR,
    SINGULAR,
    SMALL,
    CompensatedOption,
    Event,
    increment_stepper,
    is_compensated,
    with_counter,
)
from topcli.schemes.registry import scheme


@lru_cache(maxsize=1024)  # one function for equal sources: then the methods of such tops share their machine code
def shared_function(source: str, name: str) -> Callable[..., Any]:
    """The function ``name`` of generated ``source``."""
    return function_of(source, name)


@dataclass(frozen=True)
class Kahan:
    """Kahan's step of a field: ``step`` and ``change(state, h, p)``, and the event that a system is near singular.

    Its ``constants`` follow those of the top in p.
    """

    step: StepFunction
    change: StepFunction
    near_singular: Event
    constants: tuple[Fraction, ...]


@lru_cache(maxsize=256)
def kahan(field: Field, first: int) -> Kahan:
    """Kahan's step of a quadratic field, whose constants begin at ``p[first]``."""
    made = planned(KahanStep, field, first)
    graph = made.graph
    step = shared_function(graph.source("step", made.outputs), "step")
    change = shared_function(graph.source("change", made.changes()), "change")
    divisors = made.divisors()
    near_singular = any_small(shared_function(graph.source("divisors", divisors), "divisors"), len(divisors) // 2)
    return Kahan(step, change, near_singular, tuple(graph.constants))


@lru_cache(maxsize=1024)
def any_small(divisors: StepFunction, count: int) -> Event:
    """Event: one of ``count`` divisors is near zero; each is followed by the size of its terms."""

    def event(old: Floats, new: Floats, h: float, p: Floats) -> bool:
        found = divisors(old, h, p)
        small = False
        for i in range(count):
            small = small or abs(found[2 * i]) < SMALL * found[2 * i + 1]
        return small

    return event


@scheme(
    "hk",
    top="heavy",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    citation="Kahan 1993; Hirota, Kimura 2000; Kimura, Hirota 2000; Sogo, Discrete Spinning Tops, section 2.1",
    formula=HIROTA_KIMURA,
    equations="dEulerPoisson, with the last term of its last line corrected to gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build_hk(top: Top, options: CompensatedOption) -> Stepper:
    """Linear in the new state, solved in closed form by code generated from the field.

    None of the three integrals is conserved exactly; for small h the deviations are of size h². Special tops have
    faster implementations of the same map under the same name.
    """
    made = kahan(field_of(top), len(top.constants()))
    d = len(top.components)
    stepper = increment_stepper(made.change, d, options) if is_compensated(options) else Stepper(made.step, d)
    return with_counter(replace(stepper, constants=made.constants), NEAR_SINGULAR, made.near_singular)
