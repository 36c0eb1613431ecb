"""The engine: compiled equals plain, chunked equals whole, failures at the exact step, the cache of machine code."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from conftest import GEN, PAPER, ROOT
from steppers import EXPLODE, RK2
from topcli.contracts import Outcome, Stepper
from topcli.engine import loop, native
from topcli.engine.fingerprint import fingerprint
from topcli.engine.loop import Run
from topcli.schemes.registry import all_schemes
from topcli.tops import TOPS
from topcli.tops.kowalevski import Kowalevski


def rows(run: Run) -> tuple[np.ndarray, np.ndarray]:
    n, states, _ = run.collect()
    return n, states


@pytest.mark.slow
@pytest.mark.parametrize("scheme", all_schemes(), ids=lambda s: f"{s.name}/{s.top}")
@pytest.mark.parametrize("every", [1, 7])
def test_chunked_equals_whole(scheme, every: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cutting a run into pieces of awkward sizes changes no bit and loses no row."""
    top = TOPS[scheme.top]()
    stepper = scheme.build(top, scheme.options())
    y0 = GEN[: len(top.components)]
    whole_n, whole = rows(Run(top, stepper, y0, 0.01, 1000, every))
    monkeypatch.setattr(loop, "CHUNK_STEPS", 23)
    monkeypatch.setattr(loop, "CHUNK_ROWS", 5)
    cut_n, cut = rows(Run(top, stepper, y0, 0.01, 1000, every))
    assert (cut_n == whole_n).all()
    assert (whole_n == np.arange(0, 1001, every)).all()
    assert (cut == whole).all()


def test_recording_every_k_is_a_slice_of_recording_all() -> None:
    _, all_states = rows(Run(Kowalevski(), RK2, GEN, 0.01, 1000))
    _, some = rows(Run(Kowalevski(), RK2, GEN, 0.01, 1000, 9))
    assert (some == all_states[::9]).all()


def test_collected_rows_are_those_of_all_chunks_and_outlive_the_run() -> None:
    """Three chunks in one buffer; a run that goes on from its last step has no further row."""
    first = Run(Kowalevski(), RK2, GEN, 1e-3, 20_000)
    n, states = zip(*((chunk.n.tolist(), chunk.states.tolist()) for chunk in first), strict=True)
    second = Run(Kowalevski(), RK2, GEN, 1e-3, 20_000)
    kept = second.collect()
    assert kept.n.tolist() == list(chain(*n))
    assert kept.states.tolist() == list(chain(*states))
    assert kept.ending is second.ending
    over = Run(Kowalevski(), RK2, GEN, 1e-3, 20_000, start=first.position()).collect()
    assert (over.n.shape, over.states.shape, over.ending) == ((0,), (0, 6), kept.ending)


@pytest.mark.parametrize("N", [1, 2, 8192, 8193])
def test_every_run_length_records_the_same_states(N: int) -> None:
    run = Run(Kowalevski(), RK2, GEN, 1e-3, N)
    n, states = rows(run)
    assert len(n) == len(states) == N + 1
    assert run.ending is not None
    assert run.ending.outcome is Outcome.COMPLETED
    assert run.ending.step == N
    assert run.ending.t == N * 1e-3


def test_blow_up_is_found_at_its_step_and_what_came_before_is_kept() -> None:
    """2**(2**k) overflows float64 at k = 10."""
    run = Run(Kowalevski(), EXPLODE, PAPER, 0.5, 100)
    n, states = rows(run)
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step, run.ending.t) == (Outcome.BLEW_UP, 10, 5.0)
    assert list(n) == list(range(10))
    assert states[-1, 0] == 2.0**512


def test_stop_between_chunks_ends_as_interrupted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "CHUNK_STEPS", 100)
    asked = iter([False, False, True])
    run = Run(Kowalevski(), RK2, GEN, 0.01, 1000, stop=lambda: next(asked))
    n, _ = rows(run)
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step) == (Outcome.INTERRUPTED, 200)
    assert n[-1] == 200


def test_negative_h_retraces_to_the_order_of_the_scheme() -> None:
    _, there = rows(Run(Kowalevski(), RK2, GEN, 1e-3, 1000))
    _, back = rows(Run(Kowalevski(), RK2, there[-1], -1e-3, 1000))
    assert 0 < np.abs(back[-1] - GEN).max() < 1e-8  # typically 4e-10


SCHEME_FILE = """
import topcli
from topcli.contracts import Stepper

FACTOR = {factor}

def helper(x):
    return FACTOR * x

def step(s, h, p):
    return (helper(s[0]), s[1], s[2], s[3], s[4], s[5])

@topcli.scheme("mine", top="kowalevski", title="mine", order=1, explicit=True, self_adjoint=False,
               citation="none", equations="none")
def mine(top, options):
    '''Multiply omega1 by a constant.'''
    return Stepper(step, 6)
"""

PROBE = """
import json, sys
from itertools import chain
from pathlib import Path
from topcli.engine.loop import Run
from topcli.schemes.registry import find_scheme, load_scheme_file
from topcli.tops.kowalevski import Kowalevski
load_scheme_file(Path(sys.argv[1]))
top = Kowalevski()
run = Run(top, find_scheme("mine", "kowalevski").build(top, None), (1.0, 0.0, 0.0, 1.0, 0.0, 0.0), 0.1, 3)
last = [chunk.states[-1, 0] for chunk in run if len(chunk.n)][-1]
print(json.dumps({"last": last, "cached": run.cached, "numba": "numba" in sys.modules}))
"""


