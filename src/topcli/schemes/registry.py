"""The registry of schemes: one decorator to register, one function to look up, plugins by entry point or file."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import pkgutil
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, wraps
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel

from topcli.contracts import Block, Invariant, Method, NoOptions, Sampler, Scheme, Stepper, Top
from topcli.errors import SchemeCodeError, UnknownNameError, UsageError, nearest, quoted
from topcli.schemes.compose import compose, find_composition, obstacle
from topcli.schemes.user_code import ENTRY_POINT_GROUP, FromSource, modules_beside, reason_of, users_error, users_place
from topcli.tops import TOPS

Build = Callable[[Any, Any], Method]

_schemes: dict[tuple[str, str], Scheme] = {}
_for_every_top: dict[str, Callable[[str], None]] = {}
"""By the name of each scheme declared for every top: what registers it for one form, of a top that comes in later."""
_origin = "topcli"


@dataclass(frozen=True)
class PluginFailure:
    """A plugin that could not be imported: its name and the reason, in one line."""

    name: str
    reason: str


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
) -> Callable[[Build], Build]:
    """Register ``build(top, options) -> Method`` as the scheme ``name`` of ``top``.

    ``top`` is a form of a top, several of them, or None for every one; one name may also serve several tops with a
    decorated function each. ``conserves`` names invariants, or gives them for a top; ``limits`` says in which hard
    cases or under which conditions the scheme fails, and why, or gives that for a top. The docstring of the function
    documents the scheme. Raises ValueError for a name already taken for a top or with a +, or a missing docstring.
    """
    forms = TOPS if top is None else (top,) if isinstance(top, str) else tuple(top)
    origin = _origin

    def register(build: Build) -> Build:
        doc = build.__doc__ or (title if sys.flags.optimize >= 2 else "")  # python -OO removes docstrings
        if not doc:
            raise ValueError(f"scheme {name!r} has no docstring")
        if "+" in name or "compose" in options.model_fields:
            raise ValueError(f"scheme {name!r}: a + in a name and an option 'compose' stand for compositions")
        doc = inspect.cleandoc(doc)

        def register_for(form: str) -> None:
            key = (name.lower(), form)
            if key in _schemes:
                raise ValueError(f"scheme {name!r} for top {form!r} is already registered by {_schemes[key].origin}")
            if form not in TOPS:
                raise ValueError(f"scheme {name!r}: no top {form!r}; {nearest(form, TOPS)}")
            _schemes[key] = Scheme(
                name=name.lower(),
                top=form,
                title=title,
                order=order,
                explicit=explicit,
                self_adjoint=self_adjoint,
                conserves=tuple(conserves(TOPS[form].new()) if callable(conserves) else conserves),
                citation=citation,
                equations=equations,
                build=build if origin == "topcli" else _checked(build, name.lower()),
                options=options,
                modified=modified,
                adaptive=adaptive,
                limits=dict(limits(TOPS[form].new()) if callable(limits) else limits),
                doc=doc,
                origin=origin,
            )

        for form in forms:
            register_for(form)
        if top is None:
            _for_every_top[name.lower()] = register_for
        return build

    return register


@cache
def _modules() -> tuple[str, ...]:
    """Names of the built-in modules that may register schemes: all that lie in a folder beside this file."""
    root = Path(__file__).parent
    return tuple(
        f"topcli.schemes.{folder.name}.{module.name}"
        for folder in pkgutil.iter_modules([str(root)])
        if folder.ispkg
        for module in pkgutil.iter_modules([str(root / folder.name)])
    )


def _likely_first(name: str, top: str) -> list[str]:
    """``_modules()``, first those named after the scheme, then those in the folder of its top."""
    file, family = name.replace("-", "_"), re.split(r"[+/]", top)[0]

    def rank(module: str) -> tuple[bool, bool]:
        folder, stem = module.split(".")[-2:]
        return file not in (folder, stem), folder != family

    return sorted(_modules(), key=rank)


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


def _import_plugin(name: str, origin: str, load: Callable[[], object]) -> PluginFailure | None:
    """Import one plugin whole or not at all: what a failing one had registered is taken back."""
    global _origin
    tables: list[dict[Any, Any]] = [_schemes, TOPS, _for_every_top]
    before, previous = [dict(table) for table in tables], _origin
    _origin = origin
    try:
        load()
        for form in TOPS.keys() - before[1].keys():
            for known, register_for in before[2].items():
                if (known, form) not in _schemes:  # the plugin may bring its own
                    register_for(form)
    except (KeyboardInterrupt, MemoryError):
        raise
    except BaseException as error:  # a plugin may do anything, even exit; it must not take us along
        for table, kept in zip(tables, before, strict=True):
            table.clear()
            table.update(kept)
        place = users_place(error)
        return PluginFailure(name, reason_of(error) + (f" ({place})" if place else ""))
    finally:
        _origin = previous
    return None


@cache
def plugin_failures() -> tuple[PluginFailure, ...]:
    """Import the built-in schemes and the plugins of the entry-point group; the plugins that failed."""
    for module in _modules():
        import_module(module)
    failures = []
    found: list[EntryPoint] = sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda entry: entry.name)
    for entry in found:
        origin = entry.dist.name if entry.dist else entry.name
        failure = _import_plugin(entry.name, origin, entry.load)
        if failure:
            failures.append(failure)
    return tuple(failures)


@cache
def load_scheme_file(path: Path) -> None:
    """Import the schemes of a Python file (``--scheme-file``), which may import modules that lie beside it.

    Raises UsageError when the file cannot be read or imported, or registers nothing.
    """
    plugin_failures()
    if not os.path.isfile(path):  # False also for what cannot be a path
        raise UsageError(f"scheme file {path}: no such file")
    name = "topcli_scheme_file_" + hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:12]
    spec = importlib.util.spec_from_file_location(name, path, loader=FromSource(name, str(path)))
    if spec is None or spec.loader is None:
        raise UsageError(f"scheme file {path}: not a Python file (expected a name ending in .py)")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    known = len(_schemes)
    loader = spec.loader
    with modules_beside(path.resolve().parent):
        failure = _import_plugin(str(path), str(path), lambda: loader.exec_module(module))
    if failure:
        raise UsageError(f"scheme file {path}: {failure.reason}")
    if len(_schemes) == known:
        raise UsageError(f"scheme file {path}: registers no scheme; decorate a function with @topcli.scheme(...)")


def all_schemes() -> tuple[Scheme, ...]:
    """Every registered scheme, by top and name."""
    plugin_failures()
    for key in sorted(_schemes, key=lambda key: (key[1], key[0])):
        _schemes[key] = _schemes.pop(key)  # digests of code that uses the table must not depend on the order of imports
    return tuple(_schemes.values())


def find_scheme(name: str, top: str) -> Scheme:
    """The scheme called ``name`` (matched without case) for the form ``top`` of a top.

    ``base+composition``, such as ``hk+kahan-li8``, is the scheme ``base`` composed (see ``topcli.schemes.compose``).
    Raises UnknownNameError with the nearest names, SchemeMisfitError naming the tops that the scheme fits, or
    UsageError for a scheme that cannot be composed.
    """
    base, plus, composition = name.rpartition("+")
    if plus:
        return composed(find_scheme(base, top), composition)
    key = (name.lower(), top)
    # names are unique, so the first module that registers this one settles it: the others need not be imported
    for module in _likely_first(*key):
        import_module(module)
        if key in _schemes:
            return _schemes[key]
    plugin_failures()
    if key in _schemes:
        return _schemes[key]
    fits = sorted(kind for known, kind in _schemes if known == name.lower())
    if fits:
        raise SchemeMisfitError(
            f"scheme {quoted(name)} does not fit top {top!r}; it fits {', '.join(fits)}; "
            f"schemes for {top}: {', '.join(names_for(top)) or 'none'}"
        )
    raise UnknownNameError(f"unknown scheme {quoted(name)}; {nearest(name, names_for(top))}")


def composed(base: Scheme, name: str) -> Scheme:
    """``base`` under the composition ``name``, as ``compose`` makes it; its refusal also names schemes that can be."""
    find_composition(name)
    if reason := obstacle(base):
        raise UsageError(
            f"scheme {base.name!r} cannot be composed: it {reason}; "
            f"schemes for {base.top} that can: {', '.join(composable_names(base.top)) or 'none'}"
        )
    return compose(base, name)


def composable_names(form: str) -> list[str]:
    """Names of the registered schemes for the form of a top that can be composed."""
    return [scheme.name for scheme in all_schemes() if scheme.top == form and not obstacle(scheme)]


def names_for(top: str) -> list[str]:
    """Names of the schemes that step the form ``top`` of a top."""
    plugin_failures()
    return sorted(name for name, kind in _schemes if kind == top)


class SchemeMisfitError(UsageError):
    """A scheme that exists but does not step the asked top (exit code 2)."""
