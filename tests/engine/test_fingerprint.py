"""The key of stored machine code, of run folders and of shared code: every edit that changes numbers changes it."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cases import parts_of
from declared import BODIES
from scheme_files import run_scheme, write_scheme
from topcli.contracts import Stepper
from topcli.engine.fingerprint import fingerprint, same_method
from topcli.errors import SchemeCodeError
from topcli.runs.identity import method_fingerprint
from topcli.schemes.registry import all_schemes
from topcli.tops import TOPS

REST = "s[1], s[2], s[3], s[4], s[5])"
STEPS = {name: text.replace("REST)", REST) for name, text in parts_of(Path(__file__).with_name("edits.txt")).items()}
"""Bodies of scheme files."""
REFUSED = [name for name in STEPS if name.startswith("refused")]
CONSTS = (
    "import numpy as np\nimport inner\nG = 2.0\nA = np.array([1.0, 2.0])\ndef times(x):\n    return inner.times(x)\n"
)
INNER = "def times(x):\n    return 2.0 * x\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of scheme files, and a cache of its own."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "files" / "parts").mkdir(parents=True)
    return tmp_path / "files"


def write_files(folder: Path, body: str, factor: str, options: str = "") -> Path:
    """The scheme file and the modules beside it with ``factor`` where the text says 2.0."""
    for name, text in (
        ("consts.py", CONSTS),
        ("inner.py", INNER),
        ("parts/consts.py", CONSTS),
        ("parts/__init__.py", ""),
    ):
        (folder / name).write_text(text.replace("2.0", factor))
    return write_scheme(folder, body.replace("2.0", factor), options)


EDITED = ("large array", "strided array", "dispatcher", "default of a helper", "module attribute", "module's module")
"""Kinds that are compiled after each edit: arrays, which are not all stored, code, a default, what lies beside."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", EDITED)
def test_an_edit_gives_the_new_numbers(folder: Path, kind: str) -> None:
    """Same size, same second: 2.0 becomes 4.0 and back."""
    first = run_scheme(write_files(folder, STEPS[f"compiled: {kind}"], "2.0"))
    edited = run_scheme(write_files(folder, STEPS[f"compiled: {kind}"], "4.0"))
    back = run_scheme(write_files(folder, STEPS[f"compiled: {kind}"], "2.0"))
    assert (first.value, edited.value, back.value) == (4.0, 16.0, 4.0)
    assert first.code == back.code != edited.code
    assert not first.cached
    assert not edited.cached
    assert back.cached is (kind not in ("large array", "strided array"))


@pytest.mark.parametrize("kind", [name for name in STEPS if name not in REFUSED])
def test_an_edit_gives_another_code(folder: Path, kind: str) -> None:
    """In all that a step can depend on; one in the interpreter has the code key of its machine code."""
    runs = [run_scheme(write_files(folder, STEPS[kind], k, ", plain=True")) for k in ("2.0", "4.0", "2.0")]
    assert [run.value for run in runs] == [4.0, 16.0, 4.0]
    assert runs[0].code == runs[2].code != runs[1].code


@pytest.mark.parametrize("kind", REFUSED)
@pytest.mark.parametrize("options", ["", ", plain=True"])
def test_what_cannot_be_hashed_is_refused_by_name(folder: Path, kind: str, options: str) -> None:
    _, _, name, what = kind.split(": ")
    with pytest.raises(SchemeCodeError) as refusal:
        run_scheme(write_files(folder, STEPS[kind], "2.0", options))
    message = str(refusal.value)
    assert name in message
    assert what in message
    assert "mine.py:" in message
    assert "\n" not in message


@pytest.mark.slow
def test_a_global_that_only_shares_the_name_of_an_attribute_is_not_refused(folder: Path) -> None:
    body = STEPS["compiled: global with the name of an attribute"]
    assert run_scheme(write_files(folder, body, "2.0")).value == 4.0


