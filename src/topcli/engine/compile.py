"""Machine code of plain Python functions, stored on disk under a digest of everything that it is made of.

``native(function, "ppdq")`` compiles once with numba and stores the object code; every later process loads it with
llvmlite alone, in milliseconds and without importing numba. The function takes pointers to float64 (``p``, indexed like
a list), float64 (``d``) and int64 (``q``) and returns an int64; it neither allocates nor raises: a function that raises
prints the exception and returns 0.

While it compiles, numba is taught that a plain function is a kernel, which it compiles and inlines; kernels call each
other by a global or closed-over name, or as attributes of a module. The name of the stored code is a digest of the
functions that can be reached, with the signature, the versions of topcli, Python, numpy, numba and llvmlite, the
processor and numba's settings. numba makes the code from nothing else: the bytecode with its constants, the values of
globals, closed-over variables, defaults and attributes of modules, which it freezes, and the types of the arguments.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import sys
import sysconfig
import threading
import time
import types
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from topcli import __version__
from topcli.arithmetic.fused import fma, unlikely
from topcli.engine.code_store import store_code, stored_code
from topcli.engine.duals import dual_numbers, rules_digest
from topcli.errors import RunError, SchemeCodeError, TopcliError

VERSIONED = frozenset(("llvmlite", "numba", "numpy"))
"""Packages whose functions are identified by name: their versions are part of the digest."""
_STANDARD_LIBRARY = sysconfig.get_path("stdlib")
_PLAIN = frozenset((int, float, complex, bool, str, bytes, type(None), type(...)))
_CTYPES = {"p": ctypes.c_void_p, "d": ctypes.c_double, "q": ctypes.c_int64}
_NEUTRAL = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_DISABLE_JIT")
"""Settings of numba that do not change its code."""


class CompileError(Exception):
    """A function that the compiler refuses; the message is its reason in one line."""


# what a function can reach


def plain_function(value: object) -> types.FunctionType | None:
    """``value`` as a plain Python function: itself, or the one that a numba dispatcher wraps; else None."""
    if not isinstance(value, types.FunctionType | types.ModuleType | type):
        value = getattr(value, "py_func", None)
    return value if isinstance(value, types.FunctionType) else None


def place_of(function: Callable[..., Any]) -> str:
    """File and line of a function, for messages; of another callable, its ``repr``."""
    plain = plain_function(function)
    return f"{plain.__code__.co_filename}:{plain.__code__.co_firstlineno}" if plain else repr(function)


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


def _home(function: types.FunctionType) -> str:
    """Name of the module of a function; ``__module__`` may be that of a function which it wraps."""
    return str(function.__globals__.get("__name__") or "")


def _has_known_name(value: Any) -> bool:
    """True for a function or class that its name and the version of its package identify."""
    module = getattr(value, "__module__", None) or type(value).__module__
    belongs_to = getattr(value, "__self__", None)  # of a builtin function its module, of a method an object
    named = isinstance(getattr(value, "__name__", None), str)
    return callable(value) and named and is_standard(module) and isinstance(belongs_to, types.ModuleType | None)


class _Digest:
    """A digest under construction; ``functions`` are the plain ones met so far, in the order of their numbers."""

    def __init__(self) -> None:
        self.sha = hashlib.sha256()
        self.functions = dict[types.FunctionType, int]()

    def text(self, *words: object) -> None:
        """Add words; the length keeps neighbouring texts apart."""
        data = " ".join(map(str, words)).encode(errors="surrogatepass")
        self.sha.update(b"%d:" % len(data) + data)

    def put(self, value: Any) -> None:
        """Add a value by its content. Raises SchemeCodeError for one that has none."""
        kind = type(value)
        function = plain_function(value)
        if kind in _PLAIN:
            self.text(kind.__name__, repr(value))
        elif isinstance(value, tuple):
            self.text(kind.__qualname__, getattr(value, "_fields", ""), len(value))
            for item in value:
                self.put(item)
        elif kind is frozenset:  # a constant of code
            self.text("frozenset", sorted(map(repr, value)))
        elif isinstance(value, np.ndarray | np.generic):
            layout = "C" if value.flags.c_contiguous else "F" if value.flags.f_contiguous else "A"
            self.text(kind.__name__, np.dtype(value.dtype).descr, value.shape, layout)
            if value.dtype.hasobject:
                raise SchemeCodeError("an array of objects")
            self.text(hashlib.sha256(value.tobytes()).hexdigest())
        elif isinstance(value, types.CodeType):
            self.text(value.co_code.hex(), value.co_flags, value.co_argcount, value.co_kwonlyargcount)
            self.text(value.co_names, value.co_varnames, value.co_freevars, value.co_exceptiontable.hex())
            self.put(value.co_consts)
        elif function is not None and not is_standard(_home(function)):
            self._function(function)
        elif isinstance(value, types.ModuleType):
            self.text("module", value.__name__)
        elif _has_known_name(value):
            self.text(kind.__name__, getattr(value, "__module__", ""), value.__name__)
        else:
            raise SchemeCodeError(f"a {kind.__name__}")

    def _function(self, function: types.FunctionType) -> None:
        again = function in self.functions
        self.text("function", again, self.functions.setdefault(function, len(self.functions)))
        if again:  # or on the way to itself
            return
        self.put(function.__code__)
        named = {"default arguments": function.__defaults__, **(function.__kwdefaults__ or {}), **references(function)}
        for name, value in named.items():
            try:
                self._named(name, value, function, ())
            except SchemeCodeError as error:
                if ": " in str(error):  # names its place already
                    raise
                raise SchemeCodeError(
                    f"{place_of(function)}: {function.__name__} refers to {name!r}, which is or holds {error}; "
                    "compiled code takes numbers, strings, tuples, arrays, functions and modules of them"
                ) from None

    def _named(self, name: str, value: Any, owner: types.FunctionType, inside: tuple[Any, ...]) -> None:
        """Add a value that ``owner`` mentions; of a module of a user, the attributes that it may mention."""
        self.text(name)
        self.put(value)
        if isinstance(value, types.ModuleType) and not is_standard(value.__name__) and value not in inside:
            for attribute in names_in(owner):
                if hasattr(value, attribute):
                    self._named(attribute, getattr(value, attribute), owner, (*inside, value))


def digest(*values: Any) -> str:
    """Digest of values by their content: of functions, their code and all that it refers to.

    Raises SchemeCodeError naming a value that compiled code cannot refer to.
    """
    walk = _Digest()
    walk.put(values)
    return walk.sha.hexdigest()


def reaches(function: Callable[..., Any], others: Mapping[Callable[..., Any], Any]) -> bool:
    """True if compiled code of ``function`` can call one of ``others``."""
    walk = _Digest()
    walk.put(function)
    return not walk.functions.keys().isdisjoint(others)


# compiled functions


@dataclass(frozen=True)
class Native:
    """A compiled function; call it with numpy arrays, floats and ints in the order of its signature.

    ``seconds`` is the time to compile or load; ``cached`` is true if the machine code came from disk.
    """

    call: Callable[..., int]
    signature: str
    seconds: float
    cached: bool
    keep: Any = field(repr=False, default=None)

    def __call__(self, *arguments: Any) -> int:
        """Call the machine code; arrays must be C-contiguous float64.

        Raises TypeError for an array of another kind.
        """
        plain = []
        for code, value in zip(self.signature, arguments, strict=True):
            if code == "p":
                if value.dtype != np.float64 or not value.flags.c_contiguous:
                    raise TypeError("expected a contiguous float64 array")
                plain.append(value.ctypes.data)
            else:
                plain.append(value)
        return self.call(*plain)

    def checked(self, *arguments: Any) -> int:
        """Call code that returns a number other than 0. Raises SchemeCodeError if it returned 0: then it raised."""
        result = self(*arguments)
        if not result:
            raise SchemeCodeError(
                "the compiled step raised the exception printed above; return nan from a step that fails"
            )
        return result


@cache
def _llvm() -> tuple[Any, str]:
    """llvmlite's binding, ready for this CPU, and the text that identifies compiler, settings and CPU."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    cpu = llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    if sys.platform == "linux":
        # sin, cos and the like: numpy loads libm for itself only; some C libraries contain these functions
        with suppress(RuntimeError):
            llvm.load_library_permanently("libm.so.6")
    versions = __version__, version("numba"), version("llvmlite"), np.__version__, sys.version.split()[0]
    settings = sorted(f"{k}={v}" for k, v in os.environ.items() if k.startswith("NUMBA_") and k not in _NEUTRAL)
    return llvm, "|".join((*versions, *cpu, *settings, hashlib.sha256(Path(__file__).read_bytes()).hexdigest()))


