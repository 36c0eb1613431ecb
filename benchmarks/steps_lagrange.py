"""One BS step of the Lagrange top against the same algebra in C; the bar is 1.1 times the time of C.

    python benchmarks/steps_lagrange.py [--json] [--repetitions 41]

As in ``steps.py``: through the engine's own loop and compiler, interleaved repetitions, medians of ratios.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from c_peer import compiled
from ratios import ratio_rows, show_rows
from steps import Run, in_engine, last, timed, without_check

from topcli.schemes.registry import find_scheme
from topcli.tops.lagrange import LagrangeInertial

BAR = 1.1


def in_c(folder: Path) -> tuple[dict[str, Run], str | None]:
    """The forms of steps_lagrange.c by compiler, or the reason why there are none."""
    calls, reason = compiled("steps_lagrange.c", ("bs",), "pdq", folder)
    return {way: lambda y, h, n, call=call: call(y.ctypes.data, h, n) for (_, way), call in calls.items()}, reason


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
    return ratio_rows(spent, "bs")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=41)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder  # compiled again; the user's cache is not touched
        c_forms, reason = in_c(Path(folder))
        rows = compare(c_forms, arguments.repetitions)
    results = {"schema_version": 1, "skipped": [reason] if reason else [], "bar": BAR, "forms": rows}
    if arguments.json:
        print(json.dumps(results, indent=1))
        return
    for line in results["skipped"]:
        print(f"skipped: {line}")
    print(f"{'bs of the Lagrange top':<28}{'ns/step':>9}   bs's time over this (quartiles); bar {BAR}")
    show_rows(rows)


if __name__ == "__main__":
    main()
