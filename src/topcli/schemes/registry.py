"""Registry of schemes: the decorator that registers them, and functions that find them, also in plugins."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial, wraps
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel

from topcli.contracts import Block, Floats, Integrability, Invariant, Method, NoOptions, Sampler, Scheme, Stepper, Top
from topcli.errors import SchemeCodeError, UnknownNameError, UsageError, nearest, quoted
from topcli.schemes.compose import compose, find_composition, obstacle
from topcli.schemes.plugins import (
    PLUGIN_FILE,
    FromSource,
    PluginFailure,
    PluginFile,
    built_in_modules,
    failed_plugin,
    import_plugin,
    is_built_in,
    known_failures,
    modules_beside,
    one_at_a_time,
    origin_of,
    plugin_failures,
    registry,
    users_error,
)
from topcli.tops import CATALOGUE, TOPS

Build = Callable[[Any, Any], Method]


def scheme(
    name: str,
    *,
    top: str | Iterable[str] | None,
    title: str,
    order: int | None,
    explicit: bool,
    self_adjoint: bool,
    citation: str,
    equations: str,
    conserves: Iterable[str] | Callable[[Top], Iterable[str]] = (),
    options: type[BaseModel] = NoOptions,
    modified: Callable[[Any, float, Any], tuple[Invariant, ...]] | None = None,
    adaptive: bool = False,
    limits: Mapping[str, str] | Callable[[Top], Mapping[str, str]] = MappingProxyType({}),
    longest_step: Callable[[Any, Floats, Any], float] | None = None,
    order_with: Callable[[Any], int | None] | None = None,
    formula: str = "",
    integrable: Integrability | Callable[[Top], Integrability | None] | None = None,
    later: Callable[[Top], object] | None = None,
) -> Callable[[Build], Build]:
    """Register the decorated function ``build(top, options)`` as a scheme.

    ``build`` returns the method for one top: a ``Stepper``, a ``Sampler`` (closed-form solution) or a ``Block`` (with
    its own time loop) of ``topcli.contracts``. The docstring of ``build`` is the description of the scheme. The other
    arguments declare properties of the scheme, which ``topcli check`` tests. Times and states are dimensionless.

    Parameters
    ----------
    name : str
        Name of the scheme in configs. It is case-insensitive and contains no ``+``. Schemes of different tops may have
        the same name.
    top : str, iterable of str, or None
        Name (``Top.form``) of the top that the scheme integrates, or names of several; None for every top.
    title : str
        Title on one line.
    order : int or None
        Order of convergence; None for an exact solution, or if the order follows from a tolerance.
    explicit : bool
        True if a step needs no iteration.
    self_adjoint : bool
        True if a step with -h inverts a step with h. Steps of a self-adjoint scheme of order 2 can be composed into
        a scheme of higher order.
    citation : str
        Source of the method.
    equations : str
        Numbers of the equations in the source, or the formula of the step.
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
    limits : mapping of str to str or callable, optional
        Conditions under which the scheme fails, each with the reason in a sentence, or a function ``limits(top)`` that
        returns this mapping. A key may be the name of a hard case; ``topcli stress`` then tests that the scheme fails
        this case.
    longest_step : callable, optional
        ``longest_step(top, y0, options)`` returns the largest ``abs(h)`` with which the scheme can start from ``y0``. A
        single run with a larger step size is refused before it starts. In an ensemble, ``step`` of the ``Stepper`` must
        return nan for such an h.
    order_with : callable, optional
        ``order_with(options)`` returns the order, if it depends on the options; ``order`` is then the order with the
        default options.
    formula : str, optional
        Step in LaTeX for the documentation: display formulas without delimiters, separated by empty lines.
    integrable : Integrability or callable, optional
        Lax pair and Poisson bracket if the step is an integrable map, or a function ``integrable(top)`` that returns
        them, or None if the step is not integrable.
    later : callable, optional
        ``later(top)`` returns True if the scheme also integrates ``top``. Otherwise it returns False or raises
        UsageError with the reason. It is called with tops of the catalogue, and with tops that are registered later,
        for example from a user's file. With ``top=None`` and without ``later``, the scheme integrates all these tops.

    Returns
    -------
    callable
        Decorator that registers the function and returns it unchanged.

    Raises
    ------
    ValueError
        If ``build`` has no docstring, if the name contains ``+``, if the options have a field ``compose``, if the top
        is unknown, or if the name is already registered for the top.

    Examples
    --------
    >>> import topcli
    >>> from topcli.contracts import Stepper
    >>> from topcli.tops.euler import field
    >>> def step(y, h, p):
    ...     f = field(y, p)
    ...     return (y[0] + h * f[0], y[1] + h * f[1], y[2] + h * f[2])
    >>> @topcli.scheme("euler-rule", top="euler", title="Euler's rule", order=1, explicit=True, self_adjoint=False,
    ...                citation="Euler 1768", equations="y' = y + h f(y)")
    ... def build(top, options):
    ...     '''Euler's rule, the simplest scheme.'''
    ...     return Stepper(step, 3)
    >>> build(None, None).step((1.0, 2.0, 3.0), 0.5, (3.0, 2.0, 1.0, 1.0, -2.0, 1.0))
    (4.0, -1.0, 4.0)
    """
    every = [form for form in TOPS if form not in CATALOGUE]
    forms = every if top is None else (top,) if isinstance(top, str) else tuple(top)

    def register(build: Build) -> Build:
        origin = origin_of(build)
        declared = partial(
            Scheme,
            name=name.lower(),
            title=title,
            order=order,
            explicit=explicit,
            self_adjoint=self_adjoint,
            citation=citation,
            equations=equations,
            build=build if origin == "topcli" else _checked(build, name.lower()),
            options=options,
            adaptive=adaptive,
            longest_step=longest_step,
            doc=_description(name, title, build, options),
            origin=origin,
            order_with=order_with,
            formula=formula,
        )

        def register_for(form: str, modified: Any = modified) -> None:
            _require_free(name, form, origin)
            kept = tuple(conserves(TOPS[form].new()) if callable(conserves) else conserves)
            if origin != "topcli":
                _require_invariants(name, form, kept)
            registry.schemes[name.lower(), form] = declared(
                top=form,
                conserves=kept,
                limits=dict(limits(TOPS[form].new()) if callable(limits) else limits),
                integrable=integrable(TOPS[form].new()) if callable(integrable) else integrable,
                modified=modified,
            )

        def register_later(form: str) -> None:
            top = TOPS[form].new()
            if later is None or later(top):
                declared = top.integrals_of(name.lower(), 1.0)
                register_for(form, modified or (_declared_by_top(name.lower()) if declared else None))

        for form in forms:
            register_for(form)
        if top is None or later:
            registry.for_every_top[name.lower()] = register_later
            if origin != "topcli":  # those of the built-in schemes are registered when they are needed
                for form in CATALOGUE:
                    registry.complete(form, name.lower())
        return build

    return register


def _declared_by_top(name: str) -> Callable[[Top, float, Any], tuple[Invariant, ...]]:
    """Integrals of the scheme ``name`` that each top declares (``Top.integrals_of``)."""
    return lambda top, h, options: top.modified_invariants(name, h)


def _description(name: str, title: str, build: Build, options: type[BaseModel]) -> str:
    """Description of a scheme: the docstring of ``build``. Raises ValueError for a declaration that cannot be used."""
    doc = build.__doc__ or (title if sys.flags.optimize >= 2 else "")  # python -OO removes docstrings
    if not doc:
        raise ValueError(f"scheme {name!r} has no docstring")
    if "+" in name or "compose" in options.model_fields:
        raise ValueError(f"scheme {name!r}: '+' in a name and an option 'compose' are reserved for compositions")
    return inspect.cleandoc(doc)


def _require_free(name: str, form: str, origin: str) -> None:
    """Raise ValueError if there is no such top, or if it has a scheme of this name.

    A scheme of topcli for a top from outside may be replaced by one from outside.
    """
    known = registry.schemes.get((name.lower(), form))
    if known and (origin == "topcli" or known.origin != "topcli" or is_built_in(TOPS[form])):
        raise ValueError(f"scheme {name!r} for top {form!r} is already registered by {known.origin}")
    if form not in TOPS:
        raise ValueError(f"scheme {name!r}: unknown top {form!r}; {nearest(form, TOPS)}")


def _require_invariants(name: str, form: str, conserved: Iterable[str]) -> None:
    """Raise ValueError for a conserved quantity that is not an invariant of the top."""
    known = [invariant.name for invariant in TOPS[form].new().invariants()]
    for one in conserved:
        if one not in known:
            raise ValueError(f"scheme {name!r} conserves {one!r}, no invariant of top {form!r}; {nearest(one, known)}")


def _declared() -> list[str]:
    """Forms of the tops that are declared by formulas, in topcli or in a config; schemes find them when needed."""
    return [*CATALOGUE, *TOPS.declared]


def _likely_first(name: str, top: str) -> list[str]:
    """Return the built-in modules, starting with those named after the scheme, then those in the package of its top."""
    words, family = set(name.split("-")), re.split(r"[+/]", top)[0]

    def rank(module: str) -> tuple[bool, bool, bool]:
        folder, stem = module.split(".")[-2:]
        return words.isdisjoint(stem.split("_")), folder != family, folder != "any_top"

    return sorted(built_in_modules(), key=rank)


def _checked(build: Build, name: str) -> Build:
    """``build`` of a scheme from outside, with errors that name its file and line."""

    @wraps(build)
    def checked(top: Any, options: Any) -> Method:
        try:
            method = build(top, options)
        except Exception as error:
            raise (users_error(error) or error) from error
        if not isinstance(method, Stepper | Sampler | Block):
            code = inspect.unwrap(build).__code__
            raise SchemeCodeError(
                f"{code.co_filename}:{code.co_firstlineno}: scheme {name!r} is built as {type(method).__name__}; "
                "return a Stepper, a Sampler or a Block"
            )
        return method

    return checked


@cache
def load_plugin_file(path: Path) -> None:
    """Import the schemes of a Python file (``--plugin``), which may import modules that lie beside it.

    Raises UsageError if the file cannot be read or imported, or registers nothing.
    """
    plugin_failures()
    if not os.path.isfile(path):  # False also for what cannot be a path
        raise UsageError(f"plugin {path}: no such file")
    name = PLUGIN_FILE + hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]
    spec = importlib.util.spec_from_file_location(name, path, loader=FromSource(name, str(path)))
    if spec is None or spec.loader is None:
        raise UsageError(f"plugin {path}: not a Python file (expected a name ending in .py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    loader = spec.loader
    if registry.before_files is None:
        registry.before_files = registry.snapshot()
    folder = path.resolve().parent
    with modules_beside(folder) as imported:
        found = import_plugin(str(path), str(path), lambda: loader.exec_module(module))
    if isinstance(found, PluginFailure):
        placed = found.reason.startswith(str(path))
        raise UsageError(found.reason if placed else f"plugin {path}: {found.reason}")
    if not found:
        raise UsageError(
            f"plugin {path}: registers nothing; decorate a class with @topcli.top, or a function with "
            "@topcli.scheme(...) or @topcli.measure(...)"
        )
    files = [file for file in imported.values() if file]
    content = {
        path.name: path.read_bytes(),
        **{file.relative_to(folder).as_posix(): file.read_bytes() for file in files},
    }
    registry.files.append(PluginFile(str(path), str(folder), content, frozenset((name, *imported))))


def loaded_plugin_files() -> tuple[PluginFile, ...]:
    """Plugin files that have been loaded, in that order."""
    return tuple(registry.files)


def unload_plugin_files() -> None:
    """Forget what plugin files have registered."""
    if registry.before_files is not None:
        registry.restore(registry.before_files)
        registry.before_files = None
    registry.files.clear()
    load_plugin_file.cache_clear()


@one_at_a_time
def all_schemes() -> tuple[Scheme, ...]:
    """Return all registered schemes, sorted by top and name, except those for tops that are defined in configs."""
    plugin_failures()
    for form in CATALOGUE:
        registry.complete(form)
    schemes = registry.schemes
    for key in sorted(schemes, key=lambda key: (key[1], key[0])):
        schemes[key] = schemes.pop(key)  # digests of code that uses the table must not depend on the order of imports
    return tuple(scheme for scheme in schemes.values() if scheme.top not in TOPS.declared)


def schemes_of(form: str) -> tuple[Scheme, ...]:
    """Return the schemes of one form of a top, also of one that a config declares, sorted by name."""
    return tuple(registry.schemes[name, form] for name in names_for(form))


@one_at_a_time
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
        If the scheme exists but does not fit the top. The message names the tops that it fits.
    UsageError
        If the scheme ``base`` cannot be composed.
    """
    base, plus, composition = name.rpartition("+")
    if plus:
        return composed(find_scheme(base, top), composition)
    key = (name.lower(), top)
    # names are unique: once a module has registered this one, the others need not be imported
    for module in _likely_first(*key):
        import_module(module)
        if top in _declared():
            registry.complete(top, key[0])
        if key in registry.schemes:
            return registry.schemes[key]
    failure = failed_plugin(name.lower())
    if key in registry.schemes:
        return registry.schemes[key]
    if failure:
        return _stand_in(name.lower(), top, failure)
    plugin_failures()
    if key in registry.schemes:
        return registry.schemes[key]
    fits = sorted(scheme.top for scheme in all_schemes() if scheme.name == name.lower())
    if fits:
        reason = _misfit(name.lower(), top) or f"it fits {', '.join(fits)}"
        raise SchemeMisfitError(
            f"scheme {quoted(name)} does not fit top {TOPS.called(top)!r}; {reason}; "
            f"schemes for {TOPS.called(top)}: {', '.join(names_for(top)) or 'none'}"
        )
    raise UnknownNameError(
        f"unknown scheme {quoted(name)}; {nearest(name, names_for(top))}", *map(str, known_failures()[:2])
    )


