"""Orders that schemes declare, as ``topcli order`` and ``topcli stress`` judge them; code that fails on the way."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from conftest import Said
from topcli.analysis.order import convergence, judge_order
from topcli.schemes import registry
from topcli.studies.order import FALSE, ladders, order_study
from topcli.tops import TOPS

FILE = '''
import topcli
from topcli.contracts import Stepper
from topcli.tops.kowalevski import field

def move(y, h, f):
    return (y[0] + h * f[0], y[1] + h * f[1], y[2] + h * f[2], y[3] + h * f[3], y[4] + h * f[4], y[5] + h * f[5])

def rk2(y, h, p):
    return move(y, h, field(move(y, 0.5 * h, field(y, p)), p))

def euler(y, h, p):
    return move(y, h, field(y, p))

def drifting(y, h, p):
    return move(y, 1.001 * h, field(move(y, 0.5 * h, field(y, p)), p))

def unknown(y, h, p):
    return open("x")  # not compiled

def asserts(y, h, p):
    assert y[0] > -1e3  # not compiled either
    return rk2(y, h, p)

def raises(y, h, p):
    if h < 0.02:
        raise KeyError("in the step")
    return rk2(y, h, p)

def make(name, order, step, plain=False):
    @topcli.scheme(name, top="kowalevski", title=name, order=order, explicit=True, self_adjoint=step is None,
                   citation="none", equations="none")
    def build(top, options):
        """Test."""
        if step is None:
            raise RuntimeError("in build")
        return Stepper(step, 6, plain=plain)

make("honest", 2, rk2)
make("modest", 1, rk2)
make("false3", 3, rk2)
make("false2", 2, euler)
make("inconsistent", 2, drifting)
make("badbuild", 2, None)
make("badstep", 2, unknown)
make("asserting", 2, asserts)
make("raising", 2, raises, True)
'''


def line_of(text: str) -> int:
    return next(number for number, line in enumerate(FILE.splitlines(), 1) if text in line)


PLACES = {
    "badbuild": f"own.py:{line_of('in build')}: in build: RuntimeError: in build",
    "badstep": f"own.py:{line_of('def unknown')}: the step cannot be compiled for a state of length 6",
    "asserting": f"own.py:{line_of('def asserts')}: asserts raises or asserts, which compiled code cannot; return nan",
    "raising": f"own.py:{line_of('raise KeyError')}: in raises: KeyError: 'in the step'",
}
"""Start of the message on each scheme whose code fails."""


@pytest.fixture
def own(cli: Callable[..., Said]) -> Iterator[Callable[..., Said]]:
    """Call a command with the scheme file."""
    Path("own.py").write_text(FILE)
    yield lambda *arguments: cli(*arguments, "--scheme-file", "own.py")
    registry.unload_scheme_files()


def errors_of(said: Said) -> dict[str, str]:
    """Messages on errors by scheme."""
    lines = [line.removeprefix("error: ") for line in said.err.splitlines() if line.startswith("error: ")]
    return {line.partition(":")[0].partition(" ")[0]: line.partition(": ")[2] for line in lines}


@pytest.mark.slow
@pytest.mark.parametrize("form", TOPS)
def test_no_scheme_of_topcli_is_suspected(form: str) -> None:
    """On its whole ladder each has its order; no part of a ladder refutes it, but the whole refutes the next order."""
    study = order_study(ladders((), top=form, steps=20_000))
    found = {row["scheme"]: row["verdict"] for row in study["schemes"] if row["declared_order"] is not None}
    assert set(found.values()) == {"as declared"}, found
    refuted = []
    for row in study["schemes"]:
        points = [(one["h"], one["error"]) for one in row["points"] if one["error"] is not None]
        for stride in (1, 2):
            for i in range(len(points)):
                for j in range(i + 3, len(points) + 1):
                    part = convergence(*zip(*points[i:j:stride], strict=True))
                    assert judge_order(row["declared_order"], part, 1.0)[0] not in FALSE, (row["scheme"], i, j, stride)
        whole = convergence(*zip(*points, strict=True))
        if row["declared_order"] > 1:  # errors of order 1 stay too large on this ladder to refute order 2
            refuted.append(judge_order(row["declared_order"] + 1, whole, 1.0)[0] in FALSE)
    assert sum(refuted) >= len(refuted) - 1  # a ladder of few rungs above round-off may leave it open


ORDER = ("--duration", "2", "--steps", "2000")


def test_order_reports_false_declarations(own: Callable[..., Said]) -> None:
    said = own("order", "honest", "modest", "false3", "false2", "inconsistent", *ORDER)
    assert said.code == 4
    assert errors_of(said) == {
        "false3": "the observed order 2.00 is below the declared order 3",
        "false2": "the observed order 1.00 is below the declared order 2",
        "inconsistent": "the observed order 0.00 is below the declared order 2: "
        "its step is not consistent with the equations of motion",
    }
    rows = [line.split()[:5] for line in said.out.splitlines()[2:7]]
    assert [row[0] + " " + row[3] for row in rows] == [
        "honest as",
        "modest as",
        "false3 too",
        "false2 too",
        "inconsistent inconsistent",
    ]
    assert own("order", "honest", "modest", *ORDER).code == 0


def test_order_decides_nothing_from_long_steps(own: Callable[..., Said]) -> None:
    said = own("order", "false3", "hk", "--h", "0.5", "--h", "0.25", "--h", "0.125")
    assert said.code == 0
    assert [line.partition(":")[0] for line in said.err.splitlines()] == ["false3", "hk"]
    assert said.err.count("order undecided") == 2


@pytest.mark.parametrize(("schemes", "code"), [(list(PLACES), 2), (["honest", *PLACES, "hk"], 3), (["badstep"], 2)])
def test_order_goes_on_without_code_that_fails(own: Callable[..., Said], schemes: list[str], code: int) -> None:
    said = own("order", *schemes, *ORDER)
    assert said.code == code
    found = errors_of(said)
    assert set(found) == set(PLACES) & set(schemes)
    assert all(found[name].startswith(PLACES[name]) for name in found)
    verdicts = {line.split()[0]: line.split()[3] for line in said.out.splitlines()[2 : 2 + len(schemes)]}
    assert verdicts == {name: "–" if name in PLACES else "as" for name in schemes}


def test_code_that_fails_has_the_same_exit_code_in_a_run(own: Callable[..., Said]) -> None:
    for name, message in PLACES.items():
        said = own("run", "kowalevski_generic_hk", "--set", f"scheme={name}", "--set", "h=0.01", "--set", "N=500")
        assert said.code == 2
        assert said.err.startswith(f"error: {message}")
        assert len(said.err.splitlines()) == 1
        assert own("order", name, *ORDER).code == 2


def test_compare_goes_on_without_code_that_fails(own: Callable[..., Said]) -> None:
    command = ("compare", "badbuild", "hk", "badstep", "raising", "honest", "--config", "kowalevski_generic_hk")
    settings = ("--set", "h=0.01", "--set", "N=200")
    said = own(*command, *settings)
    assert said.code == 3
    found = errors_of(said)
    assert {name: found[name].startswith(PLACES[name]) for name in found} == dict.fromkeys(
        ("badbuild", "badstep", "raising"), True
    )
    document = own(*command, *settings, "--json").json()
    assert [one["label"] for one in document["schemes"]] == ["hk", "honest"]
    assert [one["label"] for one in document["failed"]] == ["badbuild", "badstep", "raising"]
    alone = own("compare", "badbuild", "badstep", *settings)
    assert (alone.code, alone.err) == (2, f"error: {PLACES['badbuild']}\n")


@pytest.mark.slow
def test_compare_of_an_ensemble_goes_on_without_code_that_fails(own: Callable[..., Said]) -> None:
    command = ("compare", "badbuild", "hk", "badstep", "raising", "--config", "kowalevski_ensemble")
    settings = ("--set", "ensemble.random.count=5", "--set", "N=50")
    said = own(*command, *settings)
    assert said.code == 3
    found = errors_of(said)
    assert set(found) == {"badbuild", "badstep", "raising"}
    assert all(found[name].startswith(PLACES[name]) for name in found)
    document: Any = own(*command, *settings, "--json").json()
    assert [(one["label"], one["reached_end"]) for one in document["schemes"]] == [("hk", 5)]


@pytest.mark.slow
@pytest.mark.parametrize("case", ["backwards", "delone"])
def test_stress_reports_false_declarations(own: Callable[..., Said], case: str) -> None:
    """In any case that asks for the order; a lost order of a true declaration is no such report."""
    said = own("stress", "honest", "modest", "false3", "false2", "inconsistent", "--case", case, "--json")
    assert said.code == 4
    trials = {one["scheme"]: one for one in said.json()["trials"]}
    assert {name: (one["outcome"], one["verdict"]) for name, one in trials.items()} == {
        "honest": ("held", "ok"),
        "modest": ("held", "ok"),
        "false3": ("broke", "unexplained"),
        "false2": ("broke", "unexplained"),
        "inconsistent": ("broke", "unexplained"),
    }
    assert trials["false3"]["why"] == "on a generic motion the observed order 2.00 is below the declared order 3"
    assert trials["false2"]["why"] == "on a generic motion the observed order 1.00 is below the declared order 2"
    said = own("stress", "bohlin-a", "--case", "strong-gravity", "--json")  # order 0.32 at these steps
    assert [(one["outcome"], said.code) for one in said.json()["trials"]] == [("degraded", 0)]


@pytest.mark.parametrize(("schemes", "code"), [(["badbuild", "honest", "badstep", "raising"], 3), (["badstep"], 2)])
def test_stress_goes_on_without_code_that_fails(own: Callable[..., Said], schemes: list[str], code: int) -> None:
    said = own("stress", *schemes, "--case", "one-step", "--case", "delone", "--json")
    assert said.code == code
    trials = said.json()["trials"]
    assert len(trials) == 2 * len(schemes)
    for one in trials:
        failed = one["scheme"] in ("badbuild", "badstep") or (one["scheme"], one["case"]) == ("raising", "delone")
        assert one["verdict"] == ("code failed" if failed else "ok"), one
        assert not failed or one["why"].startswith(PLACES[one["scheme"]])
    assert said.err.count("error: ") == len({one["scheme"] for one in trials if one["verdict"] == "code failed"})


HIDDEN = """
import topcli
from topcli.contracts import Stepper

def step(y, h, p):
    return (y[0] - h, y[int(8.0 * (0.8 - y[0]))], y[2], y[3], y[4], y[5])  # out of range from the sixth step on

@topcli.scheme("hidden", top="kowalevski", title="a", order=1, explicit=True, self_adjoint=False, citation="none",
               equations="none")
def build(top, options):
    '''Index that leaves the state.'''
    return Stepper(step, 6)
"""


def test_a_compiled_step_that_raises_ends_the_run(tmp_path: Path) -> None:
    """Compiled code reports the error on its own and takes no step; the loop must not ask again without end."""
    (tmp_path / "own.py").write_text(HIDDEN)
    settings = ["--set", "scheme=hidden", "--set", "h=0.1", "--set", "N=500", "--scheme-file", "own.py"]
    done = subprocess.run(
        [sys.executable, "-m", "topcli", "run", "kowalevski_generic_hk", *settings],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
        check=False,
    )
    assert done.returncode == 2
    assert "IndexError: tuple index out of range" in done.stderr
    last = r"error: the compiled step raised the exception printed above, within \d+ steps of step \d+; return nan from"
    assert re.match(last, done.stderr.splitlines()[-1])