def probe(tmp_path: Path, cache: Path, factor: float) -> dict:
    file = tmp_path / "mine.py"
    file.write_text(SCHEME_FILE.format(factor=factor))
    done = subprocess.run(
        [sys.executable, "-c", PROBE, str(file)],
        capture_output=True,
        text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_second_process_hits_the_cache_and_an_edited_kernel_is_recompiled(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert probe(tmp_path, cache, 2.0) == {"last": 8.0, "cached": False, "numba": True}
    assert probe(tmp_path, cache, 2.0) == {"last": 8.0, "cached": True, "numba": False}
    assert probe(tmp_path, cache, 3.0) == {"last": 27.0, "cached": False, "numba": True}
    stored = sorted((cache / "topcli").iterdir())
    assert len(stored) == 2
    for path in stored:  # damaged machine code is never run
        path.write_bytes(path.read_bytes()[:-7] + b"garbage")
    assert probe(tmp_path, cache, 2.0) == {"last": 8.0, "cached": False, "numba": True}


@pytest.mark.slow
def test_cached_code_equals_fresh_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    fresh_run = Run(Kowalevski(), RK2, GEN, 0.01, 500)
    cached_run = Run(Kowalevski(), RK2, GEN, 0.01, 500)
    assert (fresh_run.cached, cached_run.cached) == (False, True)
    assert (rows(fresh_run)[1] == rows(cached_run)[1]).all()


@pytest.mark.slow
def test_runs_without_a_cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("not a folder")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocker))
    run = Run(Kowalevski(), EXPLODE, GEN, 0.01, 5)
    assert not run.cached
    assert len(rows(run)[0]) == 6


@pytest.mark.slow
def test_cache_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("topcli.engine.code_cache.CACHE_ENTRIES", 2)
    folder = tmp_path / "topcli"
    folder.mkdir()
    for i in range(5):
        (folder / f"{i}.o").write_bytes(b"old")
        os.utime(folder / f"{i}.o", (i, i))
    Run(Kowalevski(), EXPLODE, GEN, 0.01, 5)
    assert len(list(folder.glob("*.o"))) == 2


def test_fingerprint_follows_kernels_constants_and_closures() -> None:
    def make(constant: float, inner):
        def step(s, h, p):
            return (inner(s[0]) + constant,)

        return step

    def double(x):
        return x + x

    def triple(x):
        return x + x + x

    same = fingerprint(make(1.0, double))
    assert fingerprint(make(1.0, double)) == same
    assert fingerprint(make(2.0, double)) != same
    assert fingerprint(make(1.0, triple)) != same
    assert fingerprint(make(1.0, double), None) != fingerprint(None, make(1.0, double))


def test_arrays_of_the_wrong_kind_are_refused_by_the_loop() -> None:
    compiled = native.native(_first, "p")
    assert compiled(np.array([3.0])) == 3
    with pytest.raises(TypeError, match="float64"):
        compiled(np.array([3]))
    with pytest.raises(TypeError, match="contiguous"):
        compiled(np.arange(10.0)[::2])


def _first(x):
    return int(x[0])


def test_counters_are_reported() -> None:
    run = Run(
        Kowalevski(),
        Stepper(_counting, 7, enter=_with_count, leave=_without_count, counters=("even",)),
        GEN,
        0.1,
        10,
    )
    rows(run)
    assert run.ending is not None
    assert run.ending.counters == {"even": 10}


def _counting(s, h, p):
    return (s[0], s[1], s[2], s[3], s[4], s[5], s[6] + 1.0)


def _without_count(s, h, p):
    return (s[0], s[1], s[2], s[3], s[4], s[5])


def _with_count(s, h, p):
    return (s[0], s[1], s[2], s[3], s[4], s[5], 0.0)


REFERENCE_PROBE = """
import sys
import numpy as np
from topcli.analysis.reference import reference_states
from topcli.tops.kowalevski import Kowalevski
states = reference_states(Kowalevski(), (0.7, -0.4, 1.3, 0.6, 0.48, 0.64), np.linspace(0.0, 5.0, 11))
print(states.tobytes().hex(), "numba" in sys.modules)
"""


@pytest.mark.slow
def test_code_with_functions_of_its_own_survives_the_cache(tmp_path: Path) -> None:
    """The reference is compiled without forced inlining and mentions numba's own symbols."""
    printed = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", REFERENCE_PROBE],
            capture_output=True,
            text=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            cwd=ROOT,
            check=True,
        )
        printed.append(done.stdout.split())
    assert printed[0][0] == printed[1][0]
    assert [numba for _, numba in printed] == ["True", "False"]


def _doubled(s, h, p):
    return (2.0 * s[0], 2.0 * s[1], s[2], s[3], s[4], s[5])


def test_largest_finite_states_do_not_fail() -> None:
    """Their sum overflows a step before one of them does; the run ends at the first step at which one does."""
    start = 2.0**1000
    run = Run(Kowalevski(), Stepper(_doubled, 6), (start, start, 1.0, 0.6, 0.48, 0.64), 0.1, 50)
    n, states = rows(run)
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step, n[-1]) == (Outcome.BLEW_UP, 24, 23)
    assert states[-1, 0] == 2.0**1023
    assert math.isinf(float(states[-1, 0]) + float(states[-1, 1]))
