"""Commands on tops and schemes of a user's file: they work, or say in one line what is missing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

import topcli
from conftest import ROOT, Said
from documentation import read_page
from topcli.errors import ConfigError, UsageError
from topcli.schemes import registry

FILES = read_page(ROOT / "docs" / "own-scheme.md").files()
COUNTING = """
import topcli
from topcli.contracts import Stepper
from topcli.schemes.kowalevski.hk import hk_kowalevski

def step(y, h, p):
    new = hk_kowalevski(y[:6], h, p)
    return (new[0], new[1], new[2], new[3], new[4], new[5], y[6] + 2.0)

@topcli.scheme("counting", top="kowalevski", title="HK", order=2, explicit=True, self_adjoint=True, citation="none",
               equations="none")
def build(top, options):
    '''HK that counts two events a step.'''
    return Stepper(step, 7, lambda y, h, p: (*y, 0.0), lambda y, h, p: y[:6], counters=("pairs",))
"""


@pytest.fixture
def own(cli: Callable[..., Said]) -> Iterator[Callable[..., Said]]:
    """Call a command with the gyrostat of the page on own schemes."""
    for name, text in FILES.items():
        Path(name).write_text(text)
    yield lambda *arguments: cli(*arguments, "--scheme-file", "gyrostat.py")
    registry.unload_scheme_files()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("stress", "heun", "--top", "gyrostat"),
            "the top gyrostat has no hard cases; those with cases: euler, euler+g",
        ),
        (("stress", "--top", "gyrostat"), "the top gyrostat has no hard cases; those with cases: euler, euler+gamma"),
        (("stress", "heun"), "none of the schemes heun has one of the cases; see topcli list cases"),
        (("order", "heun", "--config", "rotor.yaml"), "the reference needs its Euler-Poisson equations, which it does"),
        (("compare", "heun", "rk4", "--config", "rotor.yaml"), "not give; define euler_poisson()"),
        (("order", "heun", "--top", "gyrostat"), "--top: no scene for the top 'gyrostat'; known: euler"),
        (("run", "rotor.yaml", "--set", "scheme=dmv"), "use a scheme that needs the field alone, such as rk4"),
    ],
)
def test_what_a_gyrostat_lacks_is_said_in_one_line(
    own: Callable[..., Said], arguments: tuple[str, ...], message: str
) -> None:
    said = own(*arguments)
    assert (said.code, len(said.err.splitlines()), said.out) == (2, 1, "")
    assert message in said.err


def test_init_chooses_a_scheme_that_the_top_can_have(own: Callable[..., Said]) -> None:
    """dmv, the first by name, needs equations that a gyrostat does not give."""
    said = own("init", "mine.yaml", "--top", "gyrostat")
    assert (said.code, said.err.splitlines()[0]) == (0, "wrote mine.yaml and topcli.schema.json")
    text = Path("mine.yaml").read_text()
    assert "name: dop853" in text
    assert "dmv" in text.partition("# one of ")[2].partition("\n")[0]
    assert own("run", "mine.yaml", "--set", "N=20").code == 0
    assert own("init", "other.yaml", "--top", "gyrostat", "--scheme", "heun").code == 0
    assert own("run", "other.yaml", "--set", "N=20").code == 0


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        (["0.1,0.05"], "--h '0.1,0.05': must be one number; repeat the option for several: --h 0.1 --h 0.05"),
        (["0.1", "1e-2, 2e-2"], "repeat the option for several: --h 0.1 --h 1e-2 --h 2e-2"),
        (["fine"], "--h 'fine': must be one number; for example --h 0.1 --h 0.05"),
    ],
)
def test_several_step_sizes_in_one_option_are_refused(cli: Callable[..., Said], sizes: list[str], message: str) -> None:
    said = cli("order", "hk", *(part for size in sizes for part in ("--h", size)))
    assert (said.code, len(said.err.splitlines())) == (2, 1)
    assert message in said.err
    assert "pydantic" not in said.err


def test_order_takes_the_content_of_a_config() -> None:
    config: dict[str, Any] = {"top": "euler", "initial": {"omega": [0.2, 1, 0.1]}, "scheme": "hk", "h": 0.1, "N": 20}
    found = topcli.order("hk", config=config, sizes=[0.1, 0.05, 0.025], progress=False)
    assert found.study["duration"] == 2.0
    assert found.study["config"]["initial"] == {"omega": [0.2, 1.0, 0.1]}
    assert found.table.loc["hk", "verdict"] == "as declared"
    with pytest.raises(ConfigError, match="initial: missing"):
        topcli.order("hk", config={"top": "euler"}, progress=False)
    with pytest.raises(UsageError, match="computed in doubles"):
        topcli.order("hk", config={**config, "precision": 50}, progress=False)


SWEEP = """
base:
  top: kowalevski
  initial: {omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}
  scheme: hk
  h: 0.01
  N: 60
grid: {scheme: [rk4, counting]}
measure: [%s]
"""


def test_a_counter_that_only_some_schemes_have_is_empty_for_the_others(cli: Callable[..., Said]) -> None:
    Path("counting.py").write_text(COUNTING)
    try:
        Path("study.yaml").write_text(SWEEP % "counter.pairs, steps")
        said = cli("sweep", "study.yaml", "--scheme-file", "counting.py")
        assert said.code == 0, said.err
        rows = {row["scheme"]: row for row in pq.read_table("results/study/rows.parquet").to_pylist()}
        assert rows["counting"]["counter.pairs"] == 120.0
        empty = rows["rk4"]["counter.pairs"]
        assert empty is None or math.isnan(empty)
        assert {row["outcome"] for row in rows.values()} == {"completed"}
        Path("wrong.yaml").write_text(SWEEP % "counter.pears")
        refused = cli("sweep", "wrong.yaml", "--scheme-file", "counting.py")
        assert refused.code == 2
        assert "has no counter 'pears'" in refused.err
    finally:
        registry.unload_scheme_files()
