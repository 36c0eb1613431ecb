"""Orders as they are observed and declared: ladders, verdicts, code that fails on the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import topcli
from cases import table_of
from conftest import Said
from topcli.analysis.reference import reference_states
from topcli.studies.report import Report
from topcli.tops.kowalevski import Kowalevski


def points_of(report: Report, scheme: str) -> dict[float, float]:
    """Errors of a scheme by step size."""
    return {row["h"]: row[scheme] for row in report.tables[1].rows if scheme in row}


def test_errors_are_those_of_plain_runs() -> None:
    sizes = [0.1, 0.05, 0.025]
    report = topcli.order("hk", "rk4", overrides=["T=4"], sizes=sizes)
    times = np.linspace(0.0, 4.0, 21)
    lines = report.plot(Figure().add_subplot()).get_lines()
    for line, scheme, order in zip(lines, ("hk", "rk4"), (2, 4), strict=True):
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
        assert line.get_label() == f"{scheme}: {slope:.2f}"
        assert line.get_xydata().tolist() == [*map(list, points.items())]


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
bs               scheme 'bs' does not fit top 'kowalevski'; it fits euler
hk:branch=sign   hk:branch=sign: --set scheme.branch=sign: scheme.branch: unknown key
"""),
)
def test_wrong_choices_are_named(cli: Callable[..., Said], arguments: str, message: str) -> None:
    said = cli("order", *arguments.split())
    assert said.code == 2
    assert message in said.err


FILE = '''
import topcli
from topcli.contracts import Stepper
from topcli.tops.kowalevski import kowalevski_field

def move(y, h, f):
    return tuple([y[i] + h * f[i] for i in range(6)])

def rk2(y, h, p):
    return move(y, h, kowalevski_field(move(y, 0.5 * h, kowalevski_field(y, p)), p))

def drifting(y, h, p):
    return move(y, 1.001 * h, kowalevski_field(move(y, 0.5 * h, kowalevski_field(y, p)), p))

def raises(y, h, p):
    if h < 0.02:
        raise KeyError("in the step")
    return rk2(y, h, p)

def make(name, order, step):
    @topcli.scheme(name, top="kowalevski", order=order, explicit=True, self_adjoint=False)
    def build(top, options):
        """Test."""
        if step is None:
            raise RuntimeError("in build")
        return Stepper(step, 6, plain=True)

make("honest", 2, rk2)
make("modest", 1, rk2)
make("false3", 3, rk2)
make("inconsistent", 2, drifting)
make("badbuild", 2, None)
make("raising", 2, raises)
'''
FAILURES = {"badbuild": "in build: RuntimeError: in build", "raising": "in raises: KeyError: 'in the step'"}


@pytest.fixture
def with_file(cli: Callable[..., Said]) -> Callable[..., Said]:
    """Call a command with the scheme file."""
    Path("own.py").write_text(FILE)
    return lambda *arguments: cli(*arguments, "--plugin", "own.py", "--json")


SHORT = ("--set", "T=2", "--max-steps", "200")


def test_order_reports_false_declarations(with_file: Callable[..., Said]) -> None:
    said = with_file("order", "honest", "modest", "false3", "inconsistent", *SHORT)
    assert said.code == 4
    false, inconsistent = said.err.splitlines()[-2:]
    assert false == "error: false3: the observed order 1.99 is below the declared order 3"
    assert inconsistent.startswith("error: inconsistent: the observed order 0.")
    assert inconsistent.endswith("its step is not consistent with the equations of motion")
    verdicts = [row["verdict"] for row in said.json()["tables"][0]["rows"]]
    assert verdicts == ["as declared", "as declared", "too low", "inconsistent"]
    assert with_file("order", "honest", "modest", *SHORT).code == 0


def test_a_scheme_without_any_result_is_a_failure() -> None:
    report = topcli.order("hk", "rk2", overrides=["T=200"], sizes=[5.0, 2.5])
    assert (report.code, report.notes[1]) == (1, "rk2: no result with h=5 fails at step 6")


@pytest.mark.parametrize(("schemes", "code"), [(["badbuild", "honest", "raising"], 3), (["badbuild"], 2)])
def test_studies_go_on_without_code_that_fails(with_file: Callable[..., Said], schemes: list[str], code: int) -> None:
    orders, trials = with_file("order", *schemes, *SHORT), with_file("stress", *schemes, "--case", "delone")
    assert (orders.code, trials.code) == (code, code)
    for said, failed, good in ((orders, "failed", "as declared"), (trials, "code failed", "ok")):
        rows = said.json()["tables"][0]["rows"]
        assert {row["scheme"]: row["verdict"] for row in rows} == {
            name: failed if name in FAILURES else good for name in schemes
        }
        assert all(FAILURES[name] in said.err for name in schemes if name in FAILURES)
