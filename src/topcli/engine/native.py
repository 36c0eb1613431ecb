"""Plain Python kernels to machine code, kept on disk under a key made of their content.

``native(function, "ppdq")`` compiles once with numba and stores the object code; every later process loads it
with llvmlite alone, in milliseconds and without importing numba. The function takes pointers to float64
(``p``, indexed like a list), float64 (``d``) and int64 (``q``) and returns an int64; it neither allocates nor raises.

Only public interfaces are leaned on: ``numba.cfunc``, its ``inspect_llvm`` and ``native_name``, and llvmlite's
binding layer. Where the object code cannot be stored or loaded the function still runs, compiled afresh.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from topcli import __version__
from topcli.arithmetic.branches import unlikely
from topcli.arithmetic.fused import fma
from topcli.engine.source import compilable_copy, fingerprint

CACHE_ENTRIES = 512
"""The newest entries that the cache keeps; older ones are removed."""

_CTYPES = {"p": ctypes.c_void_p, "d": ctypes.c_double, "q": ctypes.c_int64}


class CompileError(Exception):
    """The compiler refuses a function; the message is its reason in one line."""


@dataclass(frozen=True)
class Native:
    """A compiled function; call it with numpy arrays, floats and ints as its signature says.

    ``seconds`` is what compiling or loading took, ``cached`` whether the machine code came from disk.
    """

    call: Callable[..., int]
    signature: str
    seconds: float
    cached: bool
    keep: tuple[Any, ...] = field(repr=False, default=())

    def __call__(self, *arguments: Any) -> int:
        """Call the machine code; arrays must be C-contiguous float64 and stay alive (they do: the caller holds them).

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


def cache_folder() -> Path:
    """Where object code is kept: ``$NUMBA_CACHE_DIR/topcli`` when that is set, else the user's cache folder."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen) / "topcli"
    from platformdirs import user_cache_path

    return user_cache_path("topcli") / "kernels"


@cache
def _machine() -> tuple[Any, str]:
    """llvmlite's binding, ready for this CPU, and the words that name CPU and compiler."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    if sys.platform == "linux":
        # sin, cos and their kin: numpy has libm loaded, but for itself alone; some C libraries carry them themselves
        with suppress(RuntimeError):
            llvm.load_library_permanently("libm.so.6")
    words = (
        __version__,
        version("numba"),
        version("llvmlite"),
        sys.version.split()[0],
        llvm.get_process_triple(),
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
    )
    return llvm, "|".join(words)


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
    """Names that a module needs from outside: functions it declares and variables it does not define."""
    functions = re.findall(r"^declare [^@]*@\"?([^\s\"(]+)", ir, re.MULTILINE)
    variables = re.findall(r"^@\"?([^\s\"]+)\"? = external", ir, re.MULTILINE)
    return sorted(name for name in {*functions, *variables} if not name.startswith("llvm."))


def _require(names: Iterable[str]) -> None:
    """Raise OSError when a symbol that stored code refers to cannot be linked in this process."""
    llvm, _ = _machine()
    for name in names:
        if not llvm.address_of_symbol(name):
            raise OSError(f"object code needs {name}, which is nowhere")


def _load(code: bytes, symbol: str, signature: str, needs: list[str]) -> tuple[Callable[..., int], tuple[Any, ...]]:
    """The function ``symbol`` of an object file, linked into this process."""
    llvm, _ = _machine()
    _require(needs)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    address = engine.get_function_address(symbol)
    if not address:
        raise OSError(f"object code without {symbol}")
    prototype = ctypes.CFUNCTYPE(ctypes.c_int64, *(_CTYPES[c] for c in signature))
    return prototype(address), (engine,)


def _read(path: Path, signature: str) -> tuple[Callable[..., int], tuple[Any, ...]] | None:
    """The function stored at ``path``; None when there is none, or it is not what was written."""
    try:
        header, _, code = path.read_bytes().partition(b"\n")
        told = json.loads(header)
        if hashlib.sha256(code).hexdigest() != told["sha256"]:
            return None
        loaded = _load(code, told["symbol"], signature, told["needs"])
        os.utime(path)
        return loaded
    except (OSError, ValueError, KeyError, TypeError, RuntimeError):
        return None


