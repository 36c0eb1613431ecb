"""A figure is drawn again after a change of anything that it depends on: each function edited, the code of schemes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

from conftest import ROOT
from figure_studies import PREPARE
from sweep_rows import write_rows
from topcli.analysis import order as analysis_of_orders
from topcli.analysis import reference, roundoff, swings
from topcli.figures import (
    comparison,
    curves,
    errors,
    long_energy,
    period,
    picture,
    stress,
    sweep,
    torus_points,
    work_precision,
)
from topcli.figures import roundoff as growth
from topcli.figures.catalogue import FIGURES
from topcli.figures.curves import HeatPanel
from topcli.figures.figure import Loaded, Request, _source
from topcli.figures.sweep import Choice, sweep_figure
from topcli.schemes.kowalevski import hk
from topcli.studies import order as study_of_orders
from topcli.studies import roundoff as study_of_roundoff
from topcli.studies.bench import measure
from topcli.studies.bench.result import pareto_front
from topcli.studies.stress import checks
from topcli.studies.stress import study as study_of_stress
from topcli.sweeps import table
from topcli.sweeps.rows import read_rows

HK_STEP = hk.hk_kowalevski_change
SOURCES: dict[str, tuple[Callable[[], str], list[Any]]] = {
    "order": (
        lambda: study_of_orders.order_source(study_of_orders.ladders(["hk", "rk4"])),
        [
            HK_STEP,
            study_of_orders.order_study,
            study_of_orders._row,
            study_of_orders._Ladder.rungs,
            analysis_of_orders.convergence,
            analysis_of_orders.observed_order,
            measure.explore,
            measure.SchemeCompetitor.run,
            reference.reference_states,
        ],
    ),
    "stress": (
        study_of_stress.stress_source,
        [HK_STEP, study_of_stress.verdict_of, checks.keeps_order, checks.claim_violated],
    ),
    "error-and-cost": (
        errors.study_source,
        [HK_STEP, errors.error_and_cost, measure.time_all, measure.as_rows, measure.SchemeCompetitor.run],
    ),
    "roundoff": (
        growth.growth_code,
        [
            HK_STEP,
            growth.turned_step,
            growth.bs_change,
            study_of_roundoff.sampling_of,
            study_of_roundoff.copies_followed,
            study_of_roundoff._followed,
            study_of_roundoff._copies,
            roundoff.BlockMeans.add,
            roundoff.block_weights,
            roundoff.doubling_lags,
            roundoff.structure,
        ],
    ),
    "integrable": (long_energy.energy_code, [HK_STEP, long_energy._energy_errors, long_energy.largest_by_octave]),
    "period": (period.period_code, [HK_STEP, period._gamma1, swings.swing_spacing, swings.minima_times]),
    "torus-points": (torus_points.torus_code, [HK_STEP, torus_points.orbit, torus_points.crossings]),
}
"""Digest of what each study depends on, and functions whose results are in its data."""


def edit(patch: pytest.MonkeyPatch, function: Any) -> None:
    """Give a function another code in its place, wherever it is imported, as an editor would."""
    assert isinstance(function, FunctionType)
    code = function.__code__
    patch.setattr(function, "__code__", code.replace(co_consts=(*code.co_consts, "edited")))


@pytest.mark.slow
@pytest.mark.parametrize("name", SOURCES)
def test_the_source_of_a_study_names_every_function_behind_its_numbers(name: str) -> None:
    source, functions = SOURCES[name]
    before = source()
    for function in functions:
        with pytest.MonkeyPatch.context() as patch:
            edit(patch, function)
            assert source() != before, function.__qualname__
    assert source() == before


def source_of(loaded: Loaded) -> str:
    """Text that decides whether a figure is drawn again."""
    return _source(loaded, {})


DRAWING: dict[str, list[Any]] = {
    "order": [errors.order_data, curves.CurvePanel._curve, analysis_of_orders.convergence, picture.draw],
    "stress": [stress.figure_data, stress._step_text, stress.StressGrid.annotate],
    "work-precision": [work_precision._curves, work_precision._shown, pareto_front],
    "compare": [comparison._data, comparison.ErrorPanel.paint, reference.distances, HK_STEP],
    "swings": [sweep._points, table.summary, picture.Grid.annotate],
}
"""Functions between the results of a study and its picture."""


@pytest.mark.parametrize("name", DRAWING)
def test_a_figure_is_drawn_again_after_an_edit_of_its_code(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name in PREPARE:
        PREPARE[name](monkeypatch, tmp_path)

    def source() -> str:
        return source_of(FIGURES[name].load(Request(tmp_path, ROOT / "configs")))

    before = source()
    for function in DRAWING[name]:
        with pytest.MonkeyPatch.context() as patch:
            edit(patch, function)
            assert source() != before, function.__qualname__
    assert source() == before


def test_a_figure_of_a_sweep_is_drawn_again_for_other_rows_choices_and_code(tmp_path: Path) -> None:
    keys = {"h": [0.1, 0.05, 0.1, 0.05], "seed": [1.0, 1.0, 2.0, 2.0]}
    folder = write_rows(tmp_path / "one", keys, {"v": [1.0, 2.0, 3.0, 4.0]})
    other = write_rows(tmp_path / "two" / "one", keys, {"v": [1.0, 2.0, 3.0, 5.0]})
    choice = Choice("h", "v", aggregate="median")

    def source(choice: Choice = choice, folder: Path = folder) -> str:
        return source_of(sweep_figure(read_rows(folder), choice).load(Request()))

    changed = [source(), source(Choice("h", "v", aggregate="max")), source(folder=other)]
    heat = Choice("h", "seed", colour="v")
    changed.append(source(heat))
    for function, one in ((table.summary, choice), (sweep.scale_of, choice), (HeatPanel._norm, heat)):
        with pytest.MonkeyPatch.context() as patch:
            edit(patch, function)
            changed.append(source(one))
    assert len(set(changed)) == len(changed)
    assert source() == changed[0]


def test_a_longer_study_of_orders_is_another_source() -> None:
    """Its settings that are constants of the module."""
    before = study_of_orders.order_source(study_of_orders.ladders(["hk"]))
    for name, value in (("SECONDS", 6.0), ("INTERVALS", 21), ("DURATION", 11.0)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(study_of_orders, name, value)
            assert study_of_orders.order_source(study_of_orders.ladders(["hk"])) != before, name
