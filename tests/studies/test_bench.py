"""Speed against error: ladders, what counts as a result, peers in processes of their own, decades and the figure."""

from __future__ import annotations

import itertools
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure as Canvas

import topcli
from cases import table_of
from peers import start
from topcli.analysis.reference import distances, reference_states
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.errors import SchemeCodeError
from topcli.figures.figure import NothingMeasuredError
from topcli.figures.schemes import draw_work_precision, work_precision
from topcli.studies.bench import DECADES, PEERS, Peer, answer_of, decade_rows, point_rows, take_turns
from topcli.studies.ladder import ErrorCurve, NoResultError, ladder
from topcli.studies.report import Report

TIMES = np.arange(21) * 0.5
SHORT = ["h=0.01", "N=1000"]


def experiment_of(scheme: str, *overrides: str) -> Experiment:
    return load_experiment("kowalevski_generic_hk", [f"scheme={scheme}", *SHORT, *overrides])


def bench(*schemes: str, **options: Any) -> Report:
    """Short benchmark."""
    short = {"overrides": SHORT, "budget": 1e-3, "repetitions": 1, "samples": 20, "against": ["none"]}
    return topcli.bench(*schemes, **{**short, **options})


def rows_of(report: Report, name: str) -> list[Any]:
    return [row for row in report.tables[1].rows if name in (row["scheme"], row["peer"])]


# schemes


@pytest.mark.parametrize(
    ("scheme", "interval", "settings"),
    [
        ("hk", 10.0, [2.5, 1.25, 0.625]),
        ("hk", 0.1, [0.1, 0.05, 0.025]),
        ("rk4", 0.1, [0.1, 0.05, 0.1 / 3.0, 0.025, 0.1 / 6.0]),
        ("taylor", 10.0, [0.01, 0.0032, 0.001]),
    ],
)
def test_ladders_divide_the_interval_or_have_half_decades(scheme: str, interval: float, settings: list[float]) -> None:
    """The largest component of the initial state is 1.3, which turns by 13 in the longest interval."""
    assert list(ladder(experiment_of(scheme), interval))[: len(settings)] == pytest.approx(settings)


@pytest.mark.parametrize("scheme", ["hk", "backlund", "taylor"])
def test_errors_are_those_of_the_run(scheme: str) -> None:
    report = bench(scheme)
    row = rows_of(report, scheme)[4]
    name, _, value = row["setting"].partition("=")
    steps = round(0.5 / float(value)) if name == "h" else 1
    override = [f"h={0.5 / steps}", f"N={20 * steps}", *([] if name == "h" else [f"scheme.{row['setting']}"])]
    experiment = load_experiment("kowalevski_generic_hk", [f"scheme={scheme}", *override])
    states = topcli.simulate(experiment.resolved()).states[::steps]
    error = distances(states, reference_states(experiment.top, experiment.y0, TIMES)).max()
    assert row["error"] == pytest.approx(error, rel=1e-9)
    assert row["seconds"] > 0.0
    assert row["set_up"] > 0.0


# measurements


def made_up(errors: list[float], seconds: float = 1e-4, name: str = "made-up") -> ErrorCurve:
    """Competitor with these errors at h = 1, 1/2, ...; nan fails, and inf is a failure of its code."""

    def measure(setting: float, calls: int) -> tuple[Any, float]:
        error = errors[round(-math.log2(setting))]
        if math.isnan(error):
            raise NoResultError("fails at step 1")
        if math.isinf(error):
            raise SchemeCodeError("its process died")
        return np.full((1, 1), error), seconds

    return ErrorCurve(name, "scheme", "h", [0.5**k for k in range(len(errors))], 1.0, measure)


def test_a_ladder_ends_at_round_off_and_not_before() -> None:
    errors = [1.0, 2.0, 1.5, 1e-3, 1e-9, 1.2e-9, 0.9e-9, 1e-9, 1e-10]
    curve = made_up(errors)
    curve.climb(np.zeros((1, 1)))
    assert [point.error for point in curve.points] == errors[:7]


def test_failures_stop_nothing_else() -> None:
    """A setting that fails is passed over, failed code is named once, and useless points are not repeated."""
    curves = [made_up([math.nan, 5.0, 1e-3]), made_up([1e-2, math.inf, 1e-3], name="dead"), made_up([1e-2])]
    progress: list[tuple[int, int]] = []
    errors = take_turns(curves, np.zeros((1, 1)), 4, lambda done, total: progress.append((done, total)))
    assert errors == ["dead: its process died"]
    assert curves[0].failure == "h=1 fails at step 1"
    assert [[len(point.samples) for point in curve.points] for curve in curves] == [[0, 4], [4], [4]]
    assert progress[-1] == (15, 15)
    assert [row["seconds"] for row in point_rows(curves[:1], 2.0)] == [5e-5, 5e-5]