def test_a_step_that_calls_itself_is_refused(folder: Path) -> None:
    body = "def f(x):\n    return f(x - 1.0) if x > 0.0 else 2.0\ndef step(s, h, p):\n    return (f(s[0]), " + REST
    with pytest.raises(SchemeCodeError, match=r"mine.py:4: f calls itself"):
        run_scheme(write_files(folder, body, "2.0"))


@pytest.mark.slow
def test_modules_of_one_name_beside_two_files_stay_apart(folder: Path, tmp_path: Path) -> None:
    body = STEPS["compiled: module attribute"]
    (tmp_path / "other" / "parts").mkdir(parents=True)
    here, there = write_files(folder, body, "2.0"), write_files(tmp_path / "other", body, "4.0")
    assert [run_scheme(path).value for path in (here, there, here)] == [4.0, 16.0, 4.0]


VALUES = [0.0, -0.0, 1, True, 1.0, "1", b"1", (1,), [1], None, {1: 1}, frozenset((1,)), 1j]


@pytest.mark.parametrize("value", VALUES)
def test_values_that_differ_in_kind_or_sign_differ(value: object) -> None:
    def make(k):
        return lambda: k

    same = [other for other in VALUES if fingerprint(make(other)) == fingerprint(make(value))]
    assert [repr(one) for one in same] == [repr(value)]


@pytest.mark.parametrize(
    "change",
    [
        lambda a: a.astype(np.float32),
        lambda a: a.reshape(3, 2),
        lambda a: np.asfortranarray(a),
        lambda a: a + np.eye(2, 3) * 1e-16,
        lambda a: a.astype(">f8"),
        lambda a: a.tolist(),
    ],
)
def test_arrays_count_by_type_shape_layout_and_content(change) -> None:
    array = np.arange(6.0).reshape(2, 3) * 0.1

    def make(k):
        return lambda: k

    assert fingerprint(make(array)) == fingerprint(make(array.copy()))
    assert fingerprint(make(array)) != fingerprint(make(change(array)))


METHOD = """
import topcli
from topcli.contracts import Stepper

GAIN = 1.25
PAIR = (0.5, (2.25, 3.0))

def helper(x, k=4.125):
    return x + k * 0.0

def step(s, h, p, q=5.5):
    return (helper(s[0]), s[1] + q * 0.0, s[2] * GAIN, s[3] * PAIR[1][0], s[4], s[5], s[6])

def enter(y, h, p):
    return (*y, 6.75)

def leave(s, h, p):
    return (s[0], s[1], s[2], s[3], s[4], s[5] + 7.125)

METHOD = Stepper(step, 7, enter, leave{traits})
"""
EDITS = """
global of the step: GAIN = 1.25 -> GAIN = 1.5
nested global: 2.25 -> 2.5
default of the step: q=5.5 -> q=5.25
default of a helper: k=4.125 -> k=4.25
body of a helper: x + k -> x - k
body of the step: s[1] + q -> s[1] - q
body of enter: 6.75 -> 6.5
body of leave: 7.125 -> 7.5
no leave: enter, leave{traits} -> enter{traits}
plain: {traits} -> , plain=True{traits}
counters: {traits} -> , counters=('count',){traits}
iterative: {traits} -> , iterative=True{traits}
comment: GAIN = 1.25 -> GAIN = 1.25  # a gain
"""


def key(text: str) -> str:
    scope: dict = {"__name__": "mine", "__file__": "mine.py"}
    exec(compile(text.replace("{traits}", ""), "mine.py", "exec"), scope)
    return method_fingerprint(scope["METHOD"])


@pytest.mark.parametrize("edit", EDITS.strip().split("\n"))
def test_every_edit_of_a_method_changes_its_code_key(edit: str) -> None:
    name, _, change = edit.partition(": ")
    old, new = change.split(" -> ")
    assert METHOD.count(old) == 1
    assert key(METHOD) == key(METHOD)
    assert (key(METHOD.replace(old, new)) == key(METHOD)) == (name == "comment")


