"""Tops from plugins and users' files: the decorator that registers a top and checks it, and look-up by name."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from topcli.contracts import Floats, Top
from topcli.errors import SchemeCodeError, UnknownNameError, UsageError, nearest, quoted
from topcli.schemes.plugins import is_built_in, line_of, origin_of, plugin_failures
from topcli.tops import CUSTOM, TOPS
from topcli.tops.bodies import checked_rotation

KIND = re.compile(r"[a-z][a-z0-9_-]*")
TAKEN = ("n", "t")
"""Columns of every series."""
ORIGINS: dict[str, str] = {}
"""Package or file of each form of a top that a plugin registered."""
STATES = 4
"""States at which a field is tried; the components of the first one are positive."""


def top(declared: type[Top]) -> type[Top]:
    """Register the decorated class as a top, with the general schemes (such as ``rk4``) that its field allows.

    The class derives from ``topcli.Top``. It declares ``kind``, ``components``, its parameters as floats with defaults,
    the right-hand side ``field(y, p)`` of the equations of motion (y is the state, p contains the constants), and
    ``integrals``, a mapping of names to functions of ``y`` and ``p``. The first line of its docstring is its title. All
    quantities are dimensionless.

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
    _require_names(declared, where)
    _require_parameters(declared, where)
    _require_field(declared)
    _require_integrals(declared, where)
    if declared.angular_velocity or declared.vertical:
        checked_rotation(declared.new(), "its vertical")
    form = declared.form
    TOPS[form], ORIGINS[form] = declared, origin_of(declared)
    return declared


def _require_names(declared: type[Top], where: str) -> None:
    """Raise UsageError unless kind, form and components are unused names, and the class has a field."""
    if not (isinstance(declared, type) and issubclass(declared, Top)):
        name = getattr(declared, "__name__", type(declared).__name__)
        raise UsageError(f"{where}: {name!r} is not a topcli.Top; declare it as class {name}(topcli.Top)")
    name = declared.__name__
    missing = [key for key in ("kind", "components", "field") if getattr(declared, key, None) is None]
    if missing:
        raise UsageError(f"{where}: top {name!r} does not declare {' and '.join(missing)}")
    kind, form = declared.kind, declared.form
    if not (isinstance(kind, str) and KIND.fullmatch(kind)):
        raise UsageError(f"{where}: kind {kind!r} is not a name in lower case, such as 'gyrostat'")
    if kind == CUSTOM:
        raise UsageError(f"{where}: kind {CUSTOM!r} is reserved for tops that a config defines; choose another")
    if form != kind and not form.startswith((f"{kind}+", f"{kind}/")):
        raise UsageError(f"{where}: form {form!r} is neither {kind!r} nor begins with '{kind}+' or '{kind}/'")
    if form in TOPS:
        known = ORIGINS.get(form, "topcli")
        raise UsageError(f"{where}: top {form!r} is already registered by {known}; choose another kind")
    components = declared.components
    if isinstance(components, str) or not components or not all(isinstance(one, str) for one in components):
        raise UsageError(f"{where}: components of top {kind!r} are {components!r}; give a tuple of names")
    columns = [*TAKEN, *components, *declared.integrals]
    for i, column in enumerate(columns):
        if not column.isidentifier():
            raise UsageError(f"{where}: {column!r} is not the name of a component or an integral of top {kind!r}")
        if column in columns[:i]:
            raise UsageError(f"{where}: top {kind!r} has two columns {column!r}; rename a component or an integral")
    for key in (*declared.symbols, *declared.holds_on):
        if key not in declared.integrals and declared.invariants is Top.invariants:
            raise UsageError(f"{where}: top {kind!r} has no integral {key!r}; {nearest(key, declared.integrals)}")


def _require_parameters(declared: type[Top], where: str) -> None:
    """Raise UsageError for a parameter that is not a float or has no default."""
    for name, parameter in declared.model_fields.items():
        if parameter.annotation is not float:
            shown = getattr(parameter.annotation, "__name__", parameter.annotation)
            raise UsageError(f"{where}: parameter {name!r} is declared as {shown}; declare it as {name}: float = 1.0")
        if parameter.is_required():
            raise UsageError(f"{where}: parameter {name!r} has no default; declare it as {name}: float = 1.0")


