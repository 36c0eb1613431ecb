"""Ladders of settings, and the scenes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel, Field

from topcli.contracts import Scheme
from topcli.errors import UnknownNameError, UsageError
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.bench.contest import SCENES, bench_problems, ladder, tolerance_option

# the ladders


def test_steps_divide_the_interval_and_get_finer() -> None:
    for name, ratio in (("hk", 2.0), ("rk4", math.sqrt(2.0)), ("hk+kahan-li8", math.sqrt(2.0))):
        rungs = list(ladder(find_scheme(name, "kowalevski"), np.array([0.7, -0.4, 1.3, 0.6, 0.48, 0.64]), 10.0))
        assert all(rung.value * rung.steps == pytest.approx(10.0, rel=1e-15) for rung in rungs)
        steps = [rung.steps for rung in rungs]
        assert steps == sorted(set(steps))
        assert 1.0 < rungs[0].value * 1.3 <= 4.0
        assert steps[20] / steps[18] == pytest.approx(ratio**2, rel=1e-2)


def test_the_step_ladder_of_a_state_of_any_size() -> None:
    scheme = find_scheme("hk", "kowalevski")
    for size in (0.0, 1e-12, 1e6):
        rungs = list(ladder(scheme, np.full(6, size), 0.5))
        assert 1 <= rungs[0].steps <= 0.125 * 1e6 + 1
        assert all(math.isfinite(rung.value) and rung.value > 0.0 for rung in rungs)


class Series(BaseModel):
    """Options of an adaptive scheme."""

    tol: float = Field(default=1e-10, gt=0.0, le=1e-4)


class Pair(BaseModel):
    """Options of another."""

    rtol: float = Field(default=1e-6, ge=2.5e-14)
    atol: float = Field(default=1e-8, ge=1e-15)


class Neither(BaseModel):
    """Options without a tolerance."""

    precision: float = 1e-6


def adaptive(options: type[BaseModel]) -> Scheme:
    base = find_scheme("rk4", "kowalevski")
    return Scheme(**{**vars(base), "name": "mine", "adaptive": True, "options": options})


def test_tolerances_come_from_the_options() -> None:
    y0 = np.ones(6)
    tols = list(ladder(adaptive(Series), y0, 1.0))
    assert tolerance_option(adaptive(Series)) == "tol"
    assert [rung.value for rung in tols] == [*(float(f"{m}e-{n}") for n in range(4, 18) for m in ("1", "0.32")), 1e-18]
    assert all(rung.steps == 1 and rung.options == (("tol", rung.value),) for rung in tols)
    pairs = list(ladder(adaptive(Pair), y0, 1.0))
    assert [rung.value for rung in pairs] == [
        *(float(f"{m}e-{n}") for n in range(2, 14) for m in ("1", "0.32")),
        2.5e-14,
    ]
    for rung in pairs:
        assert dict(rung.options)["atol"] == pytest.approx(max(1e-2 * rung.value, 1e-15), rel=1e-12)
        Pair.model_validate(dict(rung.options))  # within its limits
    with pytest.raises(UsageError, match="no option tol or rtol"):
        ladder(adaptive(Neither), y0, 1.0)


def test_every_adaptive_scheme_has_a_ladder() -> None:
    found = [scheme for scheme in all_schemes() if scheme.adaptive]
    assert found
    for scheme in found:
        rungs = list(ladder(scheme, np.ones(6), 1.0))
        assert len(rungs) > 5
        for rung in rungs:
            scheme.options.model_validate(dict(rung.options))


# scenes


def test_bench_scenes_have_their_tops_and_durations() -> None:
    problems = {problem.name: problem for problem in bench_problems((), ())}
    assert list(problems) == list(SCENES)
    assert problems["kowalevski-generic"].duration == 1000.0
    assert problems["kowalevski-paper"].duration == 50.0
    assert {problem.top.kind for problem in problems.values()} == {"kowalevski", "euler", "lagrange"}
    for problem in problems.values():
        assert len(problem.times) == 101
        assert problem.times[0] == 0.0
        assert problem.times[-1] == pytest.approx(problem.duration, rel=1e-15)


def test_a_config_is_a_scene(in_tmp: Path) -> None:
    (problem,) = bench_problems((), ("heavy_rk4",), ("N=500",), 10)
    assert problem.name == "heavy_rk4"
    assert problem.duration == problem.experiment.h * 500
    with pytest.raises(UsageError, match="runs backwards"):
        bench_problems((), ("heavy_rk4",), ("h=-0.01",))
    with pytest.raises(UsageError, match="named twice"):
        bench_problems(("euler", "EULER"), ())
    with pytest.raises(UsageError, match="none is given"):
        bench_problems((), (), ("h=1",))
    with pytest.raises(UnknownNameError, match="did you mean 'lagrange'"):
        bench_problems(("lagrnge",), ())
