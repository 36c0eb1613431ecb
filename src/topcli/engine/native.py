"""Machine code of plain Python kernels, stored on disk under a key made of their content.

``native(function, "ppdq")`` compiles once with numba and stores the object code; every later process loads it
with llvmlite alone, in milliseconds and without importing numba. The function takes pointers to float64
(``p``, indexed like a list), float64 (``d``) and int64 (``q``) and returns an int64; it neither allocates nor raises:
a function that raises prints the exception and returns 0.
The key is explained in ``fingerprint``, the rules of storing in ``code_cache``.

It uses public interfaces only: ``numba.cfunc``, its ``inspect_llvm`` and ``native_name``, and llvmlite's binding
layer. Where the object code cannot be stored or loaded the function still runs, compiled in this process.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np

from topcli import __version__
from topcli.arithmetic.fused import fma, unlikely
from topcli.engine.code_cache import ObjectCode, store_code, stored_code
from topcli.engine.duals import dual_numbers, rules_digest
from topcli.engine.fingerprint import fingerprint
from topcli.engine.source import Copier, plain_function, require_no_raise
from topcli.errors import RunError, SchemeCodeError, TopcliError

_CTYPES = {"p": ctypes.c_void_p, "d": ctypes.c_double, "q": ctypes.c_int64}


class CompileError(Exception):
    """A function that the compiler refuses; the message is its reason in one line."""


@dataclass(frozen=True)
class Native:
    """A compiled function; call it with numpy arrays, floats and ints in the order of its signature.

    ``seconds`` is the time to compile or load; ``cached`` is true if the machine code came from disk.
    """

    call: Callable[..., int]
    signature: str
    seconds: float
    cached: bool
    keep: tuple[Any, ...] = field(repr=False, default=())

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
def _machine() -> tuple[Any, str]:
    """llvmlite's binding, ready for this CPU, and the text that identifies the compiler, its settings and the CPU.

    Raises RunError where llvmlite cannot be loaded.
    """
    try:
        import llvmlite.binding as llvm

        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        cpu = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    except (ImportError, OSError, MemoryError, RuntimeError) as error:
        raise _compiler_missing("llvmlite", error) from error
    if sys.platform == "linux":
        # sin, cos and the like: numpy loads libm for itself only; some C libraries contain these functions
        with suppress(RuntimeError):
            llvm.load_library_permanently("libm.so.6")
    parts = (
        __version__,
        version("numba"),
        version("llvmlite"),
        np.__version__,
        sys.version.split()[0],
        llvm.get_process_triple(),
        *cpu,
        *_numba_settings(),
    )
    return llvm, "|".join(parts)


def _compiler_missing(package: str, error: BaseException) -> RunError:
    """Error for a part of the compiler that cannot be loaded."""
    reason = (str(error).strip() or type(error).__name__).splitlines()[0]
    return RunError(
        f"the compiler cannot be loaded: {package}: {reason}",
        f"is {package} installed, and is there enough memory (ulimit -v)? topcli --version shows the versions",
    )


def _numba_settings() -> list[str]:
    """Environment variables that change the code that numba makes."""
    neutral = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_DISABLE_JIT")
    return sorted(f"{k}={v}" for k, v in os.environ.items() if k.startswith("NUMBA_") and k not in neutral)


def _target_machine() -> Any:
    llvm, _ = _machine()
    x86 = llvm.get_process_triple().startswith(("x86", "i386", "i686"))
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        jit=True,
        reloc="static" if x86 else "default",
        codemodel="jitdefault",
    )


def _outside(ir: str) -> list[str]:
    """External names that a module needs: functions that it declares and variables that it does not define."""
    functions = re.findall(r"^declare [^@]*@\"?([^\s\"(]+)", ir, re.MULTILINE)
    variables = re.findall(r"^@\"?([^\s\"]+)\"? = external", ir, re.MULTILINE)
    return sorted(name for name in {*functions, *variables} if not name.startswith("llvm."))


def _require(names: Iterable[str]) -> None:
    """Raise OSError when a symbol that stored code refers to cannot be linked in this process."""
    llvm, _ = _machine()
    _process_engine()
    for name in names:
        if not llvm.address_of_symbol(name):
            raise OSError(f"object code needs {name}, which this process does not have")


@cache
def _process_engine() -> Any:
    """Empty engine, without which some systems do not find the symbols of the process."""
    llvm, _ = _machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())


@lru_cache(maxsize=128)  # a sweep over tops asks for the same code again and again
def _load(stored: ObjectCode) -> tuple[Callable[..., int], tuple[Any, ...]]:
    """Function of an object file, linked into this process. Raises OSError or RuntimeError."""
    llvm, _ = _machine()
    _require(stored.needs)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(stored.code))
    engine.finalize_object()
    address = engine.get_function_address(stored.symbol)
    if not address:
        raise OSError(f"object code without {stored.symbol}")
    prototype = ctypes.CFUNCTYPE(ctypes.c_int64, *(_CTYPES[c] for c in stored.signature))
    return prototype(address), (engine,)


@cache
def _fma_instruction() -> Any:
    """``fma`` for numba: the processor's instruction, or the C library's function on processors without one."""
    from numba import types
    from numba.extending import intrinsic

    @intrinsic
    def fused(context: Any, a: Any, b: Any, c: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.fma(*arguments)

        return types.float64(types.float64, types.float64, types.float64), build

    return fused


@cache
def _expectation() -> Any:
    """``unlikely`` for numba: the condition, which LLVM is to expect to be false."""
    from llvmlite import ir
    from numba import types
    from numba.extending import intrinsic

    @intrinsic
    def expected_false(context: Any, condition: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            bit = ir.IntType(1)
            expect = builder.module.declare_intrinsic("llvm.expect", [bit], ir.FunctionType(bit, [bit, bit]))
            return builder.call(expect, [arguments[0], ir.Constant(bit, 0)])

        return types.boolean(types.boolean), build

    return expected_false


@cache
def _compiled() -> dict[tuple[object, ...], Any]:
    """Kernels that this process has compiled, by their content and how: a composition has those of its base.

    A function, because the value of a global variable would enter the digests of all that compiles.
    """
    return {}


class _Kernels(Copier):
    """Copies whose kernels are compiled once in a process for each ``kind``."""

    kind: tuple[object, ...] = ()

    def compiled(self, value: object, names: list[str]) -> Any:
        inner = plain_function(value)
        if inner is None or id(inner) in self.done or id(inner) in self.open:
            return super().compiled(value, names)
        key = fingerprint(inner), *self.kind
        known = _compiled()
        if key not in known:
            known[key] = super().compiled(value, names)
        return known[key]


def _compile(function: Callable[..., Any], signature: str, inline: bool, duals: bool) -> Any:
    """Compile with numba and return the cfunc."""
    from numba import cfunc, njit, types

    kinds = {"p": types.CPointer(types.float64), "d": types.float64, "q": types.int64}
    # no kernel is called from Python: without these wrappers it compiles in half of the time, to the same code
    how: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "error_model": "numpy"}
    jit = njit(forceinline=inline, **how)
    # inlined into the wrapper too: then no path to numba's error reporting, and none of its symbols, is left
    signature_type = types.int64(*(kinds[c] for c in signature))

    def compiler(kernel: Any) -> Any:
        require_no_raise(kernel)  # the time loop would never end: a cfunc that raises returns 0
        return jit(kernel)

    replace = {id(fma): _fma_instruction(), id(unlikely): _expectation(), **(dual_numbers() if duals else {})}
    plain = plain_function(function)
    assert plain is not None  # its fingerprint was taken
    kernels = _Kernels(compiler, replace)
    kernels.kind = inline, duals
    return cfunc(signature_type, error_model="numpy", forceinline=True)(kernels.copy(plain))


def _known(identity: str, signature: str, start: float) -> Native | None:
    """Stored function with this ``identity``; ``start`` is the clock reading when the search for it began."""
    stored = stored_code(identity, signature)
    if stored is None:
        return None
    try:
        call, keep = _load(stored)
    except (OSError, RuntimeError):
        return None
    return Native(call, signature, time.perf_counter() - start, True, keep)


def _linked(
    module: Any, ir: str, symbol: str, signature: str, identity: str
) -> tuple[Callable[..., int], tuple[Any, ...]]:
    """Link the function ``symbol`` of ``module``, whose text is ``ir``, and store its code. Raises OSError."""
    made = ObjectCode(_target_machine().emit_object(module), symbol, signature, tuple(_outside(ir)))
    _require(["sin"])  # for the mathematical functions that the compiler may call without declaring them
    loaded = _load(made)
    store_code(identity, made)
    return loaded


def native_text(ir: str, symbol: str, signature: str) -> Native:
    """Machine code of the function ``symbol`` of a module in LLVM's intermediate language, stored on disk.

    Raises ValueError for a text that is no such module, OSError if something that it calls cannot be linked.
    """
    llvm, machine = _machine()
    start = time.perf_counter()
    identity = f"{ir}|{symbol}|{signature}|{machine}"
    known = _known(identity, signature, start)
    if known is not None:
        return known
    try:
        module = llvm.parse_assembly(ir)
        module.verify()
    except RuntimeError as error:
        raise ValueError(f"not a module of LLVM's language: {str(error).strip().splitlines()[0]}") from error
    call, keep = _linked(module, ir, symbol, signature, identity)
    return Native(call, signature, time.perf_counter() - start, False, keep)


def native(function: Callable[..., Any], signature: str, *, inline: bool = True, duals: bool = False) -> Native:
    """Machine code of ``function``, from the cache if its content is known there.

    ``signature`` has one letter per argument: ``p`` pointer to float64, ``d`` float64, ``q`` int64. ``inline`` forces
    every kernel into its caller, which is right for a step of a hundred operations and wrong for loops. ``duals`` are
    needed by a function that makes dual numbers (``engine.duals``). Raises CompileError if the compiler refuses the
    function.
    """
    llvm, machine = _machine()  # before the clock starts: the back end's own start-up is not counted
    start = time.perf_counter()
    identity = f"{fingerprint(function)}|{signature}|{inline}|{machine}" + (rules_digest() if duals else "")
    known = _known(identity, signature, start)
    if known is not None:
        return known
    _ready_numba()
    from numba.core.compiler_lock import global_compiler_lock

    with global_compiler_lock:  # a thread that needs the same code finds it stored afterwards
        known = _known(identity, signature, start)
        if known is not None:
            return known
        try:
            compiled = _compile(function, signature, inline, duals)
        except (TopcliError, MemoryError):
            raise
        except Exception as error:  # numba raises its own kinds and plain ones
            lines = [line.strip() for line in str(error).splitlines()]
            reasons = [line for line in lines if line and not line.startswith(("Failed in", "During:", "File ", "["))]
            raise CompileError((reasons or [type(error).__name__])[0]) from error
        ir = compiled.inspect_llvm()
        prototype = ctypes.CFUNCTYPE(ctypes.c_int64, *(_CTYPES[c] for c in signature))
        call, keep = prototype(compiled.address), (compiled,)
        if not _has_addresses(compiled, ir):
            with suppress(OSError):  # a symbol to link is missing here: use numba's own code, unstored
                call, keep = _linked(llvm.parse_assembly(ir), ir, compiled.native_name, signature, identity)
    return Native(call, signature, time.perf_counter() - start, False, keep)


def _has_addresses(compiled: Any, ir: str) -> bool:
    """True if the code holds addresses of this process, as numba makes of large arrays; it must not be stored."""
    library = getattr(compiled, "_library", None)
    return bool(getattr(library, "has_dynamic_globals", False)) or "numba.dynamic.globals" in ir


def _ready_numba() -> None:
    """Import numba. Raises RunError if it cannot be loaded or is set not to compile."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of settings that numba cannot read and topcli does not use
            from numba import config
    except (ImportError, OSError, MemoryError, ValueError, RuntimeError, AttributeError) as error:
        settings = [f"{k}={v!r}" for k, v in sorted(os.environ.items()) if k.startswith("NUMBA_")]
        missing = _compiler_missing("numba", error)
        raise RunError(
            *missing.lines, *([f"set in the environment: {', '.join(settings)}"] if settings else [])
        ) from error
    if getattr(config, "DISABLE_JIT", False):
        raise RunError("NUMBA_DISABLE_JIT is set: topcli cannot compile its time loop; unset it")
