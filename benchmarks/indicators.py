"""Measure misses and false alarms of the indicators of chaos: the table of docs/chaos.md.

    python benchmarks/indicators.py [--orbits 128] [--steps 10000 100000] [--write]

The orbits are those of seven maps of `hk` from random states. Their truth is the verdict of runs 20 times as long;
orbits on which these do not decide, or which broke off, do not count. 10 s for 10000 steps on two cores, 2 minutes for
100000. `--write` puts the table on the page.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src")]

import topcli  # noqa: E402
from topcli.analysis.frequencies import agreement_digits  # noqa: E402
from topcli.analysis.lyapunov import Verdict, growth_of  # noqa: E402
from topcli.schemes.registry import find_scheme  # noqa: E402
from topcli.table import markdown_table  # noqa: E402
from topcli.tops import TOPS  # noqa: E402

PAGE = ROOT / "docs" / "chaos.md"
LONGER = 20
"""Length of the runs from which the truth is taken, in those of the indicators."""
FEW, MANY = 2.0, 4.0
"""Digits below which an orbit counts as chaotic, and from which on as regular."""
HELD = 1 << 24
"""Numbers of the orbits held in memory at a time."""
MAPS = (
    ("kowalevski", 0.1, 1.5),
    ("kowalevski", 0.3, 1.5),
    ("kowalevski", 0.6, 1.5),
    ("lagrange", 0.3, 1.5),
    ("heavy", 0.05, 1.5),
    ("goryachev-chaplygin", 0.2, 1.5),
    ("kirchhoff", 0.2, 1.0),
)
"""Top, step size, and standard deviation of the first vector of the initial states."""


def random_states(form: str, scale: float, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Initial states (count, d): the first vector normal, the second on the unit sphere."""
    y = rng.normal(size=(count, len(TOPS[form].components)))
    y[:, :3] *= scale
    y[:, 3:] /= np.linalg.norm(y[:, 3:], axis=1)[:, None]
    return y


def growth_verdicts(form: str, h: float, N: int, y: NDArray[np.float64]) -> list[Verdict]:
    """Verdicts from the growth of tangent vectors over ``N`` steps."""
    top, scheme = TOPS[form].new(), find_scheme("hk", form)
    return growth_of(top, scheme, scheme.build(top, scheme.options()), h, N, y).verdicts


def fewest_digits(form: str, h: float, N: int, y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weighted Birkhoff digits of each orbit (m,): the fewest of its components."""
    config = {"top": {"kind": form}, "scheme": "hk", "h": h, "N": N, "output": {"every": 1}}
    at_once, found = max(1, HELD // (N * y.shape[1])), []
    for first in range(0, len(y), at_once):
        states = topcli.simulate_ensemble(config, states=y[first : first + at_once]).states
        found.append(agreement_digits(np.ascontiguousarray(np.moveaxis(states, 2, 1))).min(axis=1))
    return np.concatenate(found)


def digit_verdicts(digits: NDArray[np.float64]) -> list[Verdict]:
    """Verdicts from digits alone."""
    kinds = (Verdict.CHAOTIC, Verdict.UNDECIDED, Verdict.REGULAR)
    return [
        Verdict.BROKE_OFF if not np.isfinite(count) else kinds[int(count >= FEW) + int(count >= MANY)]
        for count in digits
    ]


class Score(NamedTuple):
    """Numbers of orbits on which an indicator is right or not."""

    indicator: str
    N: int
    regular: int
    chaotic: int
    missed: int
    false: int
    undecided: int

    @classmethod
    def of(cls, indicator: str, N: int, found: Sequence[Verdict], truth: Sequence[Verdict]) -> Score:
        """Score of the verdicts ``found``, for orbits of which the truth is known."""
        pairs: list[tuple[Any, Any]] = [
            pair for pair in zip(found, truth, strict=True) if pair[1] in (Verdict.REGULAR, Verdict.CHAOTIC)
        ]
        kinds = [kind for _, kind in pairs]
        return cls(
            indicator,
            N,
            kinds.count(Verdict.REGULAR),
            kinds.count(Verdict.CHAOTIC),
            pairs.count((Verdict.REGULAR, Verdict.CHAOTIC)),
            pairs.count((Verdict.CHAOTIC, Verdict.REGULAR)),
            sum(verdict is Verdict.UNDECIDED for verdict, _ in pairs),
        )


def scores(orbits: int, N: int, seed: int = 7) -> Iterator[Score]:
    """Scores of the indicators after ``N`` steps, for ``orbits`` orbits of each map."""
    rng = np.random.default_rng(seed)
    truth: list[Verdict] = []
    growth: list[Verdict] = []
    digits: list[Verdict] = []
    for form, h, scale in MAPS:
        y = random_states(form, scale, orbits, rng)
        truth += growth_verdicts(form, h, LONGER * N, y)
        growth += growth_verdicts(form, h, N, y)
        digits += digit_verdicts(fewest_digits(form, h, N, y))
    yield Score.of("tangent growth", N, growth, truth)
    yield Score.of("weighted Birkhoff digits", N, digits, truth)


def table(found: Sequence[Score]) -> list[str]:
    """Rows of the table in Markdown."""
    header = ["indicator", "steps", "regular", "chaotic", "missed", "false alarms", "undecided"]
    return markdown_table([header, *([str(cell) for cell in score] for score in found)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--orbits", type=int, default=128, help="orbits of each map")
    parser.add_argument("--steps", type=int, nargs="+", default=[10_000, 100_000], help="lengths of the orbits")
    parser.add_argument("--write", action="store_true", help="write the table to docs/chaos.md")
    given = parser.parse_args()
    lines = table([score for N in given.steps for score in scores(given.orbits, N)])
    print("\n".join(lines))
    if given.write:
        text = PAGE.read_text(encoding="utf-8")
        filled = re.sub(
            r"(<!-- indicators -->\n).*?(?=<!-- end -->)",
            lambda m: m[1] + "\n".join(lines) + "\n",
            text,
            flags=re.DOTALL,
        )
        PAGE.write_text(filled, encoding="utf-8")


if __name__ == "__main__":
    main()
