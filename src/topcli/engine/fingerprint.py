"""Digest of everything that the machine code or the results of functions can depend on.

The key of stored machine code is this digest with the signature, the versions of topcli, Python, numpy, numba and
llvmlite, the processor and numba's settings. A digest of the compiler's unoptimised intermediate code would be the
surest key, but only numba can form it, and a run whose machine code is known does not import numba. This key suffices
because numba forms that code from nothing else: the bytecode with its constants, the values of globals, closed-over
variables, defaults and attributes of modules, which it freezes, and the types of the arguments, which the signature
fixes. All of these enter by value, through every reachable function, class and module of the user.
The standard library and the packages of ``source.VERSIONED`` are identified by name. A value that has no faithful
description (a lock, an open file, a pointer) is refused by name instead of being ignored.
"""

from __future__ import annotations

import abc
import copyreg
import ctypes
import enum
import functools
import hashlib
import importlib
import importlib.util
import inspect
import sys
import types
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import fields
from opcode import opmap
from pathlib import Path, PurePath
from typing import Any, Generic, Protocol

import numpy as np
from pydantic import BaseModel

from topcli.contracts import Method, Scheme, Stepper, Top, stop_asked
from topcli.engine.source import is_installed, is_versioned, names_in, place_of, plain_function, references, used_names
from topcli.errors import SchemeCodeError
from topcli.schemes.plugins import PLUGIN_FILE, is_built_in
from topcli.schemes.registry import SCHEMES
from topcli.tops import TOPS

_PLAIN = frozenset((int, float, complex, bool, str, bytes, type(None), type(...), type(NotImplemented)))
_WRAPPERS = (staticmethod, classmethod)
_FUNCTIONS = (types.FunctionType, property, functools.cached_property, *_WRAPPERS)
_IMPORT_NAME = opmap["IMPORT_NAME"]
_PACKAGE = str(Path(__file__).parents[1])
_EMPTY = object()
_TRANSPARENT = frozenset(
    (object, int, float, complex, str, bytes, tuple, frozenset, dict, abc.ABC, Generic, Protocol, BaseModel)
)
"""Classes whose objects hold only their attributes and items."""


class _IndescribableError(Exception):
    """A value that cannot be hashed; the message names its kind."""


def _kind(value: object) -> str:
    return f"{type(value).__module__}.{type(value).__qualname__}".removeprefix("builtins.")


def _named_elsewhere(value: object) -> str | None:
    """``package.name`` of an object of a versioned package or the standard library; None for others."""
    module = getattr(value, "__module__", None)
    name = getattr(value, "__qualname__", None) or getattr(value, "__name__", None)
    if not isinstance(module, str) or not isinstance(name, str):
        return None
    if not is_versioned(module):
        return None
    known: Any = sys.modules.get(module)
    for part in name.split("."):
        known = getattr(known, part, _EMPTY)
    return f"{module}.{name}" if known is value else None