def _target() -> Any:
    llvm, _ = _llvm()
    x86 = llvm.get_process_triple().startswith(("x86", "i386", "i686"))
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        jit=True,
        reloc="static" if x86 else "default",
        codemodel="jitdefault",
    )


@lru_cache(maxsize=128)  # a sweep over tops asks for the same code again and again
def _linked(code: bytes, signature: str) -> tuple[Callable[..., int], Any]:
    """Function of stored code, linked into this process, and what keeps it. Raises OSError or RuntimeError."""
    llvm, _ = _llvm()
    needs, symbol, machine = code.split(b"\n", 2)
    # first, because some systems find the symbols of a process only once there is an engine
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
    if missing := [name for name in needs.decode().split() if not llvm.address_of_symbol(name)]:
        raise OSError(f"it needs {missing[0]}, which this process does not have")
    engine.add_object_file(llvm.ObjectFileRef.from_data(machine))
    engine.finalize_object()
    prototype = ctypes.CFUNCTYPE(ctypes.c_int64, *(_CTYPES[c] for c in signature))
    return prototype(engine.get_function_address(symbol.decode())), engine


def _object_code(ir: str, symbol: str) -> bytes:
    """Object file of a module with the function ``symbol``, after the symbols that it needs, and its own.

    Raises RuntimeError for a text that is no module.
    """
    llvm, _ = _llvm()
    module = llvm.parse_assembly(ir)
    module.verify()
    functions = re.findall(r"^declare [^@]*@\"?([^\s\"(]+)", ir, re.MULTILINE)
    variables = re.findall(r"^@\"?([^\s\"]+)\"? = external", ir, re.MULTILINE)
    needs = [name for name in (*functions, *variables) if not name.startswith("llvm.")]
    # sin: the compiler may call mathematical functions without declaring them
    return f"{' '.join(['sin', *needs])}\n{symbol}\n".encode() + _target().emit_object(module)


