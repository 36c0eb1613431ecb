"""Measure misses and false alarms of the indicators of chaos, and the coverage of intervals: tables of docs/chaos.md.

    python benchmarks/indicators.py [--orbits 128] [--steps 10000 100000] [--write]

The orbits of the first table are those of seven maps of `hk` from random states. Their truth is the verdict of runs 20
times as long; orbits on which these do not decide, or which broke off, do not count. 10 s for 10000 steps on two cores,
2 minutes for 100000. The second table counts verdicts on orbits that are not chaotic but have tangent vectors that grow
exponentially for a while or for ever, at 60 lengths (1 minute). The third compares intervals of exponents with their
scatter over 64 starts in one chaotic sea. `--write` puts the tables on the page.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src")]

import topcli  # noqa: E402
from topcli.analysis.frequencies import agreement_digits  # noqa: E402
from topcli.analysis.lyapunov import LEAST_STEPS, Growth, Verdict, growth_of  # noqa: E402
from topcli.config.load import load_experiment  # noqa: E402
from topcli.schemes.registry import find_scheme  # noqa: E402
from topcli.table import Cells  # noqa: E402
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
        states = topcli.simulate(config, states=y[first : first + at_once]).states
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
    return Cells("", header, [[str(cell) for cell in score] for score in found]).markdown()


def growth_along(config: Any, y: NDArray[np.float64], N: int) -> Growth:
    """Growth of tangent vectors along the orbits of a config from the states ``y`` (m, d)."""
    experiment = load_experiment(config, [f"N={N}"])
    return growth_of(experiment.top, experiment.scheme, experiment.method(), experiment.h, N, y)


def of_field(field: Mapping[str, str], scheme: str, h: float) -> dict[str, Any]:
    """Config with a field of its own; the initial state is given elsewhere."""
    top = {"kind": "custom", "components": list(field), "field": dict(field)}
    return {"name": "orbit", "top": top, "initial": dict.fromkeys(field, 0.0), "scheme": scheme, "h": h, "N": 1000}


def euler(h: float) -> dict[str, Any]:
    """Config of `hk` for Euler's top."""
    initial = {"omega": [0.0, 1.0, 0.0]}
    return {"name": "euler", "top": "euler", "initial": initial, "scheme": "hk", "h": h, "N": 1000}


DEPTHS = np.arange(0.5, 7.0, 0.5)
"""Minus the decimal logarithms of the distances from a separatrix; below 1e-7, round-off decides on which side of it
the orbit goes on."""
LENGTHS = np.unique(np.round(np.geomspace(LEAST_STEPS, 200_000, 60)).astype(int)).tolist()
DUFFING, PENDULUM = {"x": "v", "v": "x - x**3"}, {"q": "p", "p": "sin(q)"}
LORENZ = {"x": "10*(y - x)", "y": "28*x - y - x*z", "z": "x*y - 8/3*z"}
ROESSLER = {"x": "-y - z", "y": "x + 0.2*y", "z": "0.2 + z*(x - 5.7)"}
HENON_HEILES = {"x": "px", "y": "py", "px": "-x - 2*x*y", "py": "-y - x*x + y*y"}

NEUMANN = {
    "name": "neumann",
    "top": {"kind": "clebsch", "omega1": 1.0, "omega2": 2.0, "omega3": 4.0},
    "initial": {"m": [1e-6, 0.0, 0.0], "p": [0.0, 0.0, 1.0]},
    "scheme": "midpoint",
    "h": 0.05,
    "N": 1000,
}


def families() -> Iterator[tuple[str, Any, NDArray[np.float64]]]:
    """Orbits that are not chaotic: a name, a config, and initial states (m, d)."""
    near = [[10.0**-depth, 1.0, 10.0**-depth] for depth in DEPTHS]
    beside = np.array([[10.0**-depth, 0.0] for depth in DEPTHS])
    yield "near separatrices: `hk`, Euler top, h = 0.05", euler(0.05), np.array(near)
    yield "near separatrices: `hk`, Euler top, h = 0.5", euler(0.5), np.array(near)
    yield "near separatrices: Duffing, `midpoint`, h = 0.05", of_field(DUFFING, "midpoint", 0.05), beside
    yield "near separatrices: pendulum, `rk4`, h = 0.05", of_field(PENDULUM, "rk4", 0.05), beside
    rng = np.random.default_rng(3)
    pushed = np.hstack(
        [10.0 ** -rng.uniform(0.5, 7.0, (16, 1)) * rng.normal(size=(16, 3)), np.tile([0.0, 0.0, 1.0], (16, 1))]
    )
    yield "near separatrices: Neumann's problem, `midpoint`, h = 0.05", NEUMANN, pushed
    pushed = np.array([[10.0**-depth, 0.0, 0.0, 0.0, 0.0, 1.0] for depth in DEPTHS])
    yield "unstable periodic orbits: Neumann's problem in a plane", NEUMANN, pushed
    yield "escapes: x' = 0.1 x, `rk4`", of_field({"x": "0.1*x"}, "rk4", 0.02), np.array([[1.0], [1e-6]])
    saddle = of_field({"x": "x", "y": "-y"}, "rk4", 0.002)
    yield "escapes: saddle, `rk4`", saddle, np.array([[1e-6, 1.0], [1.0, 1.0]])
    yield "equilibria: Euler top, `hk`", euler(0.05), np.eye(3)