class _Walk:
    """A digest under construction; with ``own``, installed packages other than these count by their version."""

    def __init__(self, own: frozenset[str] | None) -> None:
        self.own = own
        self.digest = hashlib.sha256()
        self.seen: dict[int, int] = {}
        self.kept: list[object] = []
        self.open_modules: set[int] = set()

    def put(self, text: str) -> None:
        """Add a piece of text; its length keeps neighbouring pieces apart."""
        data = text.encode(errors="surrogatepass")
        self.digest.update(b"%d:" % len(data))
        self.digest.update(data)

    def by_name(self, module: str) -> bool:
        """True if the content of a module is identified by its name; the version of its package is then added."""
        package = module.partition(".")[0]
        if is_versioned(module):
            return True
        if self.own is None or package in self.own or not is_installed(module):
            return False
        self.put(f"{package} {getattr(sys.modules[package], '__version__', '')}")
        return True

    def met(self, value: object) -> bool:
        """True if ``value`` is in the digest already; then a reference to it is added."""
        number = self.seen.setdefault(id(value), len(self.seen))
        if number < len(self.kept):
            self.put(f"again {number}")
            return True
        self.kept.append(value)  # a freed object's id could be reused
        return False

    def value(self, value: Any) -> None:
        """Add any value. Raises _IndescribableError."""
        kind = type(value)
        if kind in _PLAIN:
            self.put(f"{kind.__name__}:{value!r}")
        elif kind is tuple:
            self._items("tuple", value)
        elif kind is frozenset:
            self._set(value)
        elif isinstance(value, types.CodeType):
            self._code(value)
        elif isinstance(value, types.ModuleType):
            if not is_versioned(value.__name__):
                raise _IndescribableError(f"the module {value.__name__} as a value")
            self.put(f"module {value.__name__}")
        elif kind.__module__ == "gmpy2" and kind.__name__ == "mpz":
            self.put(f"int:{value}")  # mpmath's integers where gmpy2 is installed
        elif isinstance(value, np.dtype):
            self.put(f"dtype {np.dtype(value).descr if value.names else value.str}")
        elif isinstance(value, ctypes._SimpleCData | ctypes._Pointer | ctypes._CFuncPtr | ctypes.Structure):  # pyright: ignore
            raise _IndescribableError(f"{_kind(value)}, an address in this process")
        elif value is stop_asked:
            self.put("stop_asked")  # ends a run, and changes no number
        elif value is SCHEMES or value is TOPS:
            self.put(type(value).__name__)  # schemes and tops that code finds by name count where they are used
        elif not self.met(value):
            self._object(value)

    def _object(self, value: Any) -> None:
        if isinstance(value, list):
            self._items(_kind(value), value)
        elif isinstance(value, set):
            self._set(value)
        elif type(value) is dict or isinstance(value, types.MappingProxyType):
            self._items(_kind(value), [part for item in value.items() for part in item])
        elif isinstance(value, np.ndarray):
            self._array(value)
        elif isinstance(value, np.generic):
            self.put(f"{value.dtype.str} {value.tobytes().hex()}")
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, types.FunctionType):
            self._function(value)
        elif (inner := plain_function(value)) is not None:
            self.put("dispatcher")
            self.value(inner)
        elif isinstance(value, types.MethodType):
            self._items("method", [value.__func__, value.__self__])
        elif isinstance(value, _WRAPPERS):
            self._items(_kind(value), [value.__func__])
        elif isinstance(value, property):
            self._items("property", [value.fget, value.fset])
        elif isinstance(value, types.BuiltinFunctionType):
            owner = value.__self__
            self.put(f"builtin {value.__module__}.{value.__qualname__}")
            if owner is not None and not isinstance(owner, types.ModuleType):
                self.value(owner)
        elif isinstance(value, PurePath):
            self.put(f"path {str(value).removeprefix(_PACKAGE)}")
        elif isinstance(value, functools._lru_cache_wrapper):
            self._items("cached", [value.__wrapped__])
        elif isinstance(value, np.ufunc) and not value.__name__.endswith("(vectorized)"):  # not numpy.frompyfunc's
            self.put(f"ufunc {value.__name__}")
        elif (name := _named_elsewhere(value)) is not None:
            self.put(name)
        elif _kind(value) in ("mpmath.ctx_mp.MPContext", "mpmath.ctx_mp_python.constant"):
            self.value(type(value))  # the rest of it is the precision of the moment and what is cached
            self.put(getattr(value, "name", ""))
        else:
            self._instance(value)

    def _items(self, kind: str, items: Iterable[Any]) -> None:
        items = list(items)
        self.put(f"{kind} {len(items)}")
        for item in items:
            self.value(item)

    def _set(self, items: Iterable[Any]) -> None:
        digests = []
        for item in items:  # in an order that does not depend on the process
            walk = _Walk(self.own)
            walk.value(item)
            digests.append(walk.digest.hexdigest())
        self.put("set " + " ".join(sorted(digests)))

    def _array(self, array: np.ndarray[Any, Any]) -> None:
        layout = "C" if array.flags.c_contiguous else "F" if array.flags.f_contiguous else "A"
        self.put(f"{_kind(array)} {array.shape} {layout}")
        self.value(array.dtype)
        if array.dtype.hasobject:
            self._items("objects", array.ravel().tolist())
        else:
            self.put(hashlib.sha256(array.tobytes()).hexdigest())

    def _code(self, code: types.CodeType) -> None:
        self.put(repr((code.co_name, code.co_flags, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)))
        self.put(repr((code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)))
        self.digest.update(code.co_code + code.co_exceptiontable)
        self._items("constants", code.co_consts)

    def _function(self, function: types.FunctionType) -> None:
        if self.by_name(function.__globals__.get("__name__") or ""):
            self.put(f"function {function.__module__}.{function.__qualname__}")
            return
        names = names_in(function)
        # first, because the import of a submodule adds a global to the functions of its package
        modules = [module for code in _all_codes(function.__code__) for module in _imports(function, code)]
        self._code(function.__code__)
        self._named(function, {"default arguments": function.__defaults__}, names)
        self._named(function, function.__kwdefaults__ or {}, names)
        self._named(function, function.__dict__, names)
        self._named(function, references(function), names)
        for module in modules:
            self._module(module, names)

    def _named(self, function: types.FunctionType, values: dict[str, Any], names: list[str]) -> None:
        """Add the values that a function refers to. Raises SchemeCodeError naming one that cannot be hashed."""
        for name, value in values.items():
            self.put(name)
            try:
                if isinstance(value, types.ModuleType):
                    self._module(value, names)
                else:
                    self.value(value)
            except _IndescribableError as why:
                if (
                    values is not function.__kwdefaults__
                    and name in function.__globals__
                    and name not in used_names(function)
                ):
                    continue  # an attribute has the name of a global
                raise SchemeCodeError(
                    f"{place_of(function)}: {function.__name__} refers to {name!r}, which is or holds {why}; results "
                    "cannot be identified by its value: use numbers, strings, tuples, arrays, functions or modules"
                ) from None

    def _module(self, module: types.ModuleType, names: list[str]) -> None:
        """Add the attributes of a module that a function with these ``names`` may use."""
        self.put(f"module {module.__name__}")
        if id(module) in self.open_modules:
            return
        versioned = self.by_name(module.__name__)
        self.open_modules.add(id(module))
        for name in names:
            value = vars(module).get(name, _EMPTY) if versioned else getattr(module, name, _EMPTY)
            if value is _EMPTY or (versioned and type(value) not in _PLAIN):
                continue
            self.put(name)
            if isinstance(value, types.ModuleType):
                self._module(value, names)
            else:
                try:
                    self.value(value)
                except _IndescribableError as why:
                    raise _IndescribableError(f"{why} ({module.__name__}.{name})") from None
        self.open_modules.remove(id(module))

    def _class(self, kind: type) -> None:
        module = PLUGIN_FILE if kind.__module__.startswith(PLUGIN_FILE) else kind.__module__  # wherever the file lies
        self.put(f"class {module}.{kind.__qualname__}")
        if self.by_name(kind.__module__):
            return
        self._items("bases", kind.__bases__)
        for name, value in sorted(vars(kind).items()):
            private = name.startswith("__") and name.endswith("__")
            if isinstance(value, types.MemberDescriptorType | types.GetSetDescriptorType) or name == "_abc_impl":
                continue
            if private and not isinstance(value, _FUNCTIONS):
                continue
            self.put(name)
            self.value(value)

    def _instance(self, value: Any) -> None:
        """Add an object by its class and content."""
        kind = type(value)
        self.value(kind)
        if isinstance(value, enum.Enum):
            self._items("member", [value._name_, value._value_])
            return
        for base in (int, float, complex, str, bytes):
            if isinstance(value, base):
                held: Any = value
                self.put(base.__repr__(held))
        if isinstance(value, tuple | frozenset):
            self._items("items", list(value))
        if isinstance(value, dict):
            self._items("items", [part for item in value.items() for part in item])
        slots = [(name, getattr(value, name)) for name in copyreg._slotnames(kind) if hasattr(value, name)]  # pyright: ignore
        for name, item in [*sorted(getattr(value, "__dict__", {}).items()), *slots]:
            self.put(name)
            self.value(item)
        if not all(base in _TRANSPARENT or not self.by_name(base.__module__) for base in kind.__mro__):
            self._reduced(value)

    def _reduced(self, value: Any) -> None:
        """Add the state that pickle would store of an object, which may be more than its attributes."""
        try:
            parts = value.__reduce_ex__(2)
        except Exception:
            raise _IndescribableError(f"an object of type {_kind(value)}") from None
        if isinstance(parts, str):
            raise _IndescribableError(f"an object of type {_kind(value)}")
        self._items("reduced", [list(part) if hasattr(part, "__next__") else part for part in parts])


