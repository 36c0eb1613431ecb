"""Orders as they are observed and declared: ladders, verdicts, code that fails on the way."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cases import table_of
from conftest import GEN, Said
from topcli.analysis.order import convergence, judge_order
from topcli.analysis.reference import reference_states
from topcli.engine.collect import orbit
from topcli.errors import UsageError
from topcli.schemes.registry import find_scheme
from topcli.studies.order import FALSE
from topcli.studies.order_ladders import DEFAULT, ladders, order_study
from topcli.tops.kowalevski import Kowalevski


def names(what: Any) -> list[str]:
    return [scheme.name for scheme in what.schemes]


def test_the_default_is_the_generic_motion_under_six_schemes() -> None:
    what = ladders(())
    assert names(what) == list(DEFAULT)
    assert what.problem.experiment.y0 == pytest.approx(GEN)
    assert (what.problem.duration, what.left_out, what.sizes) == (10.0, (), ())


@pytest.mark.parametrize(
    ("schemes", "form"),
    table_of("""
hk             kowalevski
bs             lagrange/inertial
HK bohlin-a    kowalevski
hk bs          lagrange/inertial
hk bs-implicit  euler
hk+kahan-li8   kowalevski
"""),
)
def test_the_scene_is_that_of_a_top_which_all_schemes_fit(schemes: str, form: str) -> None:
    what = ladders(schemes.split())
    assert what.problem.top.form == form
    assert names(what) == schemes.lower().split()


@pytest.mark.slow
def test_top_and_config_choose_the_scene_and_the_duration() -> None:
    euler = ladders((), top="EULER")
    assert euler.problem.top.form == "euler"
    assert {"hk", "rk4", "bs"} <= set(names(euler))
    assert not {"dop853", "taylor", "exact"} & set(names(euler))
    own = ladders(["hk"], config="kowalevski_hk", sets=["N=100", "h=0.25"])
    assert own.problem.duration == 25.0
    assert ladders(["hk"], config="kowalevski_hk", duration=3.0).problem.duration == 3.0
    assert ladders(["hk"], top="heavy").problem.top.form == "heavy"


@pytest.mark.parametrize(
    ("schemes", "options", "message"),
    table_of("""