def test_decades_name_the_fastest_of_each_kind() -> None:
    """Of at most that error: a faster point of a larger error does not count."""
    points = [
        {"scheme": None, "peer": None, kind: name, "setting": f"h={error}", "error": error, "seconds": seconds}
        for name, kind, error, seconds in [
            ("hk", "scheme", 2e-3, 1e-6), ("rk4", "scheme", 1e-4, 2e-6), ("hk", "scheme", 1e-5, 9e-6),
            ("scipy", "peer", 1e-4, 8e-6), ("heyoka", "peer", 9e-5, 5e-6),
        ]
    ]  # fmt: skip
    first, second, third, *others = decade_rows(points)
    assert (first["best scheme"], first["best peer"], first["ratio"]) == ("rk4", "heyoka", 2.5)
    assert second == {**first, "error": 1e-4}
    assert (third["best scheme"], third["best peer"], third["ratio"]) == ("hk", None, None)
    assert [row["error"] for row in others] == list(DECADES[3:])
    assert answer_of([first, second, third]) == "2.5 to 2.5 times as fast as the best peer at 2 decades of error"
    assert answer_of([third]) == "for an error of 1e-05 take hk with h=1e-05"
    assert answer_of(others) == "no scheme reaches an error of 0.001"


# peers


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "error", "settings"),
    [("raise", "", 2), ("die", "mine: its process died", 1), ("import", "mine gave no result: tol=0.5 ImportError", 0)],
)
def test_peers_run_in_a_process_of_their_own(
    monkeypatch: pytest.MonkeyPatch, fault: str, error: str, settings: int
) -> None:
    """Their output, exceptions and crashes stay there and are reported."""
    monkeypatch.setitem(PEERS, "mine", Peer("numpy", partial(start, fault=fault), [0.5, 0.25, 0.125]))
    report = bench("rk4", against=["mine"])
    assert len(rows_of(report, "mine")) == settings
    assert len(rows_of(report, "rk4")) > 3
    assert report.code == (3 if error else 0)
    assert [line.startswith(error) for line in report.errors] == [True] * bool(error)


@pytest.mark.slow
def test_scipy_gets_nearer_with_its_tolerance() -> None:
    report = bench("rk4", against=["scipy"])
    errors = [row["error"] for row in rows_of(report, "scipy")]
    assert all(coarse > 5.0 * fine for coarse, fine in itertools.pairwise(errors[:5]))
    assert min(errors) < 1e-10
    assert "times as fast as the best peer" in report.answer


def test_a_missing_peer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(
        PEERS, "absent", Peer("no_such_package", lambda experiment, times: pytest.fail("it was prepared"), [])
    )
    report = bench("rk4", against=["absent"])
    assert report.notes == ["peer absent is skipped: run pip install 'topcli[no_such_package]'"]
    assert report.code == 0


# the command and the figure


@pytest.mark.parametrize(
    ("arguments", "message"),
    table_of("""
exact                      is evaluated, not stepped
rk4 --against heyok        did you mean 'heyoka'
rk4 --set h=-0.1           runs backwards
"""),
)
def test_mistakes_are_reported_with_a_correction(cli: Any, arguments: str, message: str) -> None:
    failed = cli("bench", *arguments.split())
    assert failed.code == 2
    assert message in failed.err


def test_the_figure_has_a_panel_for_each_stored_report(in_tmp: Path) -> None:
    with pytest.raises(NothingMeasuredError, match=r"--save results/bench/NAME\.json"):
        work_precision()
    Path("results/bench").mkdir(parents=True)
    report = bench("hk", "rk4")
    report.save("results/bench/one.json")
    bench("hk", config="euler_hk").save("results/bench/two.json")
    columns = work_precision()
    points = report.tables[-1].rows
    assert columns["kowalevski_generic_hk|error"].tolist() == [row["error"] for row in points]
    canvas = Canvas()
    draw_work_precision(canvas, columns)
    assert [len(axes.lines) for axes in canvas.axes] == [len(report.plot().lines), 1]
    for line in canvas.axes[0].lines:
        errors, times = np.array(line.get_xydata()).T
        assert (np.diff(errors) < 0.0).all()
        assert (np.diff(times) > 0.0).all()
