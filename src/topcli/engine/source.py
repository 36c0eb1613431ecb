"""Functions that a compiled step can call, and their copies for the compiler.

Kernels are plain Python functions that call each other by a global or closed-over name, or as attributes of a module.
``fingerprint`` follows the same names.
"""

from __future__ import annotations

import sys
import types
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from topcli.errors import SchemeCodeError

VERSIONED = frozenset(("llvmlite", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "pydantic", "scipy"))
"""Packages whose functions are identified by name: their versions are part of the key or are recorded with the run."""

_STANDARD_LIBRARY = str(Path(types.__file__).parent)


@cache
def is_versioned(module: str) -> bool:
    """True if a module belongs to the standard library or to a package of ``VERSIONED``.

    A user's file that has the name of a module of the standard library does not.
    """
    package = module.partition(".")[0]
    if package in VERSIONED or package == "builtins":
        return True
    if package not in sys.stdlib_module_names or package == "__main__":
        return False
    file = getattr(sys.modules.get(package), "__file__", None)
    return file is None or (str(file).startswith(_STANDARD_LIBRARY) and not is_installed(module))


def is_installed(module: str) -> bool:
    """True if the package of a module was installed by a package manager."""
    file = getattr(sys.modules.get(module.partition(".")[0]), "__file__", None)
    return file is not None and not {"site-packages", "dist-packages"}.isdisjoint(Path(file).parts)


def plain_function(value: object) -> types.FunctionType | None:
    """``value`` as a plain Python function: itself, or the one that a numba dispatcher wraps; else None."""
    if isinstance(value, types.FunctionType):
        return value
    if isinstance(value, type | types.ModuleType):
        return None
    value = getattr(value, "py_func", None)
    return value if isinstance(value, types.FunctionType) else None


def place_of(function: Callable[..., Any]) -> str:
    """File and line of a function, for messages; of another callable, its ``repr``."""
    known = plain_function(function)
    return f"{known.__code__.co_filename}:{known.__code__.co_firstlineno}" if known else repr(function)


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


def used_names(function: types.FunctionType) -> set[str]:
    """Names of the globals that the bytecode loads and of its closed-over variables.

    Fewer than ``names_in``, but slower to find.
    """
    import dis

    names = set(function.__code__.co_freevars)
    codes = [function.__code__]
    for code in codes:
        codes += [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
        names.update(step.argval for step in dis.get_instructions(code) if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"))
    return names


def references(function: types.FunctionType) -> dict[str, Any]:
    """Globals and closed-over variables of a function by name; builtins are left out."""
    scope = function.__globals__
    values = {name: scope[name] for name in names_in(function) if name in scope}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            values[name] = cell.cell_contents
        except ValueError:  # a variable without a value
            values.pop(name, None)
    return values


class Copier:
    """Copies of functions in which everything that they call is compiled.

    A subclass may replace constants and code as well (``engine.precise``).
    """

    def __init__(self, compiler: Callable[[types.FunctionType], Any], done: dict[int, Any]) -> None:
        self.compiler, self.done = compiler, done
        self.open: set[int] = set()

    def compiled(self, value: object, names: list[str]) -> Any:
        """Form of ``value`` that compiled code may refer to; of a module, the attributes ``names`` are used."""
        if isinstance(value, types.ModuleType):
            return self._module(value, names)
        inner = plain_function(value)
        if inner is None:
            return value
        if id(inner) not in self.done:
            if id(inner) in self.open:
                raise SchemeCodeError(f"{place_of(inner)}: {inner.__name__} calls itself; a step cannot be recursive")
            self.done[id(inner)] = self.compiler(self.copy(inner))
        return self.done[id(inner)]

    def referred(self, function: types.FunctionType, name: str, value: object, names: list[str]) -> Any:
        """Form of ``value``, the global or closed-over variable ``name`` of a function."""
        return self.compiled(value, names)

    def code(self, code: types.CodeType) -> types.CodeType:
        """Code of the copy."""
        return code

    def _module(self, module: types.ModuleType, names: list[str]) -> types.ModuleType:
        """The module itself, or one like it where functions among the ``names`` are compiled."""
        if is_versioned(module.__name__) or id(module) in self.open:
            return module
        self.open.add(id(module))
        used = {name: getattr(module, name) for name in names if hasattr(module, name)}
        ready = {name: self.compiled(value, names) for name, value in used.items()}
        self.open.remove(id(module))
        if all(ready[name] is used[name] for name in used):
            return module
        stand_in = types.ModuleType(module.__name__)
        stand_in.__dict__.update({**vars(module), **ready})
        return stand_in

    def copy(self, function: types.FunctionType) -> types.FunctionType:
        """The function with compiled references, defaults included."""
        self.open.add(id(function))
        names, used = names_in(function), used_names(function)
        refers = {n: self.referred(function, n, v, names) for n, v in references(function).items() if n in used}
        defaults = tuple(self.compiled(value, names) for value in function.__defaults__ or ()) or None
        self.open.remove(id(function))
        cells = tuple(types.CellType(*_cell_content(refers, name)) for name in function.__code__.co_freevars)
        scope = {**function.__globals__, **refers}
        made = types.FunctionType(self.code(function.__code__), scope, function.__name__, defaults, cells or None)
        made.__kwdefaults__ = function.__kwdefaults__
        return made


def require_no_raise(function: types.FunctionType) -> None:
    """Raise SchemeCodeError for a function that raises or asserts, which compiled code cannot pass on."""
    import dis

    for step in dis.get_instructions(function):
        if step.opname in ("RAISE_VARARGS", "LOAD_ASSERTION_ERROR"):
            raise SchemeCodeError(
                f"{place_of(function)}: {function.__name__} raises or asserts, which compiled code cannot; return nan "
                "from a step that fails, or set Stepper(..., plain=True)"
            )


def _cell_content(refers: dict[str, Any], name: str) -> tuple[Any, ...]:
    """Content of a variable's closure cell; empty for a variable without a value."""
    return (refers[name],) if name in refers else ()


def compilable_copy(
    function: Callable[..., Any],
    compiler: Callable[[types.FunctionType], Any],
    replace: dict[int, Any] | None = None,
) -> types.FunctionType:
    """Copy of ``function`` in which every reachable kernel is replaced by ``compiler(kernel)``.

    The originals stay plain Python. Raises SchemeCodeError for a kernel that calls itself.
    """
    plain = plain_function(function)
    if plain is None:
        raise TypeError(f"{function!r} is not a Python function: the engine compiles plain functions")
    return Copier(compiler, {} if replace is None else replace).copy(plain)
