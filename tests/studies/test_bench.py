"""Speed against error: ladders, errors, repetitions, peers, the line-up, and the results on disk."""

from __future__ import annotations

import itertools
import math
import os
import re
import statistics
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from cases import table_of
from topcli.analysis.reference import reference_states
from topcli.contracts import Scheme, Stepper
from topcli.engine.collect import orbit
from topcli.errors import UnknownNameError, UsageError
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.bench.contest import (
    LineUp,
    Problem,
    Rung,
    bench_problems,
    choose,
    default_names,
    ladder,
)
from topcli.studies.bench.measure import (
    Effort,
    FirstCall,
    Measured,
    Measurements,
    SchemeCompetitor,
    as_rows,
    bench,
    explore,
)
from topcli.studies.bench.peers import PEERS, NoResultError, Peer, PeerProblem, checked, find_peers, missing
from topcli.tops import TOPS


def test_steps_divide_the_interval_and_get_finer() -> None:
    for name, ratio in (("hk", 2.0), ("rk4", math.sqrt(2.0)), ("hk+kahan-li8", math.sqrt(2.0))):
        rungs = list(ladder(find_scheme(name, "kowalevski"), np.array([0.7, -0.4, 1.3, 0.6, 0.48, 0.64]), 10.0))
        assert all(rung.value * rung.steps == pytest.approx(10.0, rel=1e-15) for rung in rungs)
        steps = [rung.steps for rung in rungs]
        assert steps == sorted(set(steps))
        assert 1.0 < rungs[0].value * 1.3 <= 4.0
        assert steps[20] / steps[18] == pytest.approx(ratio**2, rel=1e-2)


def adaptive(options: type[BaseModel]) -> Scheme:
    base = find_scheme("rk4", "kowalevski")
    return Scheme(**{**vars(base), "name": "mine", "adaptive": True, "options": options})


def test_every_adaptive_scheme_has_a_ladder() -> None:
    found = [scheme for scheme in all_schemes() if scheme.adaptive]
    assert found
    for scheme in found:
        rungs = list(ladder(scheme, np.ones(6), 1.0))
        assert len(rungs) > 5
        for rung in rungs:
            scheme.options.model_validate(dict(rung.options))