def _write(path: Path, code: bytes, symbol: str, needs: list[str]) -> None:
    """Store object code whole or not at all; a folder that cannot be written is no error."""
    told = {"symbol": symbol, "needs": needs, "sha256": hashlib.sha256(code).hexdigest()}
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(json.dumps(told).encode() + b"\n" + code)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
        entries = sorted(path.parent.glob("*.o"), key=lambda entry: entry.stat().st_mtime, reverse=True)
        for old in entries[CACHE_ENTRIES:]:
            old.unlink(missing_ok=True)
    except OSError:
        pass


@cache
def _fma_instruction() -> Any:
    """``fma`` for numba: the processor's instruction, or the C library's function where there is none."""
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
    """``unlikely`` for numba: the condition, with LLVM told that it is false."""
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


def _compile(function: Callable[..., Any], signature: str, inline: bool) -> Any:
    """Compile with numba; the numba cfunc."""
    from numba import cfunc, njit, types

    kinds = {"p": types.CPointer(types.float64), "d": types.float64, "q": types.int64}
    jit = njit(forceinline=inline, error_model="numpy")
    # inlined into the wrapper too: then no path to numba's error reporting, and none of its symbols, is left
    signature_type = types.int64(*(kinds[c] for c in signature))
    return cfunc(signature_type, error_model="numpy", forceinline=True)(
        compilable_copy(function, jit, {id(fma): _fma_instruction(), id(unlikely): _expectation()})
    )


def _path(words: str) -> Path:
    """Where the machine code is kept whose content, with compiler, CPU and versions, is told by ``words``."""
    return cache_folder() / f"{hashlib.sha256(words.encode()).hexdigest()}.o"


def _known(path: Path, signature: str, start: float) -> Native | None:
    """The function kept at ``path``; ``start`` is when the search for it began."""
    stored = _read(path, signature)
    return None if stored is None else Native(stored[0], signature, time.perf_counter() - start, True, stored[1])


def _linked(
    module: Any, ir: str, symbol: str, signature: str, path: Path
) -> tuple[Callable[..., int], tuple[Any, ...]]:
    """The function ``symbol`` of ``module``, whose text is ``ir``, kept at ``path``. Raises OSError as ``_load``."""
    code, needs = _target_machine().emit_object(module), _outside(ir)
    _require(["sin"])  # or any mathematics that the compiler calls without declaring it
    loaded = _load(code, symbol, signature, needs)
    _write(path, code, symbol, needs)
    return loaded


def native_text(ir: str, symbol: str, signature: str) -> Native:
    """The function ``symbol`` of a module of LLVM's intermediate language as machine code, kept on disk as well.

    Raises ValueError for a text that is no such module, OSError when something it calls cannot be linked.
    """
    llvm, words = _machine()
    start = time.perf_counter()
    path = _path(f"{ir}|{symbol}|{signature}|{words}")
    known = _known(path, signature, start)
    if known is not None:
        return known
    try:
        module = llvm.parse_assembly(ir)
        module.verify()
    except RuntimeError as error:
        raise ValueError(f"no module of LLVM's language: {str(error).strip().splitlines()[0]}") from error
    call, keep = _linked(module, ir, symbol, signature, path)
    return Native(call, signature, time.perf_counter() - start, False, keep)


def native(function: Callable[..., Any], signature: str, *, inline: bool = True) -> Native:
    """``function`` as machine code, from the cache when its content is known there.

    ``signature`` has a letter an argument: ``p`` pointer to float64, ``d`` float64, ``q`` int64. ``inline``
    forces every kernel into its caller, which is right for a step of a hundred operations and wrong for loops.
    Raises CompileError when the compiler refuses.
    """
    llvm, words = _machine()  # the back end's own start-up is no part of compiling or loading this function
    start = time.perf_counter()
    path = _path(f"{fingerprint(function)}|{signature}|{inline}|{words}")
    known = _known(path, signature, start)
    if known is not None:
        return known
    try:
        compiled = _compile(function, signature, inline)
    except Exception as error:  # numba raises its own kinds and plain ones
        lines = [line.strip() for line in str(error).splitlines()]
        telling = [line for line in lines if line and not line.startswith(("Failed in", "During:", "File ", "["))]
        raise CompileError((telling or [type(error).__name__])[0]) from error
    ir = compiled.inspect_llvm()
    try:
        call, keep = _linked(llvm.parse_assembly(ir), ir, compiled.native_name, signature, path)
    except OSError:  # something to link stored code against is missing here: use numba's own, unstored
        prototype = ctypes.CFUNCTYPE(ctypes.c_int64, *(_CTYPES[c] for c in signature))
        call, keep = prototype(compiled.address), (compiled,)
    return Native(call, signature, time.perf_counter() - start, False, keep)
