"""The line-up of a benchmark: nothing that could be the fastest for some error is missing."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from topcli.analysis.reference import reference_states
from topcli.contracts import Stepper
from topcli.errors import UnknownNameError, UsageError
from topcli.schemes.registry import all_schemes, composable_names, find_scheme
from topcli.studies.bench.contest import COMPOSED, Rung, bench_problems, choose, default_names
from topcli.studies.bench.measure import SchemeCompetitor
from topcli.studies.entries import scheme_with
from topcli.studies.operations import operations_of
from topcli.tops import TOPS

CLOSE = 3.0
"""Bases that reach an error within this factor of the fewest operations are composed: no composition of a worse base
makes up for it, as all have the same number of stages."""


def test_every_scheme_takes_part_or_is_left_out_with_a_reason() -> None:
    for problem in bench_problems((), ()):
        line_up = choose(problem, ())
        taking_part = [scheme.name for scheme in (*line_up.schemes, *line_up.exact)]
        left_out = dict(line_up.left_out)
        assert len(set(taking_part)) == len(taking_part)
        assert {scheme.name for scheme in all_schemes() if scheme.top == problem.top.form} <= {*taking_part, *left_out}
        assert sorted([*taking_part, *left_out]) == sorted(default_names(problem.top.form))
        assert all(left_out.values())
        assert [scheme.name for scheme in line_up.exact] == ["exact"]


@pytest.mark.parametrize("form", list(TOPS))
def test_every_order_that_options_give_takes_part(form: str) -> None:
    for scheme in all_schemes():
        if scheme.top != form:
            continue
        models = scheme.options.model_fields
        choices = [[(key, value) for value in get_args(models[key].annotation) or ()] for key in models]
        orders = set()
        for picked in itertools.product(*([None, *some] for some in choices)):
            try:
                options = scheme.options.model_validate(dict(one for one in picked if one))
            except ValueError:
                continue
            orders.add(scheme.order_for(options))
        names = [name for name in default_names(form) if name.partition(":")[0] == scheme.name]
        assert sorted(map(str, orders)) == sorted(str(scheme_with(name, form).order) for name in names)


def test_exact_nodes_take_part_with_their_option() -> None:
    (generic,) = bench_problems(("kowalevski-generic",), ())
    (exact,) = [scheme for scheme in choose(generic, ()).schemes if scheme.name == "backlund:nodes=exact"]
    plain = find_scheme("backlund", "kowalevski")
    assert exact.order is None
    assert exact.options().model_dump() == plain.options().model_dump() | {"nodes": "exact"}
    longer = exact.build(generic.top, exact.options())
    assert isinstance(longer, Stepper)
    assert longer.width > plain.build(generic.top, plain.options()).width  # type: ignore[union-attr]


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["kowalevski-generic", "euler", "lagrange"])
def test_compositions_of_every_promising_base_take_part(scene: str) -> None:
    """For schemes of order 2 operations to an error e are work times sqrt(C / e), where the error is C h^2."""
    (problem,) = bench_problems((scene,), ())
    problem = replace(problem, duration=10.0, intervals=10)
    reference = reference_states(problem.top, problem.experiment.y0, problem.times)
    cost = {}
    for name in composable_names(problem.top.form):
        scheme = find_scheme(name, problem.top.form)
        assert scheme.order == 2
        count = operations_of(scheme)
        assert count is not None
        work = count.sums + count.products + 8.0 * (count.divisions + count.roots) + 20.0 * count.functions
        states = SchemeCompetitor(scheme, problem).run(Rung(problem.interval / 200, 200)).states
        cost[name] = work * math.sqrt(float(np.linalg.norm(states - reference, axis=1).max()))
    promising = {name for name in cost if cost[name] < CLOSE * min(cost.values())}
    assert promising <= set(COMPOSED)
    names = default_names(problem.top.form)
    assert {f"{base}+{composition}" for base in promising for composition in COMPOSED[base]} <= set(names)


def test_names_that_do_not_fit_are_refused() -> None:
    kowalevski, euler = bench_problems(("kowalevski-generic", "euler"), ())
    assert dict(choose(euler, ("hk", "hybrid")).left_out) == {"hybrid": "does not fit the top euler"}
    assert [scheme.name for scheme in choose(kowalevski, ("dop853",)).schemes] == ["dop853"]
    assert [scheme.order for scheme in choose(euler, ("dmv:moments=preprocessed,order=8",)).schemes] == [8]
    with pytest.raises(UsageError, match="named twice"):
        choose(euler, ("hk", "HK"))
    with pytest.raises(UnknownNameError, match="did you mean"):
        choose(euler, ("midpont",))
    with pytest.raises(UnknownNameError, match=r"dmv:moment=plain: scheme 'dmv' has no option 'moment'.*'moments'"):
        choose(euler, ("dmv:moment=plain",))
    with pytest.raises(UsageError, match="order: "):
        choose(euler, ("dmv:order=5",))
    (refused,) = choose(euler, ("dmv:order=6",)).left_out
    assert refused == ("dmv:order=6", "order: 6 needs moments: preprocessed; with plain moments the order is 2")