@pytest.mark.parametrize(
    ("scenes", "configs", "sets", "message"),
    table_of("""
()                    ("heavy_hk",)  ("h=-0.01",)  runs backwards
("euler", "EULER")    ()              ()            named twice
()                    ()              ("h=1",)      none is given
("lagrnge",)          ()              ()            did you mean 'lagrange'
"""),
)
def test_wrong_scenes_are_refused(
    scenes: tuple[str, ...], configs: tuple[str, ...], sets: tuple[str, ...], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        bench_problems(scenes, configs, sets)


def test_every_scheme_takes_part_or_is_left_out_with_a_reason() -> None:
    for problem in bench_problems((), ()):
        line_up = choose(problem, ())
        taking_part = [scheme.name for scheme in (*line_up.schemes, *line_up.closed_forms)]
        left_out = dict(line_up.left_out)
        assert len(set(taking_part)) == len(taking_part)
        assert {scheme.name for scheme in all_schemes() if scheme.top == problem.top.form} <= {*taking_part, *left_out}
        assert sorted([*taking_part, *left_out]) == sorted(default_names(problem.top.form))
        assert all(left_out.values())
        assert [scheme.name for scheme in line_up.closed_forms] == ["exact"]


def test_names_that_do_not_fit_are_refused() -> None:
    kowalevski, euler = bench_problems(("kowalevski-generic", "euler"), ())
    assert dict(choose(euler, ("hk", "hybrid")).left_out) == {"hybrid": "does not fit the top euler"}
    assert [scheme.name for scheme in choose(kowalevski, ("dop853",)).schemes] == ["dop853"]
    entries = ("backlund:nodes=exact", "backlund:nodes=plain", "dmv+kahan-li8:project=1")
    assert [scheme.order for scheme in choose(kowalevski, entries).schemes] == [None, 2, 8]
    for names, message in (
        (("hk", "HK"), "named twice"),
        (("midpont",), "did you mean"),
        (("dmv:projct=1",), r"dmv:projct=1: scheme 'dmv' has no option 'projct'.*project"),
        (("dmv:project=-1",), "project: "),
    ):
        with pytest.raises(UsageError, match=message):
            choose(euler, names)


@pytest.fixture(scope="module")
def short() -> Problem:
    """The generic Kowalevski top for a short while."""
    (problem,) = bench_problems((), ("kowalevski_generic_hk",), ("h=0.01", "N=1000"), 20)
    return problem


@pytest.mark.parametrize(("name", "order"), [("rk2", 2), ("hk+kahan-li6", 6)])
def test_errors_fall_as_the_order_says(short: Problem, name: str, order: int) -> None:
    reference = reference_states(short.top, short.experiment.y0, short.times)
    mine = SchemeCompetitor(find_scheme(name, "kowalevski"), short)
    standing = explore(mine, short, reference, Effort(0.02, 1))
    asymptotic = [rung for rung in standing.rungs if 1e-10 < rung.error < 1e-3]
    assert len(asymptotic) > 3
    a, b = asymptotic[-2:]
    assert math.log(a.error / b.error) / math.log(a.rung.value / b.rung.value) == pytest.approx(order, abs=0.2)
    assert all(rung.final_error <= rung.error for rung in standing.rungs)
    assert all(set(rung.drift) == {"gamma_sq", "two_l", "energy", "k_sq"} for rung in standing.rungs)


def test_a_run_of_the_bench_is_a_run_of_the_engine(short: Problem) -> None:
    """The states that errors are taken from are, bit for bit, those that ``orbit`` records."""
    scheme = find_scheme("hybrid", "kowalevski")
    mine = SchemeCompetitor(scheme, short)
    rung = next(rung for rung in mine.rungs() if rung.steps >= 8)
    states = mine.run(rung).states
    method, h = scheme.build(short.top, scheme.options()), short.interval / rung.steps
    run = orbit(short.top, method, short.experiment.y0, h, rung.steps * short.intervals, rung.steps)
    assert (states == run.states).all()


def test_a_block_that_returns_early_is_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its later states are not there; before, memory of an earlier array was taken for them."""
    monkeypatch.setattr("topcli.schemes.any_top.taylor.MAX_EXPANSIONS", 3)
    (problem,) = bench_problems((), ("kowalevski_generic_hk",), ("h=1", "N=50"), 2)
    with pytest.raises(NoResultError, match=r"returns after step \d+ of \d+"):
        SchemeCompetitor(find_scheme("taylor", "kowalevski"), problem).run(Rung(problem.interval, 1))


def test_an_adaptive_scheme_gets_nearer_with_its_tolerance() -> None:
    (problem,) = bench_problems((), ("kowalevski_generic_hk",), ("h=0.01", "N=2000"), 2)
    reference = reference_states(problem.top, problem.experiment.y0, problem.times)
    mine = SchemeCompetitor(find_scheme("dop853", "kowalevski"), problem)
    assert mine.parameter == "rtol"
    errors = [np.abs(mine.run(rung).states - reference).max() for rung in list(mine.rungs())[::8]]
    assert len(errors) == 4
    assert errors[0] == pytest.approx(0.0238, rel=0.05)
    assert all(a > 30.0 * b for a, b in itertools.pairwise(errors[:3]))
    assert errors[-1] < 1e-11


class Scripted:
    """A competitor whose errors and times are given."""

    name, kind, parameter, order = "scripted", "topcli", "h", 2

    def __init__(self, errors: list[float], seconds: list[float], problem: Problem, patience: float = 1.0) -> None:
        self.errors, self.spent, self.patience = errors, seconds, patience
        self.reference = np.zeros((problem.intervals + 1, 6))
        self.calls: list[int] = []

    def rungs(self) -> Iterator[Rung]:
        return (Rung(0.5**k, 2**k) for k in range(len(self.errors)))

    def run(self, rung: Rung) -> FirstCall:
        k = rung.steps.bit_length() - 1
        if math.isnan(self.errors[k]):
            raise NoResultError("fails at step 1 of 2")
        states = self.reference.copy()
        states[-1, 0] = self.errors[k]
        return FirstCall(states, self.spent[k], 0.0)

    def seconds(self, rung: Rung, calls: int) -> list[float]:
        self.calls.append(rung.steps)
        if len(self.calls) == 5:
            raise NoResultError("its process died")
        return [2.0, 1.0]


def test_a_ladder_ends_at_round_off_and_not_before(short: Problem) -> None:
    errors = [1.0, 2.0, 1.5, 1e-3, 1e-9, 1.2e-9, 0.9e-9, 1e-9, 1e-10]
    mine = Scripted(errors, [1e-4] * len(errors), short)
    standing = explore(mine, short, mine.reference, Effort(1.0, 1))
    assert [rung.error for rung in standing.rungs] == errors[:7]
    assert "round-off" in standing.ended


def test_a_failing_setting_is_passed_over(short: Problem) -> None:
    mine = Scripted([math.nan, 1e-2, 1e-3], [1e-4] * 3, short)
    standing = explore(mine, short, mine.reference, Effort(1.0, 1))
    assert standing.failed == [(1.0, "fails at step 1 of 2")]
    assert [rung.error for rung in standing.rungs] == [1e-2, 1e-3]


@pytest.mark.slow
def test_a_step_that_cannot_be_compiled_stops_nothing_else(short: Problem) -> None:
    def step(s: Any, h: float, p: Any) -> Any:
        return print(s)

    bad = replace(find_scheme("hk", "kowalevski"), name="bad", build=lambda top, options: Stepper(step, 6))
    talk: list[str] = []
    both = LineUp((bad, find_scheme("rk4", "kowalevski")), (), ())
    result = bench(short, both, [], Effort(0.001, 1), on_message=talk.append)
    assert "cannot be compiled" in result["competitors"][0]["broken"]
    assert len(talk) == 1
    assert talk[0].startswith("error: kowalevski_generic_hk: bad failed")
    assert result["competitors"][1]["points"]


def test_a_missing_peer_is_named(short: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    absent = Peer("absent", "not there", "topcli.no_such_module:variants", ("no_such_package_of_anybody",))
    assert "no_such_package_of_anybody not installed" in missing(absent)
    talk: list[str] = []
    result = bench(short, choose(short, ("hk",)), [absent], Effort(0.001, 1), on_message=talk.append)
    assert result["skipped_peers"] == [{"name": "absent", "reason": missing(absent)}]
    assert talk == [f"kowalevski_generic_hk: peer absent is skipped: {missing(absent)}"]


@pytest.fixture
def peer_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Peer]:
    """Function that returns the peer of a file with this text."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]))

    def write(text: str) -> Peer:
        (tmp_path / "peer_of_mine.py").write_text(text)
        return Peer("mine", "", "peer_of_mine:variants", ("numpy",))

    return write


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("import os, sys; print('no luck', file=sys.stderr, flush=True); os._exit(7)", "died with code 7: no luck"),
        ("raise ImportError('wants gold\\nand more')", "ImportError: wants gold"),
        ("print('noise')", "AttributeError: module 'peer_of_mine' has no attribute 'variants'"),
    ],
)
def test_a_peer_that_fails_is_named(short: Problem, peer_file: Callable[[str], Peer], text: str, reason: str) -> None:
    talk: list[str] = []
    result = bench(short, choose(short, ("hk",)), [peer_file(text)], Effort(0.001, 1), on_message=talk.append)
    (failed,) = result["failed_peers"]
    assert failed["name"] == "mine"
    assert failed["reason"].endswith(reason)
    assert "mine failed" in talk[0]
    assert [row["name"] for row in result["competitors"]] == ["hk"]


