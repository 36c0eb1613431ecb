"""Orders as they are observed and declared: ladders, verdicts, code that fails on the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import topcli
from cases import table_of
from conftest import Said
from topcli.analysis.reference import reference_states
from topcli.studies.entries import scene_of
from topcli.studies.report import Report
from topcli.tops.kowalevski import Kowalevski


def points_of(report: Report, scheme: str) -> dict[float, float]:
    """Errors of a scheme by step size."""
    return {row["h"]: row[scheme] for row in report.tables[1].rows if scheme in row}


def test_errors_are_those_of_plain_runs() -> None:
    sizes = [0.1, 0.05, 0.025]
    report = topcli.order("hk", "rk4", overrides=["T=4"], sizes=sizes)
    times = np.linspace(0.0, 4.0, 21)
    for scheme, order in (("hk", 2), ("rk4", 4)):
        points = points_of(report, scheme)
        assert list(points) == sizes
        for h, error in points.items():
            run = topcli.simulate("kowalevski_generic_hk", scheme=scheme, h=h, T=4, output={"every": round(0.2 / h)})
            exact = reference_states(Kowalevski(), run.states[0], times)
            assert error == pytest.approx(np.linalg.norm(run.states - exact, axis=1).max(), rel=1e-9)
        slope = np.polyfit(np.log(sizes), np.log(list(points.values())), 1)[0]
        row = report.table.loc[scheme]
        assert row["order"] == pytest.approx(slope, rel=1e-12)
        assert (row["declared_order"], row["verdict"], report.code) == (order, "as declared", 0)
        assert abs(row["order"] - order) < 0.1


def test_a_ladder_ends_at_the_number_of_steps_or_at_round_off() -> None:
    report = topcli.order("hk", max_steps=650)
    assert (report.tables[0].rows[0]["round-off"], report.tables[0].rows[0]["from h"]) == (None, None)
    assert list(points_of(report, "hk")) == [0.5 / 2**k for k in range(6)]
    (row,) = topcli.order("hk+kahan-li8").tables[0].rows
    assert row["round-off"] < 1e-12
    assert row["order"] == pytest.approx(8.0, abs=0.1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    table_of("""
hk dop853        dop853: has no order in h: it chooses its steps by a tolerance
exact            exact: has no error that depends on h
hk hk            hk: is named twice
hk --h 0.6       --h 0.6: must divide 0.5, the time between comparisons; give for example 0.5
hk --set T=-1    T/h = -1/0.01 = -100 steps; must be from 1
hk --set h=0.1   --set h=0.1: the step sizes of this study are given by --h
hk:branch=sign   hk:branch=sign: --set scheme.branch=sign: scheme.branch: unknown key
"""),
)
def test_wrong_choices_are_named(cli: Callable[..., Said], arguments: str, message: str) -> None:
    said = cli("order", *arguments.split())
    assert said.code == 2
    assert message in said.err


@pytest.mark.parametrize(
    ("schemes", "scene"),
    table_of("""
hk             kowalevski_generic_hk
bs             lagrange_bs
hk bs          lagrange_bs
hk bs-implicit  euler_hk
"""),
)
def test_the_scene_is_that_of_a_top_which_all_schemes_fit(schemes: str, scene: str) -> None:
    assert scene_of(schemes.split()) == scene


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
def with_file(cli: Callable[..., Said]) -> Callable[..., Said]:
    """Call a command with the scheme file."""
    Path("own.py").write_text(FILE)
    return lambda *arguments: cli(*arguments, "--plugin", "own.py")


def errors_of(said: Said) -> dict[str, str]:
    """Messages on errors by scheme."""
    lines = [line.removeprefix("error: ") for line in said.err.splitlines() if line.startswith("error: ")]
    return {line.partition(":")[0].partition(" ")[0]: line.partition(": ")[2] for line in lines}


SHORT = ("--set", "T=2", "--max-steps", "2000")


def test_order_reports_false_declarations(with_file: Callable[..., Said]) -> None:
    said = with_file("order", "honest", "modest", "false3", "false2", "inconsistent", *SHORT)
    assert said.code == 4
    assert errors_of(said) == {
        "false3": "the observed order 2.00 is below the declared order 3",
        "false2": "the observed order 1.00 is below the declared order 2",
        "inconsistent": "the observed order 0.00 is below the declared order 2: "
        "its step is not consistent with the equations of motion",
    }
    rows = [line.split()[:5] for line in said.out.splitlines()[5:10]]
    assert [row[0] + " " + row[3] for row in rows] == [
        "honest as",
        "modest as",
        "false3 too",
        "false2 too",
        "inconsistent inconsistent",
    ]
    assert with_file("order", "honest", "modest", *SHORT).code == 0


@pytest.mark.slow
@pytest.mark.parametrize(("schemes", "code"), [(list(PLACES), 2), (["honest", *PLACES, "hk"], 3), (["badstep"], 2)])
def test_order_goes_on_without_code_that_fails(with_file: Callable[..., Said], schemes: list[str], code: int) -> None:
    said = with_file("order", *schemes, *SHORT)
    assert said.code == code
    errors = errors_of(said)
    assert set(errors) == set(PLACES) & set(schemes)
    assert all(errors[name].startswith(PLACES[name]) for name in errors)
    verdicts = {
        row["scheme"]: row["verdict"]
        for row in with_file("order", *schemes, *SHORT, "--json").json()["tables"][0]["rows"]
    }
    assert verdicts == {name: "failed" if name in PLACES else "as declared" for name in schemes}


@pytest.mark.slow
@pytest.mark.parametrize(("schemes", "code"), [(["badbuild", "honest", "raising"], 3), (["badstep"], 2)])
def test_stress_goes_on_without_code_that_fails(with_file: Callable[..., Said], schemes: list[str], code: int) -> None:
    output = with_file("stress", *schemes, "--case", "delone", "--json")
    assert output.code == code
    verdicts = {row["scheme"]: (row["verdict"], row["why"]) for row in output.json()["tables"][0]["rows"]}
    for name in schemes:
        verdict, why = verdicts[name]
        assert verdict == ("ok" if name == "honest" else "code failed")
        assert name == "honest" or why.startswith(PLACES[name])
