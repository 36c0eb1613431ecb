"""Schemes as steps, and schemes written for the tests: controls that do not have the traits under test."""

from __future__ import annotations

from typing import Any

from topcli.contracts import Floats, Method, StepFunction, Stepper, Top
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski, kowalevski_field


def built(name: str, top: Top | None = None, **options: Any) -> Any:
    """Method of the scheme ``name`` for a top, by default the Kowalevski top."""
    top = top or Kowalevski()
    scheme = find_scheme(name, top.form)
    return scheme.build(top, scheme.options(**options))


def physical(made: Method) -> StepFunction:
    """The step of a scheme on physical states: without what it carries, counts, or says of its iteration."""
    assert isinstance(made, Stepper)
    enter, leave, step = made.enter or _as_it_is, made.leave or _as_it_is, made.step
    return lambda s, h, p: leave(step(enter(s, h, p), h, p), h, p)


def _as_it_is(s: Floats, h: float, p: Floats) -> Floats:
    return s


def _moved(s: Floats, a: float, k: Floats) -> Floats:
    return (
        s[0] + a * k[0],
        s[1] + a * k[1],
        s[2] + a * k[2],
        s[3] + a * k[3],
        s[4] + a * k[4],
        s[5] + a * k[5],
    )


def rk2_step(s: Floats, h: float, p: Floats) -> Floats:
    """Explicit midpoint rule: order 2, irreversible, conserves nothing."""
    return _moved(s, h, kowalevski_field(_moved(s, 0.5 * h, kowalevski_field(s, p)), p))


RK2 = Stepper(rk2_step, 6)