hkk     {}  unknown scheme 'hkk'; did you mean 'hk'
bs      {"top": "kowalevski"}  scheme 'bs' does not fit top 'kowalevski'
hk      {"top": "eulr"}  --top: no scene for the top 'eulr'; did you mean 'euler'
hk      {"top": "euler", "config": "euler_hk"}  --top and --config both choose the scene
dop853  {}  no scheme has an order that can be observed: dop853: it chooses its steps by a tolerance
hk hk   {}  scheme 'hk' is named twice
hk      {"sizes": [0.6]}  --h 0.6: must be positive and at most 0.5
hk      {"duration": -1.0}  the duration -1 must be positive
hk      {"config": "kowalevski_hk", "sets": ["h=-0.1"]}  must be positive; give another with --duration
"""),
)
def test_wrong_choices_are_named(schemes: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        ladders(schemes.split(), **options)


def test_a_scheme_without_an_order_is_left_out_beside_others() -> None:
    what = ladders(["hk", "dop853"])
    assert names(what) == ["hk"]
    assert what.left_out == (("dop853", "it chooses its steps by a tolerance, not by h"),)


def test_given_sizes_become_steps_that_divide_the_interval() -> None:
    what = ladders(["hk"], sizes=[0.05, 0.03, 0.5, 0.0501])
    assert [rung.value for rung in what.rungs] == [0.5, 0.05, 0.5 / 17]
    assert [rung.steps for rung in what.rungs] == [1, 10, 17]


def test_errors_are_those_of_plain_runs() -> None:
    what = ladders(["hk", "rk4"], sizes=[0.1, 0.05, 0.025], duration=4.0)
    study = order_study(what)
    top = Kowalevski()
    times = np.linspace(0.0, 4.0, 21)
    exact = reference_states(top, what.problem.experiment.y0, times)
    for row, order in zip(study["schemes"], (2, 4), strict=True):
        scheme = find_scheme(row["scheme"], "kowalevski")
        assert [one["h"] for one in row["points"]] == [0.1, 0.05, 0.025]
        for one in row["points"]:
            stride = round(0.2 / one["h"])
            method, y0 = scheme.build(top, scheme.options()), what.problem.experiment.y0
            states = orbit(top, method, y0, 0.2 / stride, 20 * stride, stride).states
            off = np.sqrt(((states - exact) ** 2).sum(axis=1))
            assert one["error"] == pytest.approx(off.max(), rel=1e-9)
            assert one["final_error"] == pytest.approx(off[-1], rel=1e-9)
        logs = np.log([[one["h"], one["error"]] for one in row["points"]])
        slope = np.polyfit(logs[:, 0], logs[:, 1], 1)[0]
        assert row["order"] == pytest.approx(slope, rel=1e-12)
        assert row["order"] == pytest.approx(order, abs=0.1)
        assert row["declared_order"] == order


def test_a_ladder_ends_at_the_number_of_steps() -> None:
    (row,) = order_study(ladders(["hk"], steps=650))["schemes"]
    assert [one["h"] for one in row["points"]] == [0.5 / 2**k for k in range(6)]
    assert (row["plateau"], row["onset"]) == (None, None)


def fake_study(*arguments: object) -> dict[str, Any]:
    points = [{"h": 0.1 / 2**k, "error": 0.01 / 4**k, "final_error": 0.1} for k in range(4)]
    row = {"scheme": "hk", "declared_order": 2, "order": 2.0, "fitted": [0.0125, 0.025, 0.05], "plateau": None}
    row |= {"verdict": "as declared", "why": ""}
    row |= {"onset": None, "ended": "", "broken": None, "failed": [], "points": points}
    return {"schema_version": 1, "name": "n", "top": "t", "duration": 1.0, "schemes": [row], "left_out": []}


@pytest.mark.slow
def test_only_the_default_study_is_stored(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.studies.order_ladders.order_study", fake_study)
    for arguments in (("hk",), ("--duration", "5"), ("--h", "0.1"), ("--max-steps", "100"), ("--top", "kowalevski")):
        assert cli("order", *arguments).code == 0
        assert not Path("results").exists()
    said = cli("order")
    assert said.err == "wrote results/order/order.json\n"
    stored = json.loads(Path("results/order/order.json").read_text())
    assert stored["schemes"] == fake_study()["schemes"]


def test_failures_and_changed_sizes_are_reported(cli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    study = fake_study()
    monkeypatch.setattr("topcli.studies.order_ladders.order_study", lambda *arguments: study)
    said = cli("order", "hk", "--h", "0.03", "--h", "0.05")
    assert said.err == "h = 0.03 becomes 0.0294118, so that the time between comparisons, 0.5, is a multiple of h\n"
    study["schemes"] = [{**study["schemes"][0], "scheme": name, "why": "too few"} for name in ("hk", "rk4")]
    assert cli("order", "hk", "rk4").err == "hk, rk4: order undecided: too few\n"
    study["schemes"] = fake_study()["schemes"]
    study["schemes"][0]["failed"] = [{"h": 0.2, "reason": "fails at step 3 of 50"}]
    study["schemes"][0]["points"][0]["error"] = None
    study["left_out"] = [{"scheme": "dop853", "reason": "has no h"}]
    said = cli("order", "hk", "-v")
    assert said.code == 0
    assert said.err.splitlines() == [
        "dop853 is left out: has no h",
        "hk: 1 of its step sizes gave no result; h = 0.2 fails at step 3 of 50",
    ]
    assert said.out.splitlines()[-4].split() == ["0.1", "nan"]
    study["schemes"][0]["points"] = []
    assert cli("order", "hk").code == 1
    study["schemes"][0]["broken"] = "cannot be compiled"
    said = cli("order", "hk")
    assert (said.code, said.err.splitlines()[-1]) == (2, "error: hk: cannot be compiled")


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
    "asserting": f"own.py:{line_of('def asserts')}: asserts raises or asserts, which compiled code cannot pass on",
    "raising": f"own.py:{line_of('raise KeyError')}: in raises: KeyError: 'in the step'",
}
"""Start of the message on each scheme whose code fails."""


@pytest.fixture
def own(cli: Callable[..., Said]) -> Callable[..., Said]:
    """Call a command with the scheme file."""
    Path("own.py").write_text(FILE)
    return lambda *arguments: cli(*arguments, "--plugin", "own.py")


def errors_of(said: Said) -> dict[str, str]:
    """Messages on errors by scheme."""
    lines = [line.removeprefix("error: ") for line in said.err.splitlines() if line.startswith("error: ")]
    return {line.partition(":")[0].partition(" ")[0]: line.partition(": ")[2] for line in lines}


@pytest.mark.slow
@pytest.mark.parametrize("form", ["kowalevski", "lagrange", "heavy"])
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


SHORT = ("--duration", "2", "--max-steps", "2000")


def test_order_reports_false_declarations(own: Callable[..., Said]) -> None:
    said = own("order", "honest", "modest", "false3", "false2", "inconsistent", *SHORT)
    assert said.code == 4
    assert errors_of(said) == {
        "false3": "the observed order 2.00 is below the declared order 3",
        "false2": "the observed order 1.00 is below the declared order 2",
        "inconsistent": "the observed order 0.00 is below the declared order 2: "
        "its step is not consistent with the equations of motion",
    }
    rows = [line.split()[:5] for line in said.out.splitlines()[4:9]]
    assert [row[0] + " " + row[3] for row in rows] == [
        "honest as",
        "modest as",
        "false3 too",
        "false2 too",
        "inconsistent inconsistent",
    ]
    assert own("order", "honest", "modest", *SHORT).code == 0


@pytest.mark.slow
@pytest.mark.parametrize(("schemes", "code"), [(list(PLACES), 2), (["honest", *PLACES, "hk"], 3), (["badstep"], 2)])
def test_order_goes_on_without_code_that_fails(own: Callable[..., Said], schemes: list[str], code: int) -> None:
    said = own("order", *schemes, *SHORT)
    assert said.code == code
    found = errors_of(said)
    assert set(found) == set(PLACES) & set(schemes)
    assert {name: text for name, text in found.items() if not text.startswith(PLACES[name])} == {}
    verdicts = {line.split()[0]: line.split()[3] for line in said.out.splitlines()[4 : 4 + len(schemes)]}
    assert verdicts == {name: "–" if name in PLACES else "as" for name in schemes}


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_compiled_step_that_raises_ends_the_run(tmp_path: Path) -> None:
    """Compiled code reports the error on its own and takes no step; the loop must not ask again without end."""
    (tmp_path / "own.py").write_text(HIDDEN)
    settings = ["--set", "scheme=hidden", "--set", "h=0.1", "--set", "N=500", "--plugin", "own.py"]
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
    last = "error: the compiled step raised the exception printed above; return nan from a step that fails"
    assert done.stderr.splitlines()[-1] == last