def test_states_of_a_peer_are_complete_and_finite() -> None:
    problem = PeerProblem(TOPS["kowalevski"].new(), np.zeros(6), np.arange(3.0))
    assert checked(np.zeros((3, 6)), problem).shape == (3, 6)
    for shape, value, reason in (
        ((2, 6), 0, "shape (2, 6)"),
        ((3, 5), 0, "expected (3, 6)"),
        ((3, 6), np.inf, "finite"),
    ):
        with pytest.raises(NoResultError, match=re.escape(reason)):
            checked(np.full(shape, value), problem)


def test_wrong_names_of_peers_are_refused() -> None:
    assert [peer.name for peer in find_peers(["Heyoka", "scipy"])] == ["heyoka", "scipy"]
    with pytest.raises(UnknownNameError, match="did you mean 'heyoka'"):
        find_peers(["heyok"])
    with pytest.raises(UsageError, match="named twice"):
        find_peers(["scipy", "SciPy"])


@pytest.mark.slow
def test_scipy_as_a_peer(short: Problem) -> None:
    """A peer that is always there, in its process: its errors fall with its tolerance, and its seconds are counted."""
    result = bench(short, choose(short, ("rk4",)), find_peers(["scipy"]), Effort(0.02, 1))
    rows = {row["name"]: row for row in result["competitors"]}
    assert set(rows) == {"rk4", "scipy dop853", "scipy dop853 numba"}
    for name in ("scipy dop853", "scipy dop853 numba"):
        points = rows[name]["points"]
        errors = [row["error"] for row in points]
        assert len(errors) == 6
        assert all(a > 5.0 * b for a, b in itertools.pairwise(errors[:4]))
        assert min(errors) < 1e-11
        assert all(row["seconds"] > 0.0 for row in points)
    ours, theirs = (np.array([row["error"] for row in rows[name]["points"]]) for name in list(rows)[1:])
    assert ours == pytest.approx(theirs, rel=0.2, abs=1e-12)  # the same method


