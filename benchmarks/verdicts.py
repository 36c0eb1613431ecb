"""Rates of wrong verdicts on invariants: runs of ten lengths, judged by runs 100 times longer.

The schemes are those whose deviations differ in kind: HK and midpoint oscillate with the motion, rk4 drifts, hybrid and
Bohlin A drift with the swings, a compensated scheme walks in its round-off, a projected one is exact. A verdict
*drifting* is false if the deviation comes back: over the second half of the longer run it is, on average, nearer to
where it was than half of the drift. The bound of *no drift seen* is too low if the line through the longer run is
steeper. A second table adds changes to the deviations under HK: the bound is too low if the mean rate of the change
over the run is larger.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

import topcli
from topcli.analysis.tally import invariant_report, series_rows, tally_of
from topcli.analysis.verdict import InvariantRow
from topcli.contracts import Array, Top
from topcli.engine.rows import Rows
from topcli.table import Cells

KOWALEVSKI = ("kowalevski_hk", "kowalevski_generic_hk", "kowalevski_torus")
SCENES = (
    *KOWALEVSKI,
    *("lagrange_hk", "lagrange_waves", "heavy_hk", "heavy_chaotic", "euler_gamma_hk", "clebsch_gentle", "so4_gentle"),
)
SCHEMES: dict[str, tuple[Any, Sequence[str]]] = {
    "HK": ("hk", SCENES),
    "HK, compensated": ({"name": "hk", "compensated": True}, SCENES),
    "midpoint": ("midpoint", SCENES),
    "rk4": ("rk4", SCENES),
    "hybrid": ("hybrid", KOWALEVSKI),
    "Bohlin A": ("bohlin-a", KOWALEVSKI),
    "HK, projected": ({"name": "hk", "project": 1}, KOWALEVSKI),
}
LENGTHS = (3.0, 5.0, 8.0, 13.0, 20.0, 35.0, 60.0, 100.0, 180.0, 300.0)
LONGER = 100
CHANGES: dict[str, Callable[[Array], Array]] = {
    "jump after 1 %": lambda x: x > 0.01,
    "jump after 97 %": lambda x: x >= 0.97,
    "jump after 99.5 %": lambda x: x >= 0.995,
    "ramp over the last 5 %": lambda x: np.clip(20.0 * x - 19.0, 0.0, 1.0),
    "cubic": lambda x: 0.5 * (2.0 * x - 1.0) ** 3,
    "line": lambda x: x,
}
"""Changes by 1 over the part x of a run, from 0 to 1."""
SIZES = (1.0, 3.0, 10.0)
"""Sizes of the changes, in units of the range of the deviation without them."""


@dataclass(frozen=True)
class Judged:
    """Report on an invariant of a run over the time T, beside the truth of a longer run."""

    scheme: str
    scene: str
    T: float
    row: InvariantRow
    slope: float
    """Slope of the line through the deviations of the longer run."""
    displacement: float
    """Mean deviation over the second half of the longer run minus that over the run."""

    @property
    def false_alarm(self) -> bool:
        """True for a drift after which the deviation comes back."""
        moved = self.row.drift_over_run
        return self.row.verdict == "drifting" and moved is not None and abs(self.displacement) < 0.5 * abs(moved)

    @property
    def bound_too_low(self) -> bool:
        """True for a bound of the drift that the longer run exceeds."""
        bound = self.row.drift_bound
        return self.row.verdict == "no drift seen" and bound is not None and abs(self.slope) > bound


def judged_lengths(
    scheme: str, scene: str, top: Top, h: float, states: Array, lengths: Sequence[float]
) -> Iterator[Judged]:
    """Judge the first parts of a run (m, d) over the longest of the lengths times ``LONGER``."""
    invariants, n = top.invariants(), np.arange(len(states))
    values = series_rows(top, invariants, n, h, states)
    for T in lengths:
        short, long = round(T / h) + 1, round(LONGER * T / h) + 1
        if len(states) < long:
            return  # a scheme that breaks down: there is no truth beyond
        for row in invariant_report(top, invariants, n[:short], h, states[:short])[0]:
            deviation = values[row.name][0, :long] - values[row.name][0, 0]
            slope = np.polyfit(h * n[:long], deviation, 1)[0]
            displacement = deviation[long // 2 :].mean() - deviation[:short].mean()
            yield Judged(scheme, scene, T, row, float(slope), float(displacement))


def measured(h: float, lengths: Sequence[float] = LENGTHS) -> list[Judged]:
    """All verdicts with steps of h."""
    N, found = round(LONGER * max(lengths) / h), []
    for title, (scheme, scenes) in SCHEMES.items():
        for scene in scenes:
            whole = topcli.simulate(scene, scheme=scheme, h=h, N=N)
            found += judged_lengths(title, scene, whole.top, h, whole.states, lengths)
    return found


def random_states(h: float, count: int, lengths: Sequence[float] = (20.0, 35.0, 60.0)) -> list[Judged]:
    """Verdicts on HK, whose deviations come back, from ``count`` random states of each scene's lengths of vectors."""
    random, found = np.random.default_rng(5), []
    N = round(LONGER * max(lengths) / h)
    for scene in SCENES:
        first = topcli.simulate(scene, N=1).states[0].reshape(-1, 3)
        states = random.normal(size=(count, *first.shape))
        states *= np.linalg.norm(first, axis=-1, keepdims=True) / np.linalg.norm(states, axis=-1, keepdims=True)
        for i, state in enumerate(states.reshape(count, 1, -1)):
            run = topcli.simulate(scene, scheme="hk", h=h, N=N, states=state, output={})
            if np.isfinite(run.states).all():
                found += judged_lengths("HK", f"{scene}, random state {i}", run.top, h, run.states[0], lengths)
    return found


