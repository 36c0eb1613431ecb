"""Machine code on disk: found by the next process, and only what its owner wrote, for this function, is loaded."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from conftest import GEN, ROOT, Said
from injected import python_process
from steppers import EXPLODE
from topcli.engine import native
from topcli.engine.native import native as compiled
from topcli.engine.run import Run
from topcli.tops.kowalevski import Kowalevski


def _double(x, n):
    x[0] = 2.0 * x[0]
    return n


def _triple(x):
    x[0] = 3.0 * x[0]
    return 0


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cache folder, holding ``_double``."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert not works().cached
    assert works().cached
    return tmp_path / "topcli"


def works() -> native.Native:
    """``_double``, which gives the right result whatever lies in the cache."""
    found, x = compiled(_double, "pq"), np.array([1.5])
    assert (found(x, 7), x[0]) == (7, 3.0)
    return found


def chown(path: Path) -> None:
    if os.geteuid():
        pytest.skip("needs root to give a file to somebody else")
    os.chown(path, 1234, -1)


def linked(path: Path) -> None:
    """Replace a file or folder by a symbolic link to it."""
    shutil.move(path, path.with_name("moved"))
    path.symlink_to(path.with_name("moved"))


def fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path, 0o600)


HARM: dict[str, Callable[[Path], None]] = {
    "writable by all": lambda path: path.chmod(0o777),
    "writable by the group": lambda path: path.chmod(0o770),
    "another's": chown,
    "symbolic link": linked,
}


@pytest.mark.slow
@pytest.mark.parametrize("harm", HARM)
def test_a_folder_that_another_could_fill_is_not_used(cache: Path, harm: str, cli: Callable[..., Said]) -> None:
    HARM[harm](cache)
    before = sorted(os.listdir(cache))
    assert not works().cached
    assert sorted(os.listdir(cache)) == before
    (line,) = (line for line in cli("--version").out.splitlines() if str(cache) in line)
    assert "(not used: " in line


@pytest.mark.slow
@pytest.mark.parametrize("harm", [*HARM, "fifo"])
def test_a_file_that_another_could_write_is_not_used(cache: Path, harm: str) -> None:
    (path,) = cache.glob("*.o")
    {**HARM, "fifo": fifo}[harm](path)
    assert not works().cached  # and writes a file of its own in its place
    assert works().cached


@pytest.mark.slow
def test_the_folder_is_made_for_its_owner_alone_whatever_is_above(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    above = tmp_path / "shared"
    above.mkdir()
    above.chmod(0o1777)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(above))
    previous = os.umask(0o002)
    try:
        works()
    finally:
        os.umask(previous)
    assert works().cached
    assert (above / "topcli").stat().st_mode & 0o777 == 0o700
    assert {path.stat().st_mode & 0o777 for path in (above / "topcli").iterdir()} == {0o600}


COPIED = """
import sys, shutil
from pathlib import Path
sys.path[:0] = ["tests", "tests/support", "tests/engine"]
import numpy as np
from test_code_cache import _double, _triple
from topcli.engine.native import native
folder = Path(sys.argv[1])
native(_double, "pq")
(one,) = folder.glob("*.o")
native(_triple, "p")
(other,) = set(folder.glob("*.o")) - {one}
shutil.copyfile(one, other)
x = np.array([1.0])
native(_triple, "p")(x)
print(x[0])
"""


@pytest.mark.slow
def test_code_of_another_signature_in_its_place_is_not_run(tmp_path: Path) -> None:
    """In a process of its own: it was a segmentation fault."""
    done = python_process(COPIED, str(tmp_path / "topcli"), cwd=ROOT, NUMBA_CACHE_DIR=str(tmp_path))
    assert (done.returncode, done.stdout) == (0, "3.0\n"), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("place", ["digest", "key", "signature", "symbol", "code", "end"])
def test_a_single_flipped_bit_is_found(cache: Path, place: str) -> None:
    (path,) = cache.glob("*.o")
    data = bytearray(path.read_bytes())
    header = json.loads(bytes(data).split(b"\n")[1])
    at = {
        "digest": 3,
        "key": data.index(header["key"].encode()) + 5,
        "signature": data.index(b'"pq"') + 1,
        "symbol": data.index(header["symbol"].encode()) + 1,
        "code": data.index(b"\n", 80) + 200,
        "end": len(data) - 1,
    }[place]
    data[at] ^= 1
    path.write_bytes(bytes(data))
    assert not works().cached
    assert works().cached


FRESH = """
import sys, types
import topcli.engine.native as native
native.sys = types.SimpleNamespace(platform="darwin", version=sys.version)
assert "llvmlite" not in sys.modules
from topcli.cli.app import app
sys.argv = ["topcli", "run", "euler_hk", "--set", "scheme=taylor", "--set", "N=50", "--out", sys.argv[1], "--quiet"]
app(prog_name="topcli")
"""


@pytest.mark.slow
def test_a_series_is_the_first_code_of_a_process_where_libm_is_not_loaded_by_name(tmp_path: Path) -> None:
    """As on macOS: symbols of the process are found only once there is an engine."""
    done = python_process(FRESH, str(tmp_path / "out"), cwd=tmp_path, NUMBA_CACHE_DIR=str(tmp_path))
    assert (done.returncode, done.stderr) == (0, "")
    assert list((tmp_path / "topcli").glob("*.o"))


@pytest.mark.parametrize(
    ("name", "made"),
    [
        ("get_host_cpu_name", lambda: "another-processor"),
        ("get_host_cpu_features", lambda: {"avx512f": True, "fma": False}),
        ("get_process_triple", lambda: "another-triple"),
    ],
)
def test_code_of_another_processor_is_not_known(monkeypatch: pytest.MonkeyPatch, name: str, made: object) -> None:
    """Two kinds of machines may share the folder of the cache, as in a cluster."""
    import llvmlite.binding as llvm

    class Features(dict[str, bool]):
        def flatten(self) -> str:
            return ",".join(f"{'+' if there else '-'}{feature}" for feature, there in self.items())

    words = native._machine.__wrapped__()[1]
    assert native._machine.__wrapped__()[1] == words
    value = made()  # type: ignore[operator]
    monkeypatch.setattr(llvm, name, lambda: Features(value) if isinstance(value, dict) else value)
    assert native._machine.__wrapped__()[1] != words


# code from one process to the next

PLUGIN_FILE = """
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
from topcli.engine.run import Run
from topcli.schemes.plugins import load_plugin_file
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski
load_plugin_file(Path(sys.argv[1]))
top = Kowalevski()
mine = find_scheme("mine", "kowalevski")
run = Run(top, mine.build(top, mine.options()), (1.0, 0.0, 0.0, 1.0, 0.0, 0.0), 0.1, 3)
last = [chunk.states[-1, 0] for chunk in run if len(chunk.n)][-1]
print(json.dumps({"last": last, "cached": run.cached, "numba": "numba" in sys.modules}))
"""


def probe(tmp_path: Path, cache: Path, factor: float) -> dict:
    file = tmp_path / "mine.py"
    file.write_text(PLUGIN_FILE.format(factor=factor))
    done = python_process(PROBE, str(file), cwd=ROOT, NUMBA_CACHE_DIR=str(cache))
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
def test_runs_without_a_cache_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("not a folder")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(blocker))
    run = Run(Kowalevski(), EXPLODE, GEN, 0.01, 5)
    assert not run.cached
    assert len(run.collect().n) == 6


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
    both = [python_process(REFERENCE_PROBE, cwd=ROOT, NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2)]
    printed = [done.stdout.split() for done in both]
    assert printed[0][0] == printed[1][0]
    assert [numba for _, numba in printed] == ["True", "False"]
