"""C sources compiled by gcc and loaded, for comparisons of the same algebra: what all step benchmarks share."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
FLAGS = {"gcc": [], "gcc -ffp-contract=off": ["-ffp-contract=off", "-fno-tree-slp-vectorize"]}
"""Ways to compile, all with -O3 -march=native; the second rounds every operation by itself, as topcli does.

gcc 12's vectorizer of straight-line code fuses a product and a sum or difference even where contraction is off.
"""

Call = Callable[..., None]
_KINDS = {"p": ctypes.c_void_p, "d": ctypes.c_double, "q": ctypes.c_longlong}


def compiled(source: str, functions: Sequence[str], signature: str, folder: Path) -> tuple[dict[Any, Call], str | None]:
    """``functions`` of the C file ``source`` by (function, way to compile), and why there are none where there are not.

    ``signature`` has a letter an argument: p pointer, d double, q long long. Libraries are written into ``folder``.
    """
    gcc = shutil.which("gcc")
    if gcc is None:
        return {}, "gcc: not found; the comparisons with C are left out"
    made: dict[Any, Call] = {}
    for number, (way, flags) in enumerate(FLAGS.items()):
        library = folder / f"{Path(source).stem}{number}.so"
        command = [gcc, "-O3", "-march=native", *flags, "-shared", "-fPIC", str(HERE / source)]
        done = subprocess.run([*command, "-o", str(library), "-lm"], capture_output=True, text=True, check=False)
        if done.returncode:
            return {}, f"gcc: {done.stderr.strip().splitlines()[-1]}; the comparisons with C are left out"
        loaded = ctypes.CDLL(str(library))
        for name in functions:
            call = getattr(loaded, name)
            call.argtypes = [_KINDS[letter] for letter in signature]
            call.restype = None
            made[name, way] = call
    return made, None
