"""Methods that certainly compile to the same machine code, found without fingerprints."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from topcli.contracts import Stepper
from topcli.engine.fingerprint import fingerprint, same_method
from topcli.schemes.registry import all_schemes
from topcli.sweeps.evaluate import Shared, shared_experiment
from topcli.sweeps.measures import BatchRun
from topcli.tops import TOPS

evaluation = importlib.import_module("topcli.sweeps.measures.evaluate")


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
@pytest.mark.parametrize("form", sorted(TOPS))
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


def test_tops_that_share_code_keep_their_own_constants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation, "_codes", {})
    monkeypatch.setattr(evaluation, "_latest", {})
    start = np.array([[0.7, -0.4, 1.3, 0.6, 0.48, 0.64]])

    def last(text: str) -> list[float]:
        shared = Shared("heavy", text, '{"name": "rk4"}', 0.01, 50, 50)
        return BatchRun(shared_experiment(shared), ()).finished(start).last[0].tolist()

    made: list[Callable[..., Any]] = []
    real = evaluation.EnsembleCode
    monkeypatch.setattr(evaluation, "EnsembleCode", lambda *given: made.append(given) or real(*given))
    texts = [f'{{"kind": "heavy", "A": {A}, "B": 1.5, "C": 1.0}}' for A in (1.25, 1.75)]
    together = [last(text) for text in texts]
    assert len(made) == 1
    alone = []
    for text in texts:
        evaluation._codes.clear()
        evaluation._latest.clear()
        alone.append(last(text))
    assert len(made) == 3
    assert together == alone
    assert together[0] != together[1]
