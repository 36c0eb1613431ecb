"""Walk the functions that a kernel can reach: to fingerprint them, and to copy them for the compiler.

Kernels are plain Python functions that call each other by global or closed-over name. The walk follows those
names, so that one fingerprint covers everything that ends up in the machine code: an edit to any kernel
changes it, and machine code made from an earlier text can never be served.
"""

from __future__ import annotations

import builtins
import hashlib
import types
from collections.abc import Callable, Iterator
from typing import Any

_PLAIN = (int, float, complex, bool, str, bytes, type(None))


def plain_function(value: object) -> types.FunctionType | None:
    """``value`` as a plain Python function: itself, or what a numba dispatcher wraps; else None."""
    value = getattr(value, "py_func", value)
    return value if isinstance(value, types.FunctionType) else None


def _names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _names(constant)


def references(function: types.FunctionType) -> dict[str, Any]:
    """What ``function`` refers to by global or closed-over name, builtins left out."""
    found: dict[str, Any] = {}
    for name in sorted(set(_names(function.__code__))):
        if name in function.__globals__ and not hasattr(builtins, name):
            found[name] = function.__globals__[name]
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        found[name] = cell.cell_contents
    return found


def _describe_code(code: types.CodeType) -> str:
    constants = [
        _describe_code(constant) if isinstance(constant, types.CodeType) else repr(constant)
        for constant in code.co_consts
    ]
    return repr((code.co_name, code.co_code.hex(), constants, code.co_names, code.co_varnames, code.co_argcount))


def _describe_value(value: object) -> str:
    if isinstance(value, _PLAIN):
        return f"{type(value).__name__}:{value!r}"
    if isinstance(value, tuple):
        return "(" + ",".join(_describe_value(item) for item in value) + ")"
    return f"{type(value).__module__}.{getattr(value, '__name__', type(value).__name__)}"


def fingerprint(*functions: Callable[..., Any] | None) -> str:
    """A hex digest of the bytecode and constants of ``functions`` and of everything they can reach.

    None stands for an absent function. The digest belongs to one Python version: bytecode differs
    between versions.
    """
    digest = hashlib.sha256()
    seen: dict[int, int] = {}

    def visit(function: types.FunctionType) -> None:
        if id(function) in seen:
            digest.update(f"again {seen[id(function)]};".encode())
            return
        seen[id(function)] = len(seen)
        digest.update(_describe_code(function.__code__).encode())
        for name, value in references(function).items():
            digest.update(f"{name}=".encode())
            inner = plain_function(value)
            if inner is None:
                digest.update(_describe_value(value).encode())
            else:
                visit(inner)

    for function in functions:
        plain = plain_function(function)
        digest.update(b"none;" if plain is None else b"function;")
        if plain is not None:
            visit(plain)
    return digest.hexdigest()


def compilable_copy(
    function: Callable[..., Any],
    compiler: Callable[[types.FunctionType], Any],
    replace: dict[int, Any] | None = None,
) -> types.FunctionType:
    """A copy of ``function`` in which every reachable kernel stands compiled by ``compiler``.

    The originals stay plain Python. Kernels must not be recursive.
    """
    done = {} if replace is None else replace
    plain = plain_function(function)
    if plain is None:
        raise TypeError(f"{function!r} is not a Python function: the engine compiles plain functions")

    def compiled(value: object) -> Any:
        inner = plain_function(value)
        if inner is None:
            return value
        if id(inner) not in done:
            done[id(inner)] = compiler(compilable_copy(inner, compiler, done))
        return done[id(inner)]

    refers = {name: compiled(value) for name, value in references(plain).items()}
    cells = tuple(types.CellType(refers[name]) for name in plain.__code__.co_freevars)
    scope = {**plain.__globals__, **refers}
    return types.FunctionType(plain.__code__, scope, plain.__name__, plain.__defaults__, cells or None)