def _stand_in(name: str, form: str, failure: PluginFailure) -> Scheme:
    """Scheme called ``name`` whose plugin has failed: it cannot be built, and the reason is that of the plugin."""

    def build(top: Top, options: NoOptions) -> Method:
        raise SchemeCodeError(f"scheme {name!r}: {failure}")

    words = "scheme of a plugin that failed"  # with an order, so that no study leaves it out
    return Scheme(name, form, words, 1, False, False, (), "", "", build, doc=words, origin=failure.origin)


def _misfit(name: str, form: str) -> str:
    """Reason why a scheme for every top does not integrate a declared one; empty for other schemes and tops."""
    if name not in registry.for_every_top or form not in TOPS:
        return ""
    if is_built_in(TOPS[form]) and form not in _declared():
        return ""
    try:
        registry.for_every_top[name](form)
    except UsageError as error:
        return str(error)
    return ""


def composed(base: Scheme, name: str) -> Scheme:
    """Compose ``base`` by the composition ``name``; the error message lists the schemes that can be composed."""
    find_composition(name)
    if reason := obstacle(base):
        raise UsageError(
            f"scheme {base.name!r} cannot be composed: it {reason}; "
            f"schemes for {TOPS.called(base.top)} that can be: {', '.join(composable_names(base.top)) or 'none'}"
        )
    return compose(base, name)


def composable_names(form: str) -> list[str]:
    """Return the names of the schemes for the given form of a top that can be composed."""
    return [scheme.name for scheme in schemes_of(form) if not obstacle(scheme)]


@one_at_a_time
def names_for(top: str) -> list[str]:
    """Return the names of the schemes for the form ``top`` of a top."""
    plugin_failures()
    if top in _declared():
        registry.complete(top)
    return sorted(name for name, kind in registry.schemes if kind == top)


class SchemeMisfitError(UsageError):
    """The scheme exists but does not fit the requested top (exit code 2)."""