def family_table() -> list[str]:
    """Numbers of verdicts on each family, in Markdown."""
    kinds = [
        Verdict.CHAOTIC,
        Verdict.REGULAR,
        Verdict.UNDECIDED,
        Verdict.UNSTABLE,
        Verdict.ESCAPING,
        Verdict.EQUILIBRIUM,
    ]
    rows = [["orbits", "runs", *(f"*{kind}*" for kind in kinds)]]
    for name, config, y in families():
        verdicts = [verdict for N in LENGTHS for verdict in growth_along(config, y, N).verdicts]
        rows.append([name, str(len(verdicts)), *(str(verdicts.count(kind)) for kind in kinds)])
    return Cells("", rows[0], rows[1:]).markdown()


def seas() -> Iterator[tuple[str, Any, NDArray[np.float64], int, float | None]]:
    """Chaotic seas: a name, a config, 64 initial states, a length, and the exponent if it is known."""
    scatter = np.random.default_rng(5).normal(size=(64, 3))

    def beside(y: Sequence[float], column: int) -> NDArray[np.float64]:
        states = np.tile(np.array(y, dtype=float), (64, 1))
        states[:, column] += 1e-9 * np.arange(64)
        return states

    lorenz = of_field(LORENZ, "rk4", 0.01)
    yield "Lorenz", lorenz, np.array([1.0, 2.0, 20.0]) + scatter, 20_000, 0.9056
    yield "Lorenz, from (0, 10, 0)", lorenz, beside((0.0, 10.0, 0.0), 0), 100_000, 0.9056
    yield "Rössler", of_field(ROESSLER, "rk4", 0.02), np.array([1.0, 2.0, 0.5]) + 0.3 * scatter, 50_000, 0.0714
    sea = beside((0.0, -0.016, 0.49974, 0.0), 1)
    yield "Hénon–Heiles, E = 1/8", of_field(HENON_HEILES, "hk", 0.05), sea, 1_000_000, None
    for name, scene, h, N in (
        ("Kowalevski top, `hk`, h = 0.6", "kowalevski_generic_hk", 0.6, 20_000),
        ("`heavy_chaotic`", "heavy_chaotic", 0.01, 50_000),
    ):
        config = load_experiment(scene, [f"h={h}"])
        yield name, config.resolved(), beside(config.y0, 0), N, None


def coverage_table() -> list[str]:
    """Scatter of exponents, their intervals and how many of them cover the exponent, in Markdown."""
    rows = [["orbits", "steps", "exponent", "standard deviation", "± (median)", "covered"]]
    for name, config, y, N, exponent in seas():
        growth = growth_along(config, y, N)
        x, errors = growth.exponents, growth.errors
        truth = float(x.mean()) if exponent is None else exponent
        covered = f"{100.0 * np.mean(np.abs(x - truth) <= errors):.0f} %"
        rows.append([name, str(N), f"{truth:.3g}", f"{x.std():.2g}", f"{np.median(errors):.2g}", covered])
    return Cells("", rows[0], rows[1:]).markdown()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--orbits", type=int, default=128, help="orbits of each map")
    parser.add_argument("--steps", type=int, nargs="+", default=[10_000, 100_000], help="lengths of the orbits")
    parser.add_argument("--write", action="store_true", help="write the tables to docs/chaos.md")
    given = parser.parse_args()
    tables = {
        "indicators": table([score for N in given.steps for score in scores(given.orbits, N)]),
        "families": family_table(),
        "coverage": coverage_table(),
    }
    text = PAGE.read_text(encoding="utf-8")
    for name, lines in tables.items():
        print("\n".join([*lines, ""]))
        pattern = rf"(<!-- {name} -->\n).*?(?=<!-- end -->)"
        text = re.sub(pattern, lambda m, lines=lines: m[1] + "\n".join(lines) + "\n", text, flags=re.DOTALL)
    if given.write:
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