def _imports(function: types.FunctionType, code: types.CodeType) -> list[types.ModuleType]:
    """Modules that a function imports when it runs; only functions that are not compiled do so."""
    if _IMPORT_NAME not in code.co_code[::2]:
        return []
    import dis

    modules = []
    steps = list(dis.get_instructions(code))
    for at, step in enumerate(steps):
        if step.opcode == _IMPORT_NAME:
            dots = "." * int(steps[at - 2].argval or 0)
            with suppress(ImportError, ValueError):
                name = importlib.util.resolve_name(dots + step.argval, function.__globals__.get("__package__"))
                if not is_versioned(name):
                    modules.append(module := importlib.import_module(name))
                    for item in steps[at - 1].argval or ():
                        if not hasattr(module, item):  # a submodule
                            importlib.import_module(f"{name}.{item}")
    return modules


def _all_codes(code: types.CodeType) -> list[types.CodeType]:
    inner = [
        inner_code
        for constant in code.co_consts
        if isinstance(constant, types.CodeType)
        for inner_code in _all_codes(constant)
    ]
    return [code, *inner]


def fingerprint(*functions: Callable[..., Any] | None, compiled: bool = True) -> str:
    """Digest of everything that ``functions`` depend on, in hexadecimal digits; None stands for an absent function.

    It belongs to one version of Python, because bytecode differs between versions. Functions that are not
    ``compiled`` may call anything: of packages other than their own that are installed, the version counts. Raises
    SchemeCodeError naming a value that cannot be hashed.
    """
    plains = [plain_function(function) for function in functions]
    packages = (str(plain.__globals__.get("__name__")) for plain in plains if plain is not None)
    walk = _Walk(None if compiled else frozenset(package.partition(".")[0] for package in packages))
    for function, plain in zip(functions, plains, strict=True):
        walk.put("none" if function is None else "function")
        try:
            if function is not None:
                walk.value(plain or function)
        except _IndescribableError as why:
            raise SchemeCodeError(f"{function!r} is or holds {why}, which cannot be identified by its value") from None
    return walk.digest.hexdigest()


