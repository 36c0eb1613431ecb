"""Schemes: the decorator that registers them, look-up by name and top, and the wrappers of their steps.

A scheme is registered once by name, for the forms of tops that it names or for every top that meets its requirements;
bound to one form, its traits that depend on the top are evaluated. Around the step that a scheme builds come, in this
order, compensated sums, a symmetric composition and a projection onto the integrals. They are keys of the section
``scheme`` of a config; no scheme knows of them.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import import_module
from typing import Any, TypeVar

from pydantic import BaseModel, Field, ValidationError, create_model

from topcli.contracts import Block, Floats, Invariant, Method, NoOptions, Sampler, Scheme, Stepper, Top, parts_of
from topcli.errors import SchemeCodeError, UnknownNameError, UsageError, nearest, quoted, successor
from topcli.field.integrals import polynomial_value
from topcli.field.polynomial import NotPolynomialError
from topcli.plugins import line_of, origin_of, plugin_failures, require_plugin, users_error
from topcli.schemes.compose import Composition, compose, composition_obstacle, find_composition
from topcli.schemes.projection import projected
from topcli.schemes.steppers import compensated
from topcli.tops import BUILT_IN, TOPS

Build = Callable[[Any, Any], Method]
B = TypeVar("B", bound=Build)

MODULES: dict[str, tuple[str, ...]] = {
    **{name: (f"any_top.{name}",) for name in ("hk", "midpoint", "taylor", "splitting", "dmv", "dop853")},
    **dict.fromkeys(("rk2", "rk4"), ("any_top.runge_kutta",)),
    **dict.fromkeys(("bohlin-a", "bohlin-b", "bohlin-c"), ("kowalevski.bohlin",)),
    **dict.fromkeys(("hybrid", "hybrid-sym"), ("kowalevski.hybrid",)),
    "backlund": ("kowalevski.backlund",),
    **dict.fromkeys(("bs", "bs-implicit"), ("classical.bs",)),
    "exact": ("classical.euler", "classical.lagrange", "kowalevski.exact"),
    "hk-exact": ("classical.euler",),
}
"""Modules in which the schemes of topcli are registered, by name."""
WRAPPERS = ("compensated", "compose", "project")
"""Keys of the section ``scheme`` that apply to the steps of any scheme."""


@dataclass(frozen=True, eq=False)
class Declaration:
    """A registered scheme, not yet bound to a top; ``traits`` are fields of ``Scheme`` or functions of the top."""

    name: str
    forms: tuple[str, ...] | None
    requires: Callable[[Top], object] | None
    changes: bool
    traits: Mapping[str, Any]


@cache  # a sweep looks its scheme up for every row
def misfit(declaration: Declaration, cls: type[Top]) -> str:
    """Reason why a registered scheme does not integrate a form of a top; empty if it does."""
    if declaration.forms is not None:
        return "" if cls.form in declaration.forms else f"it fits {', '.join(declaration.forms)}"
    try:
        if declaration.requires:
            declaration.requires(cls.new())
    except UsageError as error:
        return str(error)
    return ""


SCHEMES: dict[str, list[Declaration]] = {}
"""Registered schemes by name."""


def scheme(
    name: str,
    *,
    top: str | Iterable[str] | None,
    order: int | None,
    explicit: bool,
    self_adjoint: bool,
    conserves: Iterable[str] | Callable[[Top], Iterable[str]] = (),
    options: type[BaseModel] = NoOptions,
    modified: Callable[[Any, float, Any], tuple[Invariant, ...]] | None = None,
    adaptive: bool = False,
    longest_step: Callable[[Any, Floats, Any], float] | None = None,
    order_with: Callable[[Any], int | None] | None = None,
    requires: Callable[[Top], object] | None = None,
    changes: bool = False,
) -> Callable[[B], B]:
    """Register the decorated function ``build(top, options)`` as a scheme.

    ``build`` returns the method for one top: a ``Stepper``, a ``Sampler`` (closed-form solution) or a ``Block`` (with
    its own time loop) of ``topcli.contracts``. The docstring of ``build`` describes the scheme: title, description, and
    the underlined parts ``Source``, ``Equations`` (their numbers in the source, or the formula of the step),
    ``Formula`` (the step in LaTeX: display formulas without delimiters, separated by empty lines) and ``Limits``: names
    of conditions, separated by commas, with the reason below them. A name may be that of a hard case; ``topcli stress``
    then tests that the scheme fails it. Forms of tops in parentheses restrict a limit to these tops. Limits and source
    in the docstring of the module are those of all its schemes.
    The arguments declare properties of the scheme, which ``topcli check`` tests. Times and states are dimensionless.

    Parameters
    ----------
    name : str
        Name of the scheme in configs. It is case-insensitive and contains no ``+``. Schemes of different tops may have
        the same name; one for single tops replaces one for every top.
    top : str, iterable of str, or None
        Name (``Top.form``) of the top that the scheme integrates, or names of several; None for every top.
    order : int or None
        Order of convergence; None for an exact solution, or if the order follows from a tolerance.
    explicit : bool
        True if a step needs no iteration.
    self_adjoint : bool
        True if a step with -h inverts a step with h. Steps of a self-adjoint scheme of order 2 can be composed into
        a scheme of higher order.
    conserves : iterable of str or callable, optional
        Names of the invariants that the scheme conserves to round-off for every h, or a function ``conserves(top)``
        that returns these names.
    options : type of BaseModel, optional
        Pydantic model of the options of the scheme; an instance is the second argument of ``build``.
    modified : callable, optional
        ``modified(top, h, options)`` returns the modified integrals of the scheme, which depend on h, as a tuple of
        ``Invariant``. Their functions map states, shape (n, d), to values, shape (n,).
    adaptive : bool, optional
        True if the method divides each h into internal steps, controlled by a tolerance.
    longest_step : callable, optional
        ``longest_step(top, y0, options)`` returns the largest ``abs(h)`` with which the scheme can start from ``y0``. A
        single run with a larger step size is refused before it starts. In an ensemble, ``step`` of the ``Stepper`` must
        return nan for such an h.
    order_with : callable, optional
        ``order_with(options)`` returns the order, if it depends on the options; ``order`` is then the order with the
        default options.
    requires : callable, optional
        With ``top=None``: ``requires(top)`` raises UsageError with the reason if the scheme does not integrate ``top``.
    changes : bool, optional
        True if the ``Stepper`` has a ``change``; the scheme then has the option ``compensated``.

    Returns
    -------
    callable
        Decorator that registers the function and returns it unchanged.

    Raises
    ------
    ValueError
        If ``build`` has no docstring, if the name contains ``+``, if the options have a field ``compose``,
        ``compensated`` or ``project``, if the top is unknown, or if the name is already registered for the top.

    Examples
    --------
    >>> import topcli
    >>> from topcli.contracts import Stepper
    >>> from topcli.tops.euler import euler_field
    >>> def step(y, h, p):
    ...     f = euler_field(y, p)
    ...     return (y[0] + h * f[0], y[1] + h * f[1], y[2] + h * f[2])
    >>> @topcli.scheme("euler-rule", top="euler", order=1, explicit=True, self_adjoint=False)
    ... def build(top, options):
    ...     '''Euler's rule.
    ...
    ...     Source
    ...     ------
    ...     Euler 1768
    ...     '''
    ...     return Stepper(step, 3)
    >>> build(None, None).step((1.0, 2.0, 3.0), 0.5, (3.0, 2.0, 1.0, 1.0, -2.0, 1.0))
    (4.0, -1.0, 4.0)
    """
    forms = None if top is None else (top,) if isinstance(top, str) else tuple(top)

    def register(build: B) -> B:
        key, origin = name.lower(), origin_of(build)
        _require_declaration(key, forms, options, build)
        parts = parts_of(build.__doc__ or "")
        first, _, rest = parts["Description"].partition("\n\n")
        shared = parts_of(getattr(build, "__globals__", {}).get("__doc__") or "")
        traits = {
            "title": first.rstrip(".") or key,
            "order": order,
            "explicit": explicit,
            "self_adjoint": self_adjoint,
            "conserves": conserves,
            "citation": " ".join((parts["Source"] or shared["Source"]).split()),
            "equations": " ".join(parts["Equations"].split()),
            "build": build if origin == "topcli" else _checked(build, key),
            "maker": build,
            "options": options,
            "modified": modified,
            "adaptive": adaptive,
            "limits": f"{shared['Limits']}\n{parts['Limits']}",
            "longest_step": longest_step,
            "doc": rest or first,
            "origin": origin,
            "order_with": order_with,
            "formula": parts["Formula"],
        }
        SCHEMES.setdefault(key, []).append(Declaration(key, forms, requires, changes, traits))
        return build

    return register


def _limits(text: str, form: str) -> dict[str, str]:
    """Reasons in the part ``Limits`` by name, of the limits that concern a form of a top."""
    limits = {}
    for names, reason in re.findall(r"^(\S.*)\n((?:    .*\n?)+)", text, re.MULTILINE):
        for name, forms in re.findall(r"([^,()]+?)(?: \((.*?)\))?(?:, |$)", names):
            if not forms or form in forms.split(", "):
                limits[name] = " ".join(reason.split())
    return limits


def _require_declaration(name: str, forms: tuple[str, ...] | None, options: type[BaseModel], build: Build) -> None:
    """Raise ValueError for a declaration that cannot be used."""
    if not build.__doc__ and sys.flags.optimize < 2:  # python -OO removes docstrings
        raise ValueError(f"scheme {name!r} has no docstring")
    reserved = ["'+' in a name"] * ("+" in name)
    reserved += [f"an option {key!r}" for key in WRAPPERS if key in options.model_fields]
    if reserved:
        raise ValueError(f"scheme {name!r}: {reserved[0]} is reserved for what topcli does with the steps of a scheme")
    for form in forms or ():
        if form not in TOPS:
            raise ValueError(f"scheme {name!r}: unknown top {form!r}; {nearest(form, TOPS)}")
    if name in MODULES:
        _load(name)
    for other in SCHEMES.get(name, ()):
        taken = set(BUILT_IN) if other.forms is None else set(other.forms)
        if (forms is None and other.forms is None) or set(forms or ()) & taken:  # an own top may have its own scheme
            where = f"for top {forms[0]!r} " if forms else ""
            raise ValueError(f"scheme {name!r} {where}is already registered by {other.traits['origin']}")


def _checked(build: Build, name: str) -> Build:
    """``build`` of a scheme from outside, with errors that name its file and line."""

    def checked(top: Any, options: Any) -> Method:
        try:
            method = build(top, options)
        except Exception as error:
            raise (users_error(error) or error) from error
        if not isinstance(method, Stepper | Sampler | Block):
            raise SchemeCodeError(
                f"{line_of(build)}: scheme {name!r} is built as {type(method).__name__}; "
                "return a Stepper, a Sampler or a Block"
            )
        return method

    return checked


COMPENSATED = Field(default=False, description="compensated summation: round-off is multiplied by about h")
PROJECT = Field(
    default=0,
    ge=0,
    description="number of steps from one projection onto the initial values of all integrals to the next; 0 means no "
    "projection",
)


@cache
def _bound(declaration: Declaration, cls: type[Top], composition: Composition | None = None) -> Scheme:
    """The scheme for one form of a top, composed or not, with the wrappers of its steps."""
    top, traits = cls.generic(), dict(declaration.traits)
    conserves: Any = traits["conserves"]
    names: Any = conserves(top) if callable(conserves) else conserves
    traits["conserves"] = tuple(names)
    traits["limits"] = _limits(traits["limits"], cls.form)
    if traits["origin"] != "topcli":
        names = [invariant.name for invariant in top.invariants()]
        for conserved in traits["conserves"]:
            if conserved not in names:
                what = f"scheme {declaration.name!r} conserves {conserved!r}, no invariant of top {cls.form!r}"
                raise UsageError(f"{line_of(traits['maker'])}: {what}; {nearest(conserved, names)}")
    with suppress(ValidationError):  # options without defaults
        if traits["modified"] and not cls.hk and not traits["modified"](top, 0.1, traits["options"]()):
            traits["modified"] = None
    scheme = Scheme(name=declaration.name, top=cls.form, **traits)
    has_steps = scheme.order is not None and not scheme.adaptive
    if declaration.changes:
        scheme = compensable(scheme)
    if composition:
        scheme = compose(scheme, composition)
    return projectable(scheme) if has_steps else scheme


def _with_key(scheme: Scheme, key: str, option: tuple[type, Any], wrap: Callable[[Any, Any, Any], Stepper]) -> Scheme:
    """``scheme`` with the option ``key``: a value other than zero makes its steps ``wrap(method, top, value)``."""

    def build(top: Any, options: Any) -> Method:
        method, value = scheme.build(top, options), getattr(options, key)
        return wrap(method, top, value) if value else method

    bases = tuple(dict.fromkeys((scheme.options, NoOptions)))  # NoOptions refuses unknown keys
    fields: dict[str, Any] = {key: option}
    return replace(scheme, build=build, options=create_model(scheme.options.__name__, __base__=bases, **fields))


def compensable(scheme: Scheme) -> Scheme:
    """``scheme``, whose steps have a ``change``, with the option of compensated sums."""
    return _with_key(
        scheme, "compensated", (bool, COMPENSATED), lambda method, top, _: compensated(method, len(top.components))
    )


def projectable(scheme: Scheme) -> Scheme:
    """``scheme`` with the option of a projection onto the integrals, which ends its modified integrals."""

    def modified(top: Any, h: float, options: Any) -> tuple[Invariant, ...]:
        return () if options.project or not scheme.modified else scheme.modified(top, h, options)

    return replace(
        _with_key(scheme, "project", (int, PROJECT), projected), modified=modified if scheme.modified else None
    )


# what schemes declare


def polynomial_invariants(top: Top, degree: float = math.inf) -> tuple[str, ...]:
    """Return the names of the invariants of ``top`` that are polynomials of the state of at most ``degree``.

    One that only some motions conserve is left out, unless it is linear and its own level is the condition: then the
    motion remains on a hyperplane, and so do the stages of a method.
    """
    names = []
    for invariant in top.invariants():
        if invariant.on.keys() <= {invariant.name}:
            try:
                power = polynomial_value(invariant.value, len(top.components)).degree
            except NotPolynomialError:
                continue
            if power <= (1 if invariant.on else degree):
                names.append(invariant.name)
    return tuple(names)


linear_invariants = partial(polynomial_invariants, degree=1)
"""Names of the invariants of a top that every Runge-Kutta method conserves."""
quadratic_invariants = partial(polynomial_invariants, degree=2)
"""Names of the invariants of a top that the implicit midpoint rule conserves (Cooper 1987)."""


def all_invariants(top: Top) -> tuple[str, ...]:
    """Names of all invariants of ``top``."""
    return tuple(invariant.name for invariant in top.invariants())


closed_form = partial(scheme, "exact", order=None, explicit=True, self_adjoint=True, conserves=all_invariants)
"""Decorator of a solution in closed form of the tops ``top``, under the name ``exact``."""


# look-up


def _load(name: str | None = None) -> None:
    """Import the built-in modules that register a scheme; without a name all of them, and the plugins."""
    for modules in [MODULES[name]] if name in MODULES else MODULES.values():
        for module in modules:
            import_module(f"topcli.schemes.{module}")
    if name not in MODULES:
        plugin_failures()


def _candidates(name: str, cls: type[Top]) -> list[Declaration]:
    """Registered schemes of a name that integrate a form, one for single tops before one for every top."""
    fitting = [declaration for declaration in SCHEMES.get(name, ()) if not misfit(declaration, cls)]
    return sorted(fitting, key=lambda declaration: declaration.forms is None)


def find_scheme(name: str, top: str) -> Scheme:
    """Return the scheme called ``name`` for one form of a top.

    Parameters
    ----------
    name : str
        Name of the scheme, case-insensitive. A name ``base+composition``, such as ``hk+kahan-li8``, is a composition of
        the scheme ``base`` (see ``topcli.schemes.compose``).
    top : str
        Name under which schemes are registered for the top (``Top.form``), such as ``euler`` or ``lagrange/inertial``.

    Returns
    -------
    Scheme
        Registered or composed scheme.

    Raises
    ------
    UnknownNameError
        If there is no such scheme. The message suggests the nearest names.
    SchemeMisfitError
        If the scheme exists but does not fit the top. The message says why.
    UsageError
        If the scheme ``base`` cannot be composed.
    """
    base, plus, composition = name.lower().partition("+")
    if top not in TOPS:
        raise UnknownNameError(f"unknown top {quoted(top)}")
    cls = TOPS[top]
    _load(base)
    if base in MODULES and not _candidates(base, cls):
        _load()
    candidates = _candidates(base, cls)
    if not candidates:
        raise _not_found(base, cls)
    plain = _bound(candidates[0], cls)
    if not plus:
        return plain
    symmetric = find_composition(composition)
    try:
        return _bound(candidates[0], cls, symmetric)
    except UsageError as error:
        others = ", ".join(composable_names(top)) or "none"
        raise UsageError(f"{error}; schemes for {TOPS.called(top)} that can be: {others}") from None


def _not_found(name: str, cls: type[Top]) -> UsageError:
    """Error for a scheme that does not exist, or not for this top."""
    names = names_for(cls.form)
    if instead := successor(f"scheme {name}"):
        return UnknownNameError(f"there is no scheme {name!r} any more; {instead}")
    reasons = dict.fromkeys(misfit(declaration, cls) for declaration in SCHEMES.get(name, ()))
    if reasons:
        return SchemeMisfitError(
            f"scheme {quoted(name)} does not fit top {TOPS.called(cls.form)!r}; {'; '.join(reasons)}; "
            f"schemes for {TOPS.called(cls.form)}: {', '.join(names) or 'none'}"
        )
    failures = require_plugin(name, "scheme")
    return UnknownNameError(f"unknown scheme {quoted(name)}; {nearest(name, names)}", *failures)


def names_for(top: str) -> list[str]:
    """Return the names of the schemes for the form ``top`` of a top."""
    _load()
    return sorted(name for name in SCHEMES if _candidates(name, TOPS[top]))


def schemes_of(form: str) -> tuple[Scheme, ...]:
    """Return the schemes of one form of a top, also of one that a config declares, sorted by name."""
    cls = TOPS[form]
    return tuple(_bound(_candidates(name, cls)[0], cls) for name in names_for(form))


def all_schemes() -> tuple[Scheme, ...]:
    """Return the schemes of all tops, sorted by top and name, except tops that are defined in configs."""
    return tuple(scheme for form in sorted(TOPS) for scheme in schemes_of(form))


def composable_names(form: str) -> list[str]:
    """Return the names of the schemes for the given form of a top that can be composed."""
    return [scheme.name for scheme in schemes_of(form) if not composition_obstacle(scheme)]


class SchemeMisfitError(UsageError):
    """The scheme exists but does not fit the requested top (exit code 2)."""
