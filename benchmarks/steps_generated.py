"""Steps generated from the field against those derived by hand, alone and in lanes of ensembles.

    python benchmarks/steps_generated.py [--json] [--repetitions 21]

Both are compiled by the engine, without counters. The repetitions are interleaved; every figure is the median over them
of the generated step's time divided by that of the other in the same repetition, with the quartiles. The bars are 1.0
for one trajectory of the Kowalevski, Lagrange and heavy tops under HK, 1.05 for the Euler top, and 1.1 in lanes; 0.6
under the midpoint rule, which is timed for one trajectory.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from hand_steps import hk_heavy_change, hk_lagrange_change, midpoint_change
from ratios import ratio_rows, show_rows

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src"), str(ROOT / "tests")]

from conftest import random_states  # noqa: E402
from topcli.contracts import Stepper, Top  # noqa: E402
from topcli.engine.ensemble import TILE  # noqa: E402
from topcli.engine.loop import loop_of, more_parameters  # noqa: E402
from topcli.engine.native import native  # noqa: E402
from topcli.engine.tile import LANES_SIGNATURE, plain_lanes  # noqa: E402
from topcli.field.implicit import KahanStep, generated  # noqa: E402
from topcli.field.polynomial import field_of  # noqa: E402
from topcli.schemes.any_top.kahan import kahan  # noqa: E402
from topcli.schemes.euler.hk import hk_gamma_step, hk_step  # noqa: E402
from topcli.schemes.kowalevski.hk import hk_kowalevski  # noqa: E402
from topcli.schemes.layout import stepper, summed  # noqa: E402
from topcli.schemes.registry import find_scheme  # noqa: E402
from topcli.tops import TOPS  # noqa: E402
from topcli.tops.heavy import Heavy  # noqa: E402
from topcli.tops.kowalevski import Kowalevski  # noqa: E402
from topcli.tops.lagrange import Lagrange  # noqa: E402

BY_HAND = {
    "kowalevski": hk_kowalevski,
    "lagrange": summed(hk_lagrange_change, 6),
    "heavy": summed(hk_heavy_change, 6),
    "euler": hk_step,
    "euler+gamma": hk_gamma_step,
}
MIDPOINT = (
    (Kowalevski(), Heavy(A=2.0, B=2.0, C=1.0, x0=1.0, y0=0.0, z0=0.0)),
    (Lagrange(), Heavy(A=1.0, B=1.0, C=0.5, x0=0.0, y0=0.0, z0=1.0)),
    (Heavy(), Heavy()),
)
"""Tops, and each as a heavy top, for which the rule was derived."""
H, STEPS = 0.01, 20_000


class Case:
    """A method, ready to be timed alone and in lanes."""

    def __init__(self, top: Top, method: Stepper) -> None:
        d, self.p = len(top.components), np.array(top.constants())
        self.loop = loop_of(method, d, len(self.p))
        self.start = np.zeros(self.loop.width)
        self.loop.enter(random_states(1, 3)[0, :d], self.start, self.p, H)
        self.lanes = native(plain_lanes(method, d, len(self.p), TILE), LANES_SIGNATURE)
        self.more = np.array([*self.p, *more_parameters(method)])
        self.work = np.zeros((d + 1, TILE))
        self.work[:-1] = random_states(TILE, 3)[:, :d].T
        self.out = np.empty(d * TILE)

    def alone(self) -> float:
        """Nanoseconds per step of one trajectory."""
        work, steps = self.start.copy(), 8 * STEPS
        start = time.perf_counter()
        self.loop.drive(work, self.out, self.p, H, steps, steps + 1, steps + 1)
        return (time.perf_counter() - start) / steps * 1e9

    def together(self) -> float:
        """Nanoseconds per trajectory-step of a tile."""
        work, steps = self.work.copy(), STEPS // 8
        start = time.perf_counter()
        self.lanes(work, self.out, self.more, H, steps, steps + 1, steps + 1, 0)
        return (time.perf_counter() - start) / steps / TILE * 1e9


def generated_step(top: Top) -> Stepper:
    """Kahan's step of the top's field."""
    made = generated(KahanStep, field_of(top), len(top.constants()))
    return replace(Stepper(kahan(made.code).step, len(top.components)), constants=made.constants)


def main() -> None:
    """Time all tops and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--repetitions", type=int, default=21)
    arguments = parser.parse_args()
    found = {}
    for form, step in BY_HAND.items():
        top = TOPS[form].new()
        cases = {"generated": Case(top, generated_step(top)), "by hand": Case(top, Stepper(step, len(top.components)))}
        for how in ("alone", "together"):
            spent: dict[str, list[float]] = {name: [] for name in cases}
            for _ in range(arguments.repetitions):
                for name, case in cases.items():
                    spent[name].append(getattr(case, how)())
            found[f"{form} {how}"] = ratio_rows(spent, "generated")
    for top, written_out in MIDPOINT:
        rule = find_scheme("midpoint", top.form)
        by_hand = stepper(midpoint_change, 6, counters=("iterations",), iterative=True)
        cases = {"generated": Case(top, rule.build(top, rule.options())), "by hand": Case(written_out, by_hand)}
        spent = {name: [] for name in cases}
        for _ in range(arguments.repetitions):
            for name, case in cases.items():
                spent[name].append(case.alone())
        found[f"{top.form} midpoint"] = ratio_rows(spent, "generated")
    if arguments.json:
        print(json.dumps(found))
        return
    for title, rows in found.items():
        print(title)
        show_rows(rows[1:])


if __name__ == "__main__":
    main()
