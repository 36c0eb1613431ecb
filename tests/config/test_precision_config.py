"""The key ``precision`` and the numbers that go with it, read as they are written."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.errors import ConfigError

LAGRANGE: dict[str, object] = {
    "top": "lagrange",
    "initial": {"omega": [1, 0.1, 2], "gamma": [0.6, 0, 0.8]},
    "scheme": "hk",
    "h": 0.1,
    "N": 9,
}
PI = "3.14159265358979323846264338327950288"


def exact(data: dict[str, object], *overrides: str) -> Experiment:
    return load_experiment(data, overrides, any_precision=True)


OMEGA = "[1.0000000000000000000001, 0, 1e-400]"
YAML = (
    f"top: {{kind: lagrange, mu: {PI}}}\ninitial: {{omega: {OMEGA}, gamma: [0.6, 0, 0.8]}}\nscheme: hk\nh: 0.1\nN: 3\n"
)
TOML = f"scheme = 'hk'\nh = 0.1\nN = 3\n[top]\nkind = 'lagrange'\nmu = {PI}\n"
TOML += f"[initial]\nomega = {OMEGA}\ngamma = [0.6, 0, 0.8]\n"


@pytest.mark.parametrize(("text", "suffix"), [(f"precision: 60\n{YAML}", "yaml"), (f"precision = 60\n{TOML}", "toml")])
def test_numbers_keep_all_their_written_digits(tmp_path: Path, text: str, suffix: str) -> None:
    (tmp_path / f"x.{suffix}").write_text(text)
    read = load_experiment(tmp_path / f"x.{suffix}", any_precision=True)
    assert read.written is not None
    assert read.written.h == Fraction(1, 10)
    assert read.written.parameters["mu"] == Fraction(PI)
    assert read.written.parameters["C"] == Fraction(1, 2)
    assert read.written.y0[:3] == (1 + Fraction(1, 10**22), 0, Fraction(1, 10**400))
    assert read.written.y0[3:] == (Fraction(3, 5), 0, Fraction(4, 5))


def test_fractions_may_be_written() -> None:
    changed = {"h": "1/3", "initial": {"omega": ["-2/7", 0, 1], "gamma": ["2/7", "3/7", "6/7"]}}
    read = exact(LAGRANGE | changed | {"precision": "rational"})
    assert read.written is not None
    assert read.written.h == Fraction(1, 3)
    assert sum(x * x for x in read.written.y0[3:]) == 1
    assert read.h == 1 / 3


@pytest.mark.parametrize("initial", [{"gamma": ["auto", 0, 0.1]}, {"gamma": [1, 2, 3], "normalize": True}])
def test_unit_vectors_are_completed_in_the_precision(initial: dict[str, object]) -> None:
    read = exact(LAGRANGE | {"initial": {"omega": [1, 0, 0], **initial}, "precision": 50})
    assert read.written is not None
    assert abs(sum(x * x for x in read.written.y0[3:]) - 1) < Fraction(1, 10**50)


@pytest.mark.parametrize("precision", [50, "rational"])
def test_resolved_config_loads_to_the_same_experiment(precision: object) -> None:
    changed = {"h": "1/3", "initial": {"omega": [1, PI, 0], "gamma": ["auto", 0, 0.6]}, "precision": precision}
    read = exact(LAGRANGE | changed, "top.mu=2/7")
    again = exact(read.resolved())
    assert again.written == read.written
    assert again.digest == read.digest


def test_commands_that_compute_in_doubles_refuse_another_precision() -> None:
    with pytest.raises(ConfigError, match="precision: computed in doubles here"):
        load_experiment("kowalevski_hk", ["precision=50"])
    assert load("kowalevski_hk", ["precision=50"]).digest != load("kowalevski_hk").digest
