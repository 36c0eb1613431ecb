"""Configs as texts, and what is said about wrong ones."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from topcli.config.load import load_experiment
from topcli.errors import UsageError

CONFIGS = Path(__file__).parents[2] / "configs"
ENSEMBLES = sorted(CONFIGS.glob("*_ensemble.yaml"))
FILES = sorted(path for path in CONFIGS.iterdir() if path.suffix in (".yaml", ".toml") and path not in ENSEMBLES)
"""The configs of single runs."""
PAPER_GAMMA = (math.sqrt(1.0 - 1e-6), 0.0, 1e-3)

BASE = """\
name: x
top: {kind: kowalevski, c0: 1}
initial:
  omega: [2, 0, 0]
  gamma: [auto, 0, 1e-3]
scheme: hk
h: 0.001
N: 100
output:
  format: csv
"""
BASE_TOML = """\
scheme = "hk"  # a comment with h = 3
h = 0.001
N = 100
[top]
kind = "kowalevski"
c0 = 1.0
[initial]
omega = [2, 0,
   0]
gamma = ["auto", 0, 1e-3]
[output]
every = 20
"""
ENSEMBLE_TEXT = """\
top: {kind: kowalevski, c0: 1}
initial:
  omega: [2, 0, 0]
  gamma: [auto, 0, 1e-3]
ensemble:
  random:
    count: 50
    gamma: sphere
scheme: hk
h: 0.001
N: 100
"""
SWEEP_TEXT = """\
base:
  top: kowalevski
  initial: {omega: [2, 0, 0], gamma: [auto, 0, 0.1]}
  scheme: hk
  h: 0.01
  N: 100
"""
PLAIN: dict[str, Any] = {
    "top": "kowalevski",
    "initial": {"omega": [2, 0, 0], "gamma": ["auto", 0, 1e-3]},
    "scheme": "hk",
    "h": 0.001,
    "N": 100,
}


def write(folder: Path, text: str | bytes, name: str = "bad.yaml") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(path: Path | str, overrides: tuple[str, ...] = ()) -> str:
    """The message of the refused config, which has one to three lines."""
    with pytest.raises(UsageError) as caught:
        load_experiment(path, overrides)
    message = str(caught.value)
    assert caught.value.exit_code == 2
    assert 1 <= len(message.splitlines()) <= 3
    return message
