"""Schemes, tops and measures of a user's file: they work, or one line names the file, the line and the reason."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from conftest import ROOT, Said
from documentation import read_page
from injected import topcli_process
from topcli.engine import native

Cli = Callable[..., Said]
HK = str(ROOT / "configs" / "kowalevski_hk.yaml")
pytestmark = pytest.mark.usefixtures("own_registry")
SCHEME = """
import topcli
from topcli.contracts import Stepper
from topcli.tops.kowalevski import Kowalevski

def step(s, h, p):
    return s

def fault(*arguments):
    raise KeyError("first\\nsecond")  # the line to name

@topcli.top
class Bad(Kowalevski):
    kind = form = "bad"
    {method} = {raising}

@topcli.scheme("mine", top="bad", order=1, explicit=True, self_adjoint=False{trait})
def build(top, options):
    '''Rest.'''
    return {built}
"""

STEPPER = "Stepper(step, 6)"

CASES = {
    "enter": ("title", "'bad'", "", "Stepper(step, 6, fault)"),
    "plain step": ("title", "'bad'", "", "Stepper(fault, 6, plain=True)"),
    "leave": ("title", "'bad'", "", "Stepper(step, 6, None, fault, plain=True)"),
    "modified": ("title", "'bad'", ", modified=fault", STEPPER),
    "constants": ("constants", "fault", "", STEPPER),
    "invariants": ("invariants", "fault", "", STEPPER),
}


@pytest.fixture
def run(cli: Cli, in_tmp: Path) -> Callable[..., Said]:
    """Run the scheme ``mine`` of a file: the one of the given case, with a part of its text replaced."""

    def call(case: tuple[str, str, str, str], old: str = "", new: str = "") -> Said:
        parts = dict(zip(("method", "raising", "trait", "built"), case, strict=True))
        Path("raising.py").write_text(SCHEME.format(**parts).replace(old, new) if old else SCHEME.format(**parts))
        settings = ["--set", "top=bad", "--set", "scheme=mine", "--set", "N=20", "--quiet"]
        return cli("run", HK, "--plugin", str(in_tmp / "raising.py"), *settings)

    return call


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_code_that_raises_is_named_by_file_and_line(case: str, run: Callable[..., Said], in_tmp: Path) -> None:
    said, path = run(CASES[case]), in_tmp / "raising.py"
    assert said.code == 2
    line = next(i for i, text in enumerate(path.read_text().splitlines(), 1) if "the line to name" in text)
    place, why = f"{path}:{line}: in fault", "KeyError: 'first\\nsecond'"
    assert said.err == f"error: {place}: {why}\n"


def test_a_build_that_returns_nothing_is_refused(run: Callable[..., Said]) -> None:
    said = run(("title", "'bad'", "", "None"))
    assert said.code == 2
    assert "raising.py:17: scheme 'mine' is built as NoneType; return a Stepper" in said.err


@pytest.mark.parametrize("length", [2, 9])
def test_a_plain_step_of_the_wrong_length_is_refused(length: int, run: Callable[..., Said]) -> None:
    said = run(("title", "'bad'", "", "Stepper(step, 6, plain=True)"), "return s\n", f"return (0.5,) * {length}\n")
    assert said.code == 2
    assert said.err.endswith(f"raising.py:6: the step returns {length} numbers; expected 6\n")


@pytest.mark.slow
@pytest.mark.parametrize("body", ["s[0]", "(s[0], s[1])", "open('x')", "(*s, 1.0)"])
def test_a_step_that_cannot_be_compiled_is_named(run: Callable[..., Said], body: str) -> None:
    said = run(("title", "'bad'", "", STEPPER), "return s\n", f"return {body}\n")
    assert said.code in (1, 2)
    assert "raising.py:" in said.err
    assert len(said.err.splitlines()) <= 3


@pytest.mark.slow
def test_a_step_that_uses_complex_numbers_works_from_the_cache_too(run: Callable[..., Said], in_tmp: Path) -> None:
    turned = "(z.real, z.imag, s[2], s[3], s[4], s[5])"
    step = f"import cmath\n\ndef step(s, h, p):\n    z = cmath.exp(0.1j) * complex(s[0], s[1])\n    return {turned}\n"
    for name in ("first", "again"):
        said = run(("title", "'bad'", "", STEPPER), "def step(s, h, p):\n    return s\n", step)
        assert said.code == 0, said.err
        (folder,) = (in_tmp / "results").glob("kowalevski_hk-*")
        folder.rename(in_tmp / name)
    first, again = (in_tmp / name / "series.parquet" for name in ("first", "again"))
    assert first.read_bytes() == again.read_bytes()


@pytest.mark.slow
def test_a_file_with_a_scheme_and_a_measure(cli: Cli, in_tmp: Path) -> None:
    """They are listed with their origin, which is shown only if something does not come with topcli."""
    assert "origin" not in cli("list", "measures").out
    (in_tmp / "mine.py").write_text(COUNTING + MEASURE)
    items = cli("list", "measures", "--plugin", "mine.py", "--json").json()["measures"]
    header, *rows = cli("list", "measures", "--plugin", "mine.py").out.splitlines()
    assert header.split()[-1] == "origin"
    named = [row for row in rows if not row.startswith(" ")]  # other lines continue a text
    assert [row.split()[-1] for row in named] == [item["origin"] for item in items]
    origins = {item["name"]: item["origin"] for item in items}
    assert (origins["omega1.least"], origins["seconds"]) == ("mine.py", "topcli")
    assert "note = {A test}" in cli("cite", "counting", "--plugin", "mine.py").out
    (in_tmp / "study.yaml").write_text(SWEEP % "counter.pairs, steps, omega1.least")
    said = cli("sweep", "study.yaml", "--plugin", "mine.py")
    assert said.code == 0, said.err
    rows = {row["scheme"]: row for row in pq.read_table("results/study/rows.parquet").to_pylist()}
    assert rows["counting"]["counter.pairs"] == 120.0
    assert rows["rk4"]["counter.pairs"] is None or math.isnan(rows["rk4"]["counter.pairs"])
    assert {row["outcome"] for row in rows.values()} == {"completed"}
    assert all(row["omega1.least"] <= 0.7 for row in rows.values())
    (in_tmp / "wrong.yaml").write_text(SWEEP % "counter.pears")
    refused = cli("sweep", "wrong.yaml", "--plugin", "mine.py")
    assert (refused.code, "unknown measure 'counter.pears'" in refused.err) == (2, True)


MEASURE = """
@topcli.measure("omega1.least", summary="least omega1", needs=["omega1"])
def least(batch):
    return batch.columns["omega1"].min(axis=1)