class _OwnWalk(_Walk):
    """A digest of code of a user, in which topcli's counts by name; what cannot be described counts by its kind."""

    def by_name(self, module: str) -> bool:
        """True for topcli, and as for any walk."""
        return module.partition(".")[0] == "topcli" or super().by_name(module)

    def value(self, value: Any) -> None:
        """Add any value."""
        try:
            super().value(value)
        except _IndescribableError as why:
            self.put(str(why))


def _base_of(scheme: Scheme) -> Scheme | None:
    """Scheme that ``scheme`` is composed of; None for others."""
    cells = getattr(inspect.unwrap(scheme.build), "__closure__", None) or ()
    return next((cell.cell_contents for cell in cells if isinstance(cell.cell_contents, Scheme)), None)


def own_parts(top: type[Top], scheme: Scheme) -> dict[Any, list[Any]]:
    """Class of a top and function ``build`` of a scheme that are not topcli's own, each with all that it declares."""
    parts: dict[Any, list[Any]] = {} if is_built_in(top) else {top: [top]}
    while base := _base_of(scheme):
        scheme = base
    build = inspect.unwrap(scheme.build)
    if not is_built_in(build):
        parts[build] = [build, scheme.modified, scheme.longest_step, scheme.order_with, scheme.conserves]
    return parts


def own_code(top: type[Top], scheme: Scheme) -> str:
    """Digest of the code of a top and of a scheme that are not topcli's own; empty if both are.

    It covers everything that they define and refer to, such as field, constants and invariants, whether a step uses it
    or not, but not where their file lies, its comments, or code of topcli.
    """
    parts = own_parts(top, scheme)
    if not parts:
        return ""
    walk = _OwnWalk(frozenset(value.__module__.partition(".")[0] for value in parts))
    for values in parts.values():
        for value in values:
            walk.value(value)
    return walk.digest.hexdigest()


ASIDE = ("source", "tangent", "change")
"""Attributes of a Stepper that a run does not use."""


def same_method(method: Method, other: Method) -> bool:
    """True if both methods certainly compile to the same machine code: much cheaper than two fingerprints.

    Closures are compared by their code and by what they hold, so that a scheme may make its functions for each top.
    Constants of a step are arguments of its machine code.
    """
    if not isinstance(method, Stepper) or not isinstance(other, Stepper):
        return method is other
    compared = (part.name for part in fields(method) if part.name not in ("constants", *ASIDE))
    return len(method.constants) == len(other.constants) and all(
        _same(getattr(method, name), getattr(other, name)) for name in compared
    )


def _same(value: Any, other: Any, depth: int = 16) -> bool:
    """True if two values are the same object, equal plain data, or functions of the same code that hold such values."""
    if value is other:
        return True
    if type(value) is not type(other) or not depth:
        return False
    if isinstance(value, tuple):
        return len(value) == len(other) and all(_same(a, b, depth - 1) for a, b in zip(value, other, strict=True))
    if isinstance(value, float):
        return value.hex() == other.hex()
    if isinstance(value, (int, str, bool)):
        return value == other
    if not isinstance(value, types.FunctionType) or value.__dict__ or other.__dict__:
        return False
    if value.__code__ is not other.__code__ or value.__globals__ is not other.__globals__:
        return False
    held = [[cell.cell_contents for cell in function.__closure__ or ()] for function in (value, other)]
    return (
        _same(tuple(held[0]), tuple(held[1]), depth - 1)
        and _same(value.__defaults__, other.__defaults__, depth - 1)
        and value.__kwdefaults__ == other.__kwdefaults__ is None
    )