def stepper(factor: Any, default: Any = 1.0, other: bool = False) -> Stepper:
    def inner(x: float) -> float:
        return factor * x

    def step(s: Any, h: float, p: Any, unit: Any = default) -> Any:
        return (s[0] + h * inner(s[0]) * unit,)

    def negative(s: Any, h: float, p: Any, unit: Any = default) -> Any:
        return (s[0] - h * inner(s[0]) * unit,)

    return Stepper(negative if other else step, 1)


def test_closures_made_twice_are_the_same() -> None:
    assert stepper(2.0).step is not stepper(2.0).step
    assert same_method(stepper(2.0), stepper(2.0))
    assert same_method(stepper((1.0, (2, "a"))), stepper((1.0, (2, "a"))))


@pytest.mark.parametrize(
    "other",
    [
        stepper(3.0),
        stepper(2),
        stepper(2.0, 2.0),
        stepper(2.0, other=True),
        stepper(np.array(2.0)),
        stepper((2.0,)),
        Stepper(stepper(2.0).step, 1, counters=("a",)),
        Stepper(stepper(2.0).step, 2),
    ],
)
def test_any_difference_counts(other: Stepper) -> None:
    assert not same_method(stepper(2.0), other)


def test_signed_zeros_differ_and_what_is_unknown_is_never_the_same() -> None:
    assert not same_method(stepper(0.0), stepper(-0.0))
    assert same_method(stepper(float("nan")), stepper(float("nan")))
    assert not same_method(stepper(np.array(2.0)), stepper(np.array(2.0)))


def test_a_closure_that_holds_itself_ends() -> None:
    def made() -> Stepper:
        def step(s: Any, h: float, p: Any) -> Any:
            return step

        return Stepper(step, 1)

    assert not same_method(made(), made())


@pytest.mark.slow
@pytest.mark.parametrize("form", BODIES)
def test_what_is_the_same_has_the_same_fingerprint(form: str) -> None:
    """For every scheme, with tops of different parameters: the verdict is never wrong, and positive for some."""
    cls = TOPS[form]
    numbers = [name for name, kind in cls.model_fields.items() if kind.annotation is float]
    top = cls.new()
    other = top.model_copy(update={name: getattr(top, name) * 1.0625 for name in numbers})
    found = []
    for scheme in all_schemes():
        if scheme.top != form:
            continue
        one, two = (scheme.build(each, scheme.options()) for each in (top, other))
        if isinstance(one, Stepper) and isinstance(two, Stepper) and not one.plain:
            same = same_method(one, two)
            equal = fingerprint(one.step, one.enter, one.leave) == fingerprint(two.step, two.enter, two.leave)
            assert not same or equal, scheme.name
            found.append(same)
    assert any(found)


DIGESTS = """
import importlib, pkgutil, sys
if sys.argv[1] == "without":
    sys.modules["gmpy2"] = None
import topcli
from topcli.runs.identity import method_fingerprint
from topcli.schemes.registry import all_schemes
from topcli.tops import TOPS

def digests():
    schemes = [scheme for scheme in all_schemes() if scheme.top in TOPS]
    methods = [scheme.build(TOPS[scheme.top].new(), scheme.options()) for scheme in schemes]
    return [f"{one.top} {one.name} {method_fingerprint(method)}" for one, method in zip(schemes, methods)]

first = digests()
for module in pkgutil.walk_packages(topcli.__path__, "topcli."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
from topcli.arithmetic.multiprecision import digits, mp
with digits(33):
    mp.zeta(3)
    assert digests() == first, set(digests()) ^ set(first)
print(*first, sep="\\n")
"""


@pytest.mark.slow
def test_identities_depend_neither_on_imports_nor_on_gmpy2() -> None:
    """In a new process, after all modules are imported, in any precision of mpmath, with gmpy2 and without."""
    kinds = ["without", *(["with"] if find_spec("gmpy2") else [])]
    texts = [subprocess.check_output([sys.executable, "-c", DIGESTS, kind], text=True) for kind in kinds]
    assert len(texts[0].splitlines()) > 100
    assert len(set(texts)) == 1
