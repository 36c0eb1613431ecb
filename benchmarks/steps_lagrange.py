"""One BS step of the Lagrange top against the same algebra in C; the bar is 1.2 times the time of C.

    python benchmarks/steps_lagrange.py [--json] [--repetitions 41]

As in ``steps.py``: through the engine's own loop and compiler, interleaved repetitions, medians of ratios.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import shutil
import statistics
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from steps import FLAGS, ROOT, Run, in_engine, last, timed, without_check

from topcli.schemes.registry import find_scheme
from topcli.tops.lagrange import LagrangeInertial

BAR = 1.2


def in_c(folder: Path) -> tuple[dict[str, Run], str | None]:
    """The forms of steps_lagrange.c by compiler, or the reason why there are none."""
    gcc = shutil.which("gcc")
    if gcc is None:
        return {}, "gcc: not found; the comparisons with C are left out"
    made: dict[str, Run] = {}
    for name, flags in FLAGS.items():
        library = folder / f"steps_lagrange{len(made)}.so"
        source = ROOT / "benchmarks" / "steps_lagrange.c"
        command = [gcc, "-O3", "-march=native", *flags, "-shared", "-fPIC", str(source), "-o", str(library)]
        told = subprocess.run(command, capture_output=True, text=True, check=False)
        if told.returncode:
            return {}, f"gcc: {told.stderr.strip().splitlines()[-1]}; the comparisons with C are left out"
        function = ctypes.CDLL(str(library)).bs
        function.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_longlong]
        function.restype = None
        made[name] = lambda y, h, n, call=function: call(y.ctypes.data, h, n)
    return made, None


def compare(c_forms: dict[str, Run], repetitions: int) -> list[dict[str, Any]]:
    """Times of all forms; ratios are the engine's time over theirs."""
    top = LagrangeInertial()
    found = find_scheme("bs", top.form)
    stepper = found.build(top, found.options())
    forms = {"bs": in_engine(stepper), "without the finite check": without_check(stepper), **c_forms}
    ends = {name: last(run, 0.1, 20) for name, run in forms.items()}
    for name, end in ends.items():
        same = np.allclose(end, ends["bs"], rtol=0, atol=1e-12) if name == "gcc" else np.array_equal(end, ends["bs"])
        if not same:
            raise RuntimeError(f"bs: {name} computes something else: {end} against {ends['bs']}")
    spent = timed(forms, repetitions)
    rows = []
    for name in forms:
        ratios = [a / b for a, b in zip(spent["bs"], spent[name], strict=True)]
        low, middle, high = statistics.quantiles(ratios, n=4)
        rows.append({"form": name, "ns": statistics.median(spent[name]), "ratio": middle, "quartiles": [low, high]})
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=41)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled afresh, and the user's cache left alone
        c_forms, reason = in_c(Path(folder))
        rows = compare(c_forms, arguments.repetitions)
    results = {"schema_version": 1, "skipped": [reason] if reason else [], "bar": BAR, "forms": rows}
    if arguments.json:
        print(json.dumps(results, indent=1))
        return
    for line in results["skipped"]:
        print(f"skipped: {line}")
    print(f"{'bs of the Lagrange top':<28}{'ns/step':>9}   bs's time over this (quartiles); bar {BAR}")
    for row in rows:
        low, high = row["quartiles"]
        print(f"  {row['form']:<26}{row['ns']:>9.2f}   {row['ratio']:.3f} ({low:.3f} to {high:.3f})")


if __name__ == "__main__":
    main()