def test_a_rung_s_figures_are_those_of_its_samples(short: Problem) -> None:
    """The process with the smallest median counts; times are per unit of simulated time."""
    samples = [[8.0, 4.0, 7.0, 5.0], [3.0, 9.0, 2.0, 4.0], [6.0, 6.5, 5.5, 1.0]]
    rung = Measured(Rung(0.25), 1e-3, 2e-4, {"energy": 3e-5, "gamma_sq": 4e-6}, 77.0, 88.0, samples)
    untimed = Measured(Rung(0.5), 1e-2, 2e-3, {}, 77.0, 88.0)
    one, other = as_rows(Measurements(Scripted([], [], short), [rung, untimed]), 10.0)
    assert one["seconds"] == statistics.median(samples[1]) / 10.0
    assert one["fastest"] == 0.2
    assert one["quartiles"] == pytest.approx([q / 10.0 for q in (2.75, 5.25)])
    assert one["repetitions"] == 4
    assert one["processes"] == pytest.approx([statistics.median(process) / 10.0 for process in samples])
    assert (one["value"], one["error"], one["final_error"], one["drift"]) == (0.25, 1e-3, 2e-4, 3e-5)
    assert one["invariants"] == {"energy": 3e-5, "gamma_sq": 4e-6}
    assert (other["seconds"], other["fastest"], other["quartiles"]) == (7.7, 7.7, [7.7, 7.7])
    assert (other["repetitions"], other["processes"], other["drift"]) == (0, [], 0.0)


PEER = """
import numpy as np
from topcli.studies.bench.peers import NoResultError, Variant, checked

def variants(problem):
    def prepare(value):
        if value < 0.2:
            raise NoResultError("too small")
        def call():
            y = np.tile(problem.y0, (len(problem.times), 1))
            return checked(y + value, problem)
        return call
    return [Variant("mine still", "offset", [0.5, 0.25, 0.125], prepare)]
"""


@pytest.mark.slow
def test_a_peer_is_a_function_and_one_entry(
    short: Problem, peer_file: Callable[[str], Peer], monkeypatch: pytest.MonkeyPatch
) -> None:
    """``--against`` finds it, and its variants are measured in a process of its own."""
    monkeypatch.setitem(PEERS, "mine", peer_file(PEER))
    result = bench(short, choose(short, ("rk4",)), find_peers(["MINE"]), Effort(0.002, 1))
    (mine,) = [row for row in result["competitors"] if row["name"] == "mine still"]
    still = np.abs(reference_states(short.top, short.experiment.y0, short.times) - np.array(short.experiment.y0))
    assert [row["value"] for row in mine["points"]] == [0.5, 0.25]
    assert mine["failed"] == [{"value": 0.125, "reason": "too small"}]
    assert all(row["error"] > still.max() - 0.5 for row in mine["points"])
    assert mine["points"][0]["invariants"]["gamma_sq"] == pytest.approx(0.0, abs=1e-15)
    assert all(row["peer"] is None or row["peer"]["name"] != "rk4" for row in result["decades"])
    with pytest.raises(UnknownNameError, match="did you mean 'mine'"):
        find_peers(["minee"])