_one_at_a_time = threading.RLock()


def _stored_or_made(identity: str, signature: str, make: Callable[[], tuple[str, str]]) -> Native:
    """Function from the store, or that of the module and symbol which ``make`` returns."""
    _, machine = _llvm()  # before the clock starts: the back end's own start-up is not counted
    start = time.perf_counter()
    name = hashlib.sha256(f"{identity}|{signature}|{machine}".encode()).hexdigest() + ".o"
    with _one_at_a_time:  # a thread that needs the same code finds it stored
        if code := stored_code(name):
            with suppress(OSError, RuntimeError):
                call, keep = _linked(code, signature)
                return Native(call, signature, time.perf_counter() - start, True, keep)
        code = _object_code(*make())
        try:
            call, keep = _linked(code, signature)
        except OSError as error:
            raise CompileError(str(error)) from error
        store_code(name, code)
    return Native(call, signature, time.perf_counter() - start, False, keep)


def native_text(ir: str, symbol: str, signature: str) -> Native:
    """Machine code of the function ``symbol`` of a module in LLVM's intermediate language, stored on disk.

    Raises ValueError for a text that is no such module.
    """
    try:
        return _stored_or_made(f"{ir}|{symbol}", signature, lambda: (ir, symbol))
    except RuntimeError as error:
        raise ValueError(f"not a module of LLVM's language: {str(error).strip().splitlines()[0]}") from error


Variants = Mapping[Callable[..., Any], Callable[..., Any]]
NO_VARIANTS: Variants = types.MappingProxyType({})


def native(
    function: Callable[..., Any], signature: str, *, variants: Variants = NO_VARIANTS, duals: bool = False
) -> Native:
    """Machine code of ``function``, from the store if its content is known there.

    Every kernel is inlined into its caller. ``variants`` maps kernels to those that replace them. ``duals`` are needed
    by a function that makes dual numbers (``engine.duals``). Raises CompileError if the compiler refuses the function,
    SchemeCodeError naming a value that compiled code cannot refer to.
    """
    identity = f"{digest(function, *variants.items())}|{rules_digest() if duals else ''}"
    return _stored_or_made(identity, signature, lambda: _compiled(function, signature, variants, duals))


# numba


@dataclass(frozen=True)
class _Choice:
    """Compilation in progress: numba's options and stand-ins for kernels, and the kernels met so far."""

    options: Mapping[str, Any]
    stand_ins: Mapping[Any, Any]
    kernels: dict[types.FunctionType, Any] = field(default_factory=dict)


_choice: ContextVar[_Choice] = ContextVar("choice")
_kernels: dict[Any, Any] = {}
"""Kernels that this process has compiled, by content, options and stand-ins: a composition has those of its base."""


def _kernel(function: types.FunctionType, choice: _Choice) -> Any:
    """Dispatcher of numba for a kernel. Raises SchemeCodeError for one that raises or asserts."""
    if function in choice.kernels:
        return choice.kernels[function]
    walk = _Digest()
    walk.put(function)
    reached = frozenset(pair for pair in choice.stand_ins.items() if pair[0] in walk.functions)
    key = walk.sha.hexdigest(), tuple(choice.options.items()), reached
    if key not in _kernels:
        import dis

        from numba import njit

        if any(step.opname == "RAISE_VARARGS" for step in dis.get_instructions(function)):
            # the time loop would never end: a function that raises returns 0
            raise SchemeCodeError(
                f"{place_of(function)}: {function.__name__} raises or asserts, which compiled code cannot pass on; "
                "return nan from a step that fails, or set Stepper(..., plain=True)"
            )
        kernel = function
        if hasattr(function, "__wrapped__"):  # whose signature numba would take instead
            parts = function.__globals__, function.__name__, function.__defaults__, function.__closure__
            kernel = types.FunctionType(function.__code__, *parts)
            kernel.__kwdefaults__ = function.__kwdefaults__
        _kernels[key] = njit(**choice.options)(kernel)
    choice.kernels[function] = _kernels[key]
    return _kernels[key]