"""
COUNTING = """
import topcli
from topcli.contracts import Stepper

def step(y, h, p):
    return (y[0], y[1], y[2], y[3], y[4], y[5], y[6] + 2.0)

@topcli.scheme("counting", top="kowalevski", order=2, explicit=True, self_adjoint=True)
def build(top, options):
    '''A state at rest that counts two events a step.

    Source
    ------
    A test
    '''
    return Stepper(step, 7, lambda y, h, p: (*y, 0.0), lambda y, h, p: y[:6], counters=("pairs",))
"""

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


HEUN = "    return Stepper(heun, 3)"
MID = """
    def step(y, h, p):
        if y[0] < 0.1999:
            raise RuntimeError("mid")  # the line
        return heun(y, h, p)
    return Stepper(step, 3, plain=True)
"""
NO_INTEGRALS = re.compile(r"    integrals = \{.*?\n    \}\n", re.DOTALL)
ALL = ("run", "compare", "order", "stress")
PAGE = {
    "build": (HEUN, "    raise KeyError('no')  # the line", ALL),
    "middle of a step": (HEUN, MID, ("run", "compare", "order")),
    "compiled step": ("def heun(y, h, p):", "def heun(y, h, p):  # the line\n    assert y", ALL),
    "width": ("def heun(y, h, p):", "def heun(y, h, p):  # the line\n    _, _ = y", ALL),
    "modified": ("order=2,", "order=2,\n    modified=lambda top, h, options: 1 / 0,  # the line", ALL),
    "no invariant": ("@topcli.scheme(", "@topcli.scheme(  # the line", ALL),
    "no polynomial": ("def field(y, p):", "def field(y, p):  # the line", ("compare", "order", "stress")),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", PAGE)
def test_a_fault_in_a_file_is_named_by_every_command(cli: Cli, in_tmp: Path, fault: str) -> None:
    """By its file and line, and never as a bug of topcli; the others of several schemes go on."""
    old, new, commands = PAGE[fault]
    files = read_page(ROOT / "docs" / "own.md").files()
    text = files["gyrostat.py"].replace(old, new)
    if fault == "no invariant":
        text = text.replace("self_adjoint=False", "self_adjoint=False, conserves=['enrgy']")
    if fault == "no polynomial":
        text = NO_INTEGRALS.sub("", text).replace("/ A, (", "/ A + 0.0 / w3, (")
    assert text != files["gyrostat.py"]
    Path("rotor.yaml").write_text(files["rotor.yaml"])
    Path("mine.py").write_text(text)
    line = next((i for i, text in enumerate(text.splitlines(), 1) if "# the line" in text), None)
    for command, rest in {
        "run": "rotor.yaml",
        "compare": "heun rk4 --config rotor.yaml",
        "order": "heun rk4 --config rotor.yaml --set T=1",
        "stress": "heun rk4 --top gyrostat --case one-step",
    }.items():
        said = cli(command, *rest.split(), "--plugin", "mine.py")
        if command in commands:
            assert said.code in (2, 3, 4), said
            assert f"mine.py:{line}" in said.err
        assert "internal error" not in said.err


# what is not the fault of the user


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "words", "code"),
    [
        ({"NUMBA_DISABLE_JIT": "1"}, "NUMBA_DISABLE_JIT is set", 1),
        ({"NUMBA_NUM_THREADS": "abc", "PYTHONOPTIMIZE": "2"}, "", 0),
    ],
)
def test_settings_of_the_environment_are_not_blamed_on_the_scheme(
    tmp_path: Path, settings: dict[str, str], words: str, code: int
) -> None:
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), **settings}
    done = topcli_process("run", "kowalevski_hk", "--set", "N=20", "--quiet", cwd=tmp_path, env=environment)
    assert done.returncode == code, done.stderr
    assert words in done.stderr
    assert "hk.py" not in done.stderr
    assert len(done.stderr.splitlines()) <= 3


def test_a_compiler_that_cannot_be_loaded_is_not_a_folder_that_cannot_be_written(
    cli: Callable[..., Said], monkeypatch: pytest.MonkeyPatch
) -> None:
    native._llvm.cache_clear()
    native._linked.cache_clear()
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    try:
        said = cli("run", "kowalevski_hk", "--set", "N=20", "--quiet")
    finally:
        native._llvm.cache_clear()
    assert said.code == 1
    assert "import of llvmlite.binding halted" in said.err
    assert "written" not in said.err
