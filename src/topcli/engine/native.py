"""Machine code of plain Python functions, stored on disk under a digest of everything that it is made of.

``native(function, "ppdq")`` compiles once with numba and stores the object code; every later process loads it with
llvmlite alone, in milliseconds and without importing numba. The function takes pointers to float64 (``p``, indexed like
a list), float64 (``d``) and int64 (``q``) and returns an int64; it neither allocates nor raises: a function that raises
prints the exception and returns 0.

The name of the stored code is a digest of the functions that can be reached, with the signature, the versions of
topcli, Python, numpy, numba and llvmlite, the processor and numba's settings.

Who can write a file in the folder of the store decides what later processes execute. The folder must therefore belong
to the effective user, and nobody else may write it; and the checksum of a file, which covers its name too, must agree.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from topcli import __version__
from topcli.engine.kernels import NO_VARIANTS, CompileError, Variants, compiled
from topcli.engine.reach import reach
from topcli.errors import SchemeCodeError

_CTYPES = {"p": ctypes.c_void_p, "d": ctypes.c_double, "q": ctypes.c_int64}
_NEUTRAL = ("NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "NUMBA_DISABLE_JIT")
"""Settings of numba that do not change its code."""
_MAKERS = ("native.py", "kernels.py", "duals.py")
"""Modules that decide which code is made of a function."""
ENTRIES = 1024
"""Number of files that the folder keeps; the oldest ones are removed."""


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
    makers = (hashlib.sha256(Path(__file__).with_name(name).read_bytes()).hexdigest() for name in _MAKERS)
    return llvm, "|".join((*versions, *cpu, *settings, *makers))


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


def cache_folder() -> Path:
    """Folder of the machine code: ``$NUMBA_CACHE_DIR/topcli`` if that is set, else in the user's cache folder."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen) / "topcli"
    from platformdirs import user_cache_path

    return user_cache_path("topcli") / "kernels"


def cache_problem() -> str:
    """Reason not to use the folder; empty if there is none."""
    try:
        about = cache_folder().stat()
    except FileNotFoundError:
        return ""
    except OSError as error:
        return str(error)
    if hasattr(os, "geteuid") and about.st_uid != os.geteuid():
        return f"it belongs to the user with number {about.st_uid}, not to {os.geteuid()}"
    return f"others may write it (mode {about.st_mode & 0o777:o})" if about.st_mode & 0o022 else ""


def _checksum(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + content).digest()


def stored_code(name: str) -> bytes | None:
    """Content of a file of the folder; None if it is absent, or not as it was stored, or the folder is not trusted."""
    with suppress(OSError):
        data = b"" if cache_problem() else (cache_folder() / name).read_bytes()
        if data[:32] == _checksum(name, data[32:]):
            return data[32:]
    return None


def store_code(name: str, content: bytes) -> None:
    """Store a file atomically; do nothing if the folder cannot be used."""
    folder = cache_folder()
    temporary = folder / f"{name}.{os.getpid()}.{os.urandom(4).hex()}"
    with suppress(OSError):
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        if cache_problem():
            return
        try:
            with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(_checksum(name, content) + content)
            temporary.replace(folder / name)
        finally:
            temporary.unlink(missing_ok=True)
        for old in sorted(folder.iterdir(), key=lambda path: -path.stat().st_mtime_ns)[ENTRIES:]:
            old.unlink(missing_ok=True)


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


def native(
    function: Callable[..., Any], signature: str, *, variants: Variants = NO_VARIANTS, duals: bool = False
) -> Native:
    """Machine code of ``function``, from the store if its content is known there.

    Every kernel is inlined into its caller. ``variants`` maps kernels to those that replace them. ``duals`` are needed
    by a function that makes dual numbers (``engine.duals``). Raises CompileError if the compiler refuses the function,
    SchemeCodeError naming a value that compiled code cannot refer to.
    """
    identity = f"{reach(function, *variants.items())[0]}|{duals}"
    return _stored_or_made(identity, signature, lambda: compiled(function, signature, variants, duals))