@cache
def _numba() -> dict[Any, Any]:
    """Teach numba that plain functions are kernels; the instructions that stand for ``fma`` and ``unlikely``.

    Raises RunError if numba is set not to compile.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of settings that numba cannot read and topcli does not use
        from numba import config
    if getattr(config, "DISABLE_JIT", False):
        raise RunError("NUMBA_DISABLE_JIT is set: topcli cannot compile its time loop; unset it")
    from llvmlite import ir
    from numba import types as kinds
    from numba.core.dispatcher import Dispatcher
    from numba.core.registry import cpu_target
    from numba.extending import intrinsic, typeof_impl

    @intrinsic
    def fused(context: Any, a: Any, b: Any, c: Any) -> Any:
        """The processor's instruction, or the C library's function on processors without one."""
        return kinds.float64(kinds.float64, kinds.float64, kinds.float64), lambda _, builder, s, x: builder.fma(*x)

    @intrinsic
    def expected_false(context: Any, condition: Any) -> Any:
        """The condition, which LLVM is to expect to be false."""
        bit = ir.IntType(1)

        def build(context: Any, builder: Any, signature: Any, x: Any) -> Any:
            expect = builder.module.declare_intrinsic("llvm.expect", [bit], ir.FunctionType(bit, [bit, bit]))
            return builder.call(expect, [x[0], ir.Constant(bit, 0)])

        return kinds.boolean(kinds.boolean), build

    def kernel_type(value: Any, context: Any) -> Any:
        """Type of a function in compiled code."""
        choice, function = _choice.get(None), plain_function(value)
        if choice is None or function is None or is_standard(_home(function)):
            return getattr(value, "_numba_type_", None)  # numba's own rule
        stand_in = choice.stand_ins.get(function)
        if stand_in is function:
            return None  # numba has rules for it
        if stand_in is None or isinstance(stand_in, types.FunctionType):
            return kinds.Dispatcher(_kernel(stand_in or function, choice))
        typing: Any = cpu_target.typing_context
        return typing.resolve_value_type(stand_in)

    typeof_impl.register(types.FunctionType)(kernel_type)
    typeof_impl.register(Dispatcher)(kernel_type)
    return {fma: fused, unlikely: expected_false}


@contextmanager
def kernels(variants: Variants = NO_VARIANTS, duals: bool = False, **more: Any) -> Iterator[Mapping[str, Any]]:
    """Within the block, numba compiles plain functions as kernels with these options, to which ``more`` are added."""
    stand_ins = {**_numba(), **variants}
    if duals:
        stand_ins |= dual_numbers(stand_ins[fma])
    options = {"forceinline": True, "error_model": "numpy", **more}
    token = _choice.set(_Choice(options, stand_ins))
    try:
        yield options
    finally:
        _choice.reset(token)


def _compiled(function: Callable[..., Any], signature: str, variants: Variants, duals: bool) -> tuple[str, str]:
    """Text of the module that numba makes of a function, and the function's symbol in it."""
    # no kernel is called from Python: without these wrappers it compiles in half of the time, to the same code
    with kernels(variants, duals, no_cpython_wrapper=True, no_cfunc_wrapper=True):
        from numba import cfunc
        from numba import types as kinds

        letters = {"p": kinds.CPointer(kinds.float64), "d": kinds.float64, "q": kinds.int64}
        # inlined into the wrapper too: then no path to numba's error reporting, and none of its symbols, is left
        compiler = cfunc(kinds.int64(*(letters[c] for c in signature)), error_model="numpy", forceinline=True)
        try:
            plain: Any = plain_function(function)
            compiled: Any = compiler(plain)
        except (TopcliError, MemoryError):
            raise
        except Exception as error:  # numba raises its own kinds and plain ones
            lines = [line.strip() for line in str(error).splitlines()]
            reasons = [line for line in lines if line and not line.startswith(("Failed in", "During:", "File ", "["))]
            raise CompileError((reasons or [type(error).__name__])[0]) from error
    ir = compiled.inspect_llvm()
    if compiled._library.has_dynamic_globals or "numba.dynamic.globals" in ir:
        raise CompileError("it refers to an array that is large or not contiguous; use a smaller one, or plain=True")
    if ".numba.unresolved$" in ir:
        raise CompileError("one of its functions calls itself; a step cannot be recursive")
    return ir, compiled.native_name