def _states(d: int) -> list[Floats]:
    """States (d,) in general position."""
    random = np.random.default_rng(d)
    return [tuple(np.abs(y).tolist() if i == 0 else y.tolist()) for i, y in enumerate(random.normal(size=(STATES, d)))]


def tried(function: Callable[[Any, Floats], Any], d: int, p: Floats) -> Any:
    """Value of ``function(y, p)`` at the first state at which it does not raise; if it always does, its error."""
    *others, last = _states(d)
    for y in others:
        try:
            return function(y, p)
        except (ArithmeticError, ValueError):  # outside the domain of a root or a logarithm, perhaps
            continue
    return function(last, p)


def _require_field(declared: type[Top]) -> None:
    """Raise UsageError unless the field returns one number for each component; what it raises passes."""
    made, field, components = declared.new(), declared.field, declared.components
    rates, d = tried(field, len(components), made.constants()), len(components)
    where = line_of(field)
    if not isinstance(rates, tuple):
        raise UsageError(f"{where}: the field returns {type(rates).__name__}; expected a tuple of {d} numbers")
    if len(rates) != d:
        raise UsageError(
            f"{where}: the field returns {len(rates)} numbers; expected {d}, one for each of {', '.join(components)}"
        )
    for name, rate in zip(components, rates, strict=True):
        if not isinstance(rate, int | float | np.floating):
            raise UsageError(f"{where}: the rate of {name} is {type(rate).__name__}; expected a float")


def _require_integrals(declared: type[Top], where: str) -> None:
    """Raise UsageError for an integral that the field does not conserve; what it raises passes."""
    from topcli.field.integrals import broken_integral

    made = declared.new()
    for name, integral in declared.integrals.items():
        value = tried(integral, len(declared.components), made.constants())
        if not isinstance(value, int | float | np.floating):
            shown = type(value).__name__
            raise UsageError(f"{line_of(integral)}: integral {name!r} returns {shown}; expected a number")
    state = np.array(_states(len(declared.components)))
    for invariant in made.invariants():  # of a class that defines them itself
        invariant.value(state)
    if fault := broken_integral(made):
        integral = next((one for name, one in declared.integrals.items() if fault.startswith(repr(name))), None)
        raise UsageError(f"{line_of(integral) if integral else where}: top {declared.form!r}: {fault}")


def top_origin(top: type[Top]) -> str:
    """``topcli``, or the package or file of a top."""
    return "topcli" if is_built_in(top) else ORIGINS.get(top.form, top.__module__)


def top_names() -> list[str]:
    """Names of the tops for users: each kind, and each form that differs from its kind; ``custom`` comes last."""
    plugin_failures()
    return [*dict.fromkeys(name for form in TOPS for name in (TOPS.kind(form), form)), CUSTOM]


def forms(name: str) -> list[type[Top]]:
    """Forms of the top called ``name``, matched without case: all of a kind with the default first, or a single one.

    Raises UnknownNameError, with the nearest names, for an unknown kind.
    """
    key = name.lower()
    if key == CUSTOM:
        raise UsageError("a custom top is declared in a config, by its section top")
    failures = []
    if not (key in TOPS or any(TOPS.kind(form) == key for form in TOPS)):
        failures = plugin_failures()
        if failed := next((failure for failure in failures if failure.name.lower() == key), None):
            raise SchemeCodeError(f"top {name!r}: {failed}")
    classes = [TOPS[form] for form in TOPS if TOPS.kind(form) == key] or ([TOPS[key]] if key in TOPS else [])
    if not classes:
        raise UnknownNameError(f"unknown top {quoted(name)}; {nearest(name, top_names())}", *map(str, failures[:2]))
    return classes


def top_class(name: str, vectors: Collection[str] = ()) -> type[Top]:
    """Return the class of the top called ``name`` that has the ``vectors`` in its initial state.

    If a top has several forms (choices of state variables), the names of the ``vectors``, such as omega and gamma,
    decide which form is meant. If no form has these vectors, the default form is returned. Raises UnknownNameError,
    with the nearest names, if there is no such top.
    """
    classes = forms(name)
    return next((top for top in classes if set(top.vectors) == set(vectors)), classes[0])
