"""Machine code on disk: found by the next process, by a key that every edit changes, and only if its owner wrote it."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cases import parts_of
from conftest import ROOT
from injected import python_process
from scheme_files import run_scheme, write_scheme
from topcli.engine import native as machine_code
from topcli.engine.native import native
from topcli.engine.reach import reach
from topcli.errors import SchemeCodeError

STEPS = parts_of(Path(__file__).with_name("edits.txt"))
"""Bodies of scheme files, with REST for the components that stay."""
REFUSED = [name for name in STEPS if name.startswith("refused")]
HELPERS = {
    "consts.py": "import numpy as np\nimport inner\nG = 2.0\nA = np.array([1.0, 2.0])\ntimes = inner.times\n",
    "inner.py": "def times(x):\n    return 2.0 * x\n",
    "parts/consts.py": "G = 2.0\n",
    "parts/__init__.py": "",
}
"""Modules beside a scheme file."""


def write_files(folder: Path, name: str, factor: str) -> Path:
    """A scheme file and the modules beside it with ``factor`` where the text says 2.0."""
    (folder / "parts").mkdir(exist_ok=True)
    for helper, text in HELPERS.items():
        (folder / helper).write_text(text.replace("2.0", factor))
    return write_scheme(folder, STEPS[name].replace("REST", "s[1], s[2], s[3], s[4], s[5]").replace("2.0", factor))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in STEPS if name not in REFUSED])
def test_an_edit_is_compiled_and_its_undoing_is_found(name: str, tmp_path: Path, monkeypatch) -> None:
    """Same size, same second: 2.0 becomes 4.0 and back."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    runs = [run_scheme(write_files(tmp_path, name, factor)) for factor in ("2.0", "4.0", "2.0")]
    assert [(run.value, run.cached) for run in runs] == [(4.0, False), (16.0, False), (4.0, True)]


@pytest.mark.parametrize("name", REFUSED)
def test_what_compiled_code_cannot_refer_to_is_refused_by_name(name: str, tmp_path: Path) -> None:
    with pytest.raises(SchemeCodeError) as refusal:
        run_scheme(write_files(tmp_path, name, "2.0"))
    message = str(refusal.value)
    for part in ("mine.py:", *name.split(": ")[2:]):
        assert part in message
    assert "\n" not in message


VALUES = [0.0, -0.0, 1, True, 1.0, "1", b"1", (1,), None, 1j, np.float32(1.0), np.zeros(2), np.zeros((2, 1)), math.sin]
VALUES += [np.eye(2, 3), np.asfortranarray(np.eye(2, 3)), np.zeros(2, ">f8"), np.float64]


def test_values_that_differ_in_kind_sign_or_layout_differ() -> None:
    def holder(value: object) -> Callable[[], object]:
        return lambda: value

    digests = [reach(holder(value))[0] for value in VALUES]
    assert len(set(digests)) == len(VALUES)
    assert digests == [reach(holder(value))[0] for value in VALUES]


# the folder


def _double(x, n):
    x[0] = 2.0 * x[0]
    return n


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the machine code, with that of ``_double``."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "new"))
    assert not doubled()
    assert doubled()
    return tmp_path / "new" / "topcli"


def doubled() -> bool:
    """True if the code of ``_double`` was stored; it gives the right result in any case."""
    code, x = native(_double, "pq"), np.array([1.5])
    assert (code(x, 7), x[0]) == (7, 3.0)
    return code.cached


def chown(path: Path) -> None:
    if os.geteuid():
        pytest.skip("needs root to give a file to somebody else")
    os.chown(path, 1234, -1)


def flipped(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def of_another(path: Path) -> None:
    native(lambda x: 7, "p")
    other = next(one for one in path.parent.iterdir() if one != path)
    other.replace(path)


HARM: dict[str, Callable[[Path], None]] = {
    "flipped bit": flipped,
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-9]),
    "code of another function": of_another,
}


@pytest.mark.slow
@pytest.mark.parametrize("harm", HARM)
def test_a_file_that_was_not_stored_so_is_not_loaded(folder: Path, harm: str) -> None:
    (path,) = folder.iterdir()
    assert (folder.stat().st_mode & 0o777, path.stat().st_mode & 0o777) == (0o700, 0o600)
    HARM[harm](path)
    assert not doubled()  # and writes a file in its place
    assert doubled()


@pytest.mark.slow
@pytest.mark.parametrize("harm", [chown, lambda path: path.chmod(0o777)])
def test_a_folder_that_another_could_fill_is_not_used(folder: Path, harm: Callable[[Path], None], cli) -> None:
    harm(folder)
    before = sorted(folder.iterdir())
    assert not doubled()
    assert sorted(folder.iterdir()) == before
    (line,) = (line for line in cli("--version").out.splitlines() if str(folder) in line)
    assert "(not used: " in line


@pytest.mark.slow
def test_code_runs_without_a_folder_and_the_folder_is_bounded(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert not doubled()
    monkeypatch.setattr(machine_code, "ENTRIES", 2)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for i in range(4):
        machine_code.store_code(f"{i}.o", b"old")
        os.utime(tmp_path / "topcli" / f"{i}.o", (i, i))
    assert not doubled()
    assert len(list((tmp_path / "topcli").iterdir())) == 2


NEXT = """
import json, sys
import numpy as np
from topcli.analysis.reference import reference_states
from topcli.engine.drive import orbit
from topcli.engine.machine import Machine
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski
top, y0 = Kowalevski(), (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
scheme = find_scheme("splitting+suzuki4", "kowalevski")
machine = Machine(top, scheme.build(top, scheme.options()))
run = orbit(top, machine, y0, 0.1, 3)
bits = run.states.tobytes().hex() + reference_states(top, y0, np.linspace(0.0, 1.0, 3)).tobytes().hex()
print(json.dumps([bits, machine.loop.cached, "numba" in sys.modules]))
"""


@pytest.mark.slow
def test_the_next_process_finds_the_code_without_numba(tmp_path: Path) -> None:
    """Also code that is not inlined, as that of the reference, and that calls mathematical functions."""
    first, second = (json.loads(python_process(NEXT, cwd=ROOT, NUMBA_CACHE_DIR=str(tmp_path)).stdout) for _ in range(2))
    assert first == [second[0], False, True]
    assert second[1:] == [True, False]


@pytest.mark.parametrize("name", ["get_host_cpu_name", "get_process_triple"])
def test_code_of_another_processor_is_not_known(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Two kinds of machines may share the folder, as in a cluster."""
    import llvmlite.binding as llvm

    words = machine_code._llvm.__wrapped__()[1]
    assert machine_code._llvm.__wrapped__()[1] == words
    monkeypatch.setattr(llvm, name, lambda: "another")
    assert machine_code._llvm.__wrapped__()[1] != words