def with_changes(h: float, lengths: Sequence[float] = (60.0, 100.0, 300.0)) -> Counter[tuple[str, float, bool]]:
    """Numbers of bounds of drifts under HK with a change added to the deviations, by change, size, and if too low."""
    counts: Counter[tuple[str, float, bool]] = Counter()
    for scene in SCENES:
        run = topcli.simulate(scene, scheme="hk", h=h, N=round(max(lengths) / h))
        invariants = run.top.invariants()
        for n in (np.arange(round(T / h) + 1) for T in lengths):
            states = run.states[: len(n)]
            rows = series_rows(run.top, invariants, n, h, states)
            values = {invariant.name: rows[invariant.name] for invariant in invariants}
            exact = {row.name for row in tally_of(rows).report() if row.verdict == "exact"}
            for (name, change), size in product(CHANGES.items(), SIZES):
                added = size * change(n / n[-1])
                columns = {key: column + np.ptp(column) * added for key, column in values.items()}
                for row in tally_of(Rows(rows.plan, n, states[None], columns=columns)).report():
                    if row.drift_bound is not None and row.name not in exact:
                        low = bool(row.drift_bound * n[-1] * h < 0.999 * size * np.ptp(values[row.name]))
                        counts[name, size, low] += 1
    return counts


def table(found: Sequence[Judged]) -> str:
    """Verdicts by scheme, with the numbers of wrong ones, as Markdown."""
    words = ("exact", "no drift seen", "drifting", "undecided", "lost")
    lines = [["scheme", *words, "false *drifting*", "bound too low"]]
    for title in (*SCHEMES, "all"):
        own = [one for one in found if title in (one.scheme, "all")]
        if not own:
            continue
        counts = Counter(one.row.verdict for one in own)
        wrong = sum(one.false_alarm for one in own), sum(one.bound_too_low for one in own)
        lines.append([title, *(str(counts[word]) for word in words), *map(str, wrong)])
    return "\n".join(Cells("", lines[0], lines[1:]).markdown())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=float, nargs="+", default=[0.02, 0.05], metavar="H", help="lengths of a step")
    parser.add_argument("--states", type=int, metavar="K", help="HK from K random states in each scene instead")
    options = parser.parse_args()
    if options.states:
        found = [judged for h in options.steps for judged in random_states(h, options.states)]
    else:
        found = [judged for h in options.steps for judged in measured(h)]
    print(table(found))
    if not options.states:
        counts = sum((with_changes(h) for h in options.steps), Counter())
        lines = [["change", *(f"size {size:g}" for size in SIZES)]]
        for name in CHANGES:
            both = [(counts[name, size, True], counts[name, size, False]) for size in SIZES]
            lines.append([name, *(f"{low} of {low + covered}" for low, covered in both)])
        print("", *Cells("", lines[0], lines[1:]).markdown(), sep="\n")
    for one in found:
        if one.false_alarm or one.bound_too_low:
            print(f"\n{one.scheme}, {one.scene}, T = {one.T:g}: {one.row.name}: {one.row.statement}")
            print(f"longer run: slope {one.slope:.2e}, displacement {one.displacement:.2e}")


if __name__ == "__main__":
    main()
