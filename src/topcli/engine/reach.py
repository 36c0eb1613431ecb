"""Reach of a function: the names that it mentions, what they refer to, and a digest of all of that.

The digest tells apart the functions whose machine code may differ: numba makes it from the bytecode with its constants,
the values of globals, closed-over variables, defaults and attributes of modules, which it freezes, and from the types
of the arguments.
"""

from __future__ import annotations

import hashlib
import sys
import sysconfig
import types
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from topcli.errors import SchemeCodeError

VERSIONED = frozenset(("llvmlite", "numba", "numpy"))
"""Packages whose functions are identified by name: their versions are part of the digest."""
_STANDARD_LIBRARY = sysconfig.get_path("stdlib")
_PLAIN = frozenset((int, float, complex, bool, str, bytes, type(None), type(...)))


def place_of(function: Callable[..., Any]) -> str:
    """File and line of a function, for messages; of another callable, its ``repr``."""
    code = getattr(function, "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}" if code else repr(function)


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)
        elif isinstance(constant, str) and "getattr" in code.co_names:
            yield constant


def names_in(function: types.FunctionType) -> list[str]:
    """Sorted names of all globals and attributes that the function mentions."""
    return sorted(set(_names(function.__code__)))


def references(function: types.FunctionType) -> dict[str, Any]:
    """Globals and closed-over variables of a function by name; builtins are left out."""
    scope = function.__globals__
    values = {name: scope[name] for name in names_in(function) if name in scope}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        values.pop(name, None)
        with suppress(ValueError):  # a variable without a value
            values[name] = cell.cell_contents
    return values


@cache
def is_standard(module: str) -> bool:
    """True for the standard library, but not for a user's file of such a name, and for ``VERSIONED`` packages."""
    package = module.partition(".")[0]
    if package in VERSIONED or package == "builtins":
        return True
    file = getattr(sys.modules.get(package), "__file__", None)
    return package in sys.stdlib_module_names and (file is None or file.startswith(_STANDARD_LIBRARY))


def home_of(function: types.FunctionType) -> str:
    """Name of the module of a function; ``__module__`` may be that of a function which it wraps."""
    return str(function.__globals__.get("__name__") or "")


def _is_named(value: Any) -> bool:
    """True for a function or class that its name and the version of its package identify."""
    module = getattr(value, "__module__", None) or type(value).__module__
    belongs_to = getattr(value, "__self__", None)  # of a builtin function its module, of a method an object
    named = isinstance(getattr(value, "__name__", None), str)
    return callable(value) and named and is_standard(module) and isinstance(belongs_to, types.ModuleType | None)


class _Walk:
    """A digest under construction; ``functions`` are the plain ones met so far, in the order of their numbers."""

    def __init__(self) -> None:
        self.sha = hashlib.sha256()
        self.functions = dict[types.FunctionType, int]()

    def text(self, *words: object) -> None:
        """Add words; the length keeps neighbouring texts apart."""
        data = " ".join(map(str, words)).encode(errors="surrogatepass")
        self.sha.update(b"%d:" % len(data) + data)

    def put(self, value: Any, place: str = "") -> None:
        """Add a value by its content. Raises SchemeCodeError for one that has none, after its ``place``."""
        kind = type(value)
        if kind in _PLAIN:
            self.text(kind.__name__, repr(value))
        elif isinstance(value, tuple):
            self.text(kind.__qualname__, getattr(value, "_fields", ""), len(value))
            for item in value:
                self.put(item, place)
        elif kind is frozenset:  # a constant of code
            self.text("frozenset", sorted(map(repr, value)))
        elif isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            layout = "C" if value.flags.c_contiguous else "F" if value.flags.f_contiguous else "A"
            self.text(kind.__name__, np.dtype(value.dtype).descr, value.shape, layout)
            self.text(hashlib.sha256(value.tobytes()).hexdigest())
        elif isinstance(value, types.CodeType):
            self.text(value.co_code.hex(), value.co_flags, value.co_argcount, value.co_kwonlyargcount)
            self.text(value.co_names, value.co_varnames, value.co_freevars, value.co_exceptiontable.hex())
            self.put(value.co_consts)
        elif isinstance(value, types.FunctionType) and not is_standard(home_of(value)):
            again = value in self.functions  # or on the way to itself
            self.text("function", again, self.functions.setdefault(value, len(self.functions)))
            if not again:
                self._function(value)
        elif isinstance(value, types.ModuleType):
            self.text("module", value.__name__)
        elif _is_named(value):
            self.text(kind.__name__, getattr(value, "__module__", ""), value.__name__)  # pyright: ignore[reportAttributeAccessIssue]
        else:
            raise SchemeCodeError(
                f"{place}, which is or holds a {kind.__name__}; "
                "compiled code takes numbers, strings, tuples, arrays, functions and modules of them"
            )

    def _function(self, function: types.FunctionType) -> None:
        """Add the content of a function: its code, and the values that it refers to."""
        self.put(function.__code__)
        named = {"default arguments": function.__defaults__, **(function.__kwdefaults__ or {}), **references(function)}
        for name, value in named.items():
            place = f"{place_of(function)}: {function.__name__} refers to {name!r}"
            self._named(name, value, place, names_in(function), ())

    def _named(self, name: str, value: Any, place: str, names: list[str], inside: tuple[Any, ...]) -> None:
        """Add a value and its name; of a module of a user, the attributes with the ``names`` that a function has."""
        self.text(name)
        self.put(value, place)
        if isinstance(value, types.ModuleType) and not is_standard(value.__name__) and value not in inside:
            for attribute in names:
                if hasattr(value, attribute):
                    self._named(attribute, getattr(value, attribute), place, names, (*inside, value))


def reach(*values: Any) -> tuple[str, Collection[types.FunctionType]]:
    """Digest of values by their content: of functions, their code and all that it refers to; and these functions.

    The plain functions that compiled code of the values can call are those, the values included. Raises
    SchemeCodeError naming a value that compiled code cannot refer to.
    """
    walk = _Walk()
    walk.put(values)
    return walk.sha.hexdigest(), walk.functions.keys()
