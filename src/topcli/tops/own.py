"""The decorator ``topcli.top``, which checks the class of a user's top and registers it."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from topcli.contracts import Floats, Top
from topcli.errors import UsageError, nearest
from topcli.field.integrals import broken_integral
from topcli.plugins import line_of, origin_of
from topcli.tops import CUSTOM, TOPS
from topcli.tops.bodies import checked_rotation
from topcli.tops.declared import name_fault

KIND = re.compile(r"[a-z][a-z0-9_-]*")
_STATES = 4
"""States at which a field is tried."""


def top(declared: type[Top]) -> type[Top]:
    """Register the decorated class as a top, with the general schemes (such as ``rk4``) that its field allows.

    The class derives from ``topcli.Top``. It declares ``kind``, ``components``, its parameters as floats with defaults,
    the right-hand side ``field(y, p)`` of the equations of motion (y is the state, p contains the constants), and
    ``integrals``, a mapping of names to functions of ``y`` and ``p``. The first line of its docstring is its title, and
    the underlined parts ``Source`` and ``Formula`` (in LaTeX) are those of its equations. All quantities are
    dimensionless.

    Parameters
    ----------
    declared : type of Top
        Class of the top.

    Returns
    -------
    type of Top
        The class, unchanged.

    Raises
    ------
    UsageError
        If the declaration cannot be used. Possible reasons are a ``kind`` or ``form`` that is not a name or already
        exists, a parameter that is not a float, a field that raises an exception or does not return one number for each
        component, and an integral that the field does not conserve. The message begins with the file and the line.

    Examples
    --------
    >>> import topcli
    >>> @topcli.top
    ... class Pendulum(topcli.Top):
    ...     '''Pendulum, by the sine and the cosine of its angle and its speed.'''
    ...
    ...     kind = "pendulum"
    ...     components = ("s", "c", "speed")
    ...     g: float = 1.0
    ...
    ...     def field(y, p):
    ...         s, c, speed = y
    ...         return (c * speed, -s * speed, -p[0] * s)
    ...
    ...     integrals = {"energy": lambda y, p: y[2] ** 2 / 2 - p[0] * y[1], "unit": lambda y, p: y[0] ** 2 + y[1] ** 2}
    >>> Pendulum(g=2.0).constants()
    (2.0,)
    """
    caller = sys._getframe(1)
    where = f"{caller.f_code.co_filename}:{caller.f_lineno}"
    if fault := _fault(declared):
        raise UsageError(f"{where}: {fault}")
    _require_numbers(declared)
    if fault := broken_integral(declared.new()):
        integral = next((each for name, each in declared.integrals.items() if fault.startswith(repr(name))), None)
        raise UsageError(f"{line_of(integral) if integral else where}: top {declared.form!r}: {fault}")
    if declared.angular_velocity or declared.vertical:
        checked_rotation(declared.new(), "its vertical")
    form = declared.form
    TOPS[form], TOPS.origins[form] = declared, origin_of(declared)
    return declared


def _fault(declared: type[Top]) -> str:
    """Reason why the names of a declaration cannot be used; empty if they can."""
    name = getattr(declared, "__name__", type(declared).__name__)
    if not (isinstance(declared, type) and issubclass(declared, Top)):
        return f"{name!r} is not a topcli.Top; declare it as class {name}(topcli.Top)"
    if missing := [key for key in ("kind", "components", "field") if getattr(declared, key, None) is None]:
        return f"top {name!r} does not declare {' and '.join(missing)}"
    kind, form, components = declared.kind, declared.form, declared.components
    if not (isinstance(kind, str) and KIND.fullmatch(kind)):
        return f"kind {kind!r} is not a name in lower case, such as 'gyrostat'"
    if form != kind and not form.startswith((f"{kind}+", f"{kind}/")):
        return f"form {form!r} is neither {kind!r} nor begins with '{kind}+' or '{kind}/'"
    if form in TOPS or kind == CUSTOM:
        return f"top {form!r} is already registered by {TOPS.origins.get(form, 'topcli')}; choose another kind"
    if isinstance(components, str) or not components or not all(isinstance(name, str) for name in components):
        return f"components of top {kind!r} are {components!r}; give a tuple of names"

    # each column of a series and each name in a formula has one meaning
    earlier: dict[str, str] = {}
    names = {"component": components, "parameter": declared.model_fields, "invariant": declared.integrals}
    for what, group in names.items():
        for each in group:
            if fault := name_fault(each, what, earlier):
                return f"top {kind!r}: {fault}"
            earlier[each] = what
    for key in (*declared.symbols, *declared.holds_on):
        if key not in declared.integrals and declared.invariants is Top.invariants:
            return f"top {kind!r} has no integral {key!r}; {nearest(key, declared.integrals)}"
    for name, parameter in declared.model_fields.items():
        if parameter.annotation is not float or parameter.is_required():
            return f"parameter {name!r} must be a float with a default; declare it as {name}: float = 1.0"
    return ""


def tried(function: Callable[[Any, Floats], Any], d: int, p: Floats) -> Any:
    """Value of ``function(y, p)`` at the first of some states at which it does not raise; if it always does, its error.

    The components of the first state are positive.
    """
    first, *others = np.random.default_rng(d).normal(size=(_STATES, d)).tolist()
    for y in (tuple(map(abs, first)), *map(tuple, others[:-1])):
        with suppress(ArithmeticError, ValueError):  # outside the domain of a root or a logarithm, perhaps
            return function(y, p)
    return function(tuple(others[-1]), p)


def _require_numbers(declared: type[Top]) -> None:
    """Raise UsageError unless field and integrals return numbers; what they raise passes."""
    p, components, field = declared.new().constants(), declared.components, declared.field
    rates, d = tried(field, len(components), p), len(components)
    if not isinstance(rates, tuple) or len(rates) != d:
        value_text = f"{len(rates)} numbers" if isinstance(rates, tuple) else type(rates).__name__
        expected = f"a tuple of {d}, one for each of {', '.join(components)}"
        raise UsageError(f"{line_of(field)}: the field returns {value_text}; expected {expected}")
    values = [(field, f"the rate of {name}", rate) for name, rate in zip(components, rates, strict=True)]
    values += [(each, f"integral {name!r}", tried(each, d, p)) for name, each in declared.integrals.items()]
    for function, what, value in values:
        if not isinstance(value, int | float | np.floating):
            raise UsageError(f"{line_of(function)}: {what} is {type(value).__name__}; expected a float")
