"""Shared scenes of the tests, and a cache of compiled code that lasts from one run of the tests to the next."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by numpy; its threads cost twenty times what they save here

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".pytest_cache" / "kernels"))

# elsewhere hypothesis looks for new failures at every run; a verdict on a change rests on the same examples each time
settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

ATTACK = os.environ.get("HYPOTHESIS_PROFILE") == "attack"
"""True for `make attack`, which tries other examples at every run, and a hundred times as many."""


def examples(count: int) -> settings:
    """Settings of a test of hypothesis that takes long."""
    return settings(
        max_examples=100 * count if ATTACK else count,
        derandomize=not ATTACK,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    )


GEN = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
"""A generic state of the Kowalevski top, far from every special orbit."""
PAPER = (2.0, 0.0, 0.0, math.sqrt(1.0 - 1e-6), 0.0, 1e-3)
"""The paper's initial state, close to a homoclinic orbit."""


def random_states(count: int, seed: int) -> np.ndarray:
    """States (count, 6) with omega of size about one and gamma on the unit sphere."""
    random = np.random.default_rng(seed)
    gamma = random.normal(size=(count, 3))
    gamma /= np.linalg.norm(gamma, axis=1, keepdims=True)
    return np.hstack([random.normal(size=(count, 3)), gamma])


LIMIT = 0.0 if ATTACK else 600.0
"""Seconds after which a test that waits for something fails, 0: never; the longest takes one tenth of them."""


@contextmanager
def limited(what: str) -> Iterator[None]:
    """Fail instead of waiting for longer than ``LIMIT``, also where a library waits without a limit of its own."""

    def give_up(*ignored: object) -> None:
        pytest.fail(f"{what} takes more than {LIMIT:g} s: something is waited for that does not come")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    with limited(f"the preparation of {item.name}"):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    with limited(item.name):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None]:
    with limited(f"the end of {item.name}"):
        return (yield)


@pytest.fixture
def own_registry() -> Iterator[None]:
    """Schemes, tops and measures registered by a test are gone after it."""
    from scheme_files import unchanged_tables

    with unchanged_tables():
        yield


@pytest.fixture
def in_tmp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@dataclass
class Said:
    """Output and exit code of a call of the command."""

    code: int
    out: str
    err: str

    def json(self) -> Any:
        return json.loads(self.out)


@pytest.fixture
def cli(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], in_tmp: Path) -> Callable[..., Said]:
    """Call ``main`` like the installed command, in an empty folder; plugin files are forgotten after each call."""
    from scheme_files import unchanged_tables
    from topcli.__main__ import main

    def call(*arguments: str) -> Said:
        monkeypatch.setattr(sys, "argv", ["topcli", *arguments])
        capsys.readouterr()
        own = "--plugin" in arguments or "check" in arguments[:1]
        with unchanged_tables() if own else nullcontext(), pytest.raises(SystemExit) as leaving:
            main()
        out, err = capsys.readouterr()
        assert "Traceback" not in out + err
        code = leaving.value.code
        return Said(0 if code is None else int(code), out, err)

    return call


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks, row groups and blocks so short that a run of some hundred steps has many, on a disk without delay."""
    for name, value in (("ROWS", 640), ("ROWS_ALONE", 16), ("CHUNK_STEPS", 16)):
        monkeypatch.setattr(f"topcli.engine.integration.{name}", value)
    for name, value in (("ROW_GROUP", 40),):
        monkeypatch.setattr(f"topcli.store.growing_table.{name}", value)
    monkeypatch.setattr(os, "fsync", lambda handle: None)
