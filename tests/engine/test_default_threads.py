"""The number of threads of this process, which a worker of a cluster limits."""

from __future__ import annotations

import os

import pytest

from topcli.engine import ensemble


def test_a_limit_is_an_upper_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "_most_threads", None)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(6)), raising=False)
    assert ensemble.default_threads() == 6
    ensemble.limit_threads(2)
    assert ensemble.default_threads() == 2
    ensemble.limit_threads(8)
    assert ensemble.default_threads() == 6
