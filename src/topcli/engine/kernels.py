"""Compilation with numba: a plain function is a kernel, which is compiled and inlined into its callers.

Kernels call each other by a global or closed-over name, or as attributes of a module. This module is needed only where
machine code is not stored yet.
"""

from __future__ import annotations

import types
import warnings
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from functools import cache
from typing import Any

from topcli.arithmetic.fused import fma, unlikely
from topcli.engine.duals import dual_numbers
from topcli.engine.reach import home_of, is_standard, place_of, reach
from topcli.errors import RunError, SchemeCodeError, TopcliError

Variants = Mapping[Callable[..., Any], Callable[..., Any]]
NO_VARIANTS: Variants = types.MappingProxyType({})


class CompileError(Exception):
    """A function that the compiler refuses; the message is its reason in one line."""


_stand_ins: ContextVar[Mapping[Any, Any]] = ContextVar("stand_ins")
"""Stand-ins for some kernels, in the compilation in progress."""
_kernels: dict[Any, Any] = {}
"""Kernels that this process has compiled, by content and stand-ins: a composition has those of its base."""
_OPTIONS: Any = {
    "forceinline": True,
    "error_model": "numpy",
    # no kernel is called from Python: without these wrappers it compiles in half of the time, to the same code
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


def _kernel(function: types.FunctionType, stand_ins: Mapping[Any, Any]) -> Any:
    """Dispatcher of numba for a kernel. Raises SchemeCodeError for one that raises or asserts."""
    content, functions = reach(function)
    key = content, frozenset(pair for pair in stand_ins.items() if pair[0] in functions)
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
        _kernels[key] = njit(**_OPTIONS)(kernel)
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
        stand_ins = _stand_ins.get(None)
        if stand_ins is None or is_standard(home_of(value)):
            return getattr(value, "_numba_type_", None)  # numba's own rule
        stand_in = stand_ins.get(value, value)
        if stand_in is value and value in stand_ins:
            return None  # numba has rules for it
        if isinstance(stand_in, types.FunctionType):
            return kinds.Dispatcher(_kernel(stand_in, stand_ins))
        typing: Any = cpu_target.typing_context
        return typing.resolve_value_type(stand_in)

    typeof_impl.register(types.FunctionType)(kernel_type)
    return {fma: fused, unlikely: expected_false}


def compiled(function: Callable[..., Any], signature: str, variants: Variants, duals: bool) -> tuple[str, str]:
    """Text of the module that numba makes of a function, and the function's symbol in it."""
    stand_ins = {**_numba(), **variants}
    if duals:
        stand_ins |= dual_numbers(stand_ins[fma])
    from numba import cfunc
    from numba import types as kinds

    letters = {"p": kinds.CPointer(kinds.float64), "d": kinds.float64, "q": kinds.int64}
    # inlined into the wrapper too: then no path to numba's error reporting, and none of its symbols, is left
    compiler = cfunc(kinds.int64(*(letters[c] for c in signature)), error_model="numpy", forceinline=True)
    token = _stand_ins.set(stand_ins)
    try:
        compiled: Any = compiler(function)
    except (TopcliError, MemoryError):
        raise
    except Exception as error:  # numba raises its own kinds and plain ones
        lines = [line.strip() for line in str(error).splitlines()]
        reasons = [line for line in lines if line and not line.startswith(("Failed in", "During:", "File ", "["))]
        raise CompileError((reasons or [type(error).__name__])[0]) from error
    finally:
        _stand_ins.reset(token)
    ir = compiled.inspect_llvm()
    if compiled._library.has_dynamic_globals or "numba.dynamic.globals" in ir:
        raise CompileError("it refers to an array that is large or not contiguous; use a smaller one, or plain=True")
    if ".numba.unresolved$" in ir:
        raise CompileError("one of its functions calls itself; a step cannot be recursive")
    return ir, compiled.native_name
