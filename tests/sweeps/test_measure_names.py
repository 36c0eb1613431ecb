"""Names of measures, what does not fit, and the reference that runs share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from sweeping import measured
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Floats, Invariant, Scheme, Top
from topcli.errors import UsageError
from topcli.runs.references import SharedReferences, reference_of
from topcli.schemes.plugins import load_plugin_file
from topcli.schemes.registry import find_scheme
from topcli.sweeps.batch import Measuring
from topcli.sweeps.measures import (
    MEASURES,
    MeasureMisfitError,
    measure,
    measures_of_form,
    names_of,
    resolve_measures,
)
from topcli.tops import TOPS
from topcli.tops.euler import Euler
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski

HK = find_scheme("hk", "kowalevski")


EULER_HK = find_scheme("hk", "euler")


def names(found: Sequence[Any]) -> list[str]:
    return [one.name for one in found]


def broken_field(y: Floats, p: Floats) -> Floats:
    """No polynomial."""
    return (abs(y[0]), *Heavy.field(y, p)[1:])


class Broken(Top):
    """Nearly a heavy top, but with a field that is not a polynomial."""

    kind: ClassVar[str] = "broken"
    form: ClassVar[str] = "broken"
    components = Heavy.components
    vectors = Heavy.vectors
    field: ClassVar = staticmethod(broken_field)

    def constants(self) -> Floats:
        return Heavy().constants()

    def invariants(self) -> tuple[Invariant, ...]:
        return Heavy().invariants()


@pytest.mark.usefixtures("own_registry")
def test_what_does_not_fit_is_named_with_the_reason() -> None:
    TOPS["broken"] = Broken
    top, scheme = Broken(), find_scheme("rk4", "heavy")
    for name in ("max_error", "final_error"):
        with pytest.raises(
            MeasureMisfitError, match="the reference needs a polynomial field, but this one makes a decision"
        ):
            resolve_measures([name], top, scheme)
    with pytest.raises(MeasureMisfitError, match="top 'heavy' under scheme 'rk4' has no counter"):
        resolve_measures(["counter.iterations"], Heavy(), scheme)
    assert names(resolve_measures(["drift.energy", "reversal_defect"], top, scheme)) == [
        "drift.energy",
        "reversal_defect",
    ]
    assert "max_error" not in set(names_of(top, scheme))


@pytest.mark.slow
def test_every_measure_that_is_listed_for_a_top_can_be_resolved_and_evaluated() -> None:
    for form, scene in (("kowalevski", "kowalevski_hk"), ("euler", "euler_hk"), ("lagrange", "lagrange_hk")):
        overrides = ["h=0.1", "N=4000"]  # some oscillations, so that all have frequencies
        if form != "euler":  # far from a separatrix, so that there is a verdict
            overrides.append("initial.gamma=[0.6, 0.48, 0.64]")
        experiment = load_experiment(scene, overrides)
        fitting = names_of(experiment.top, experiment.scheme)
        assert set(fitting) <= set(names(measures_of_form(form)))
        found = measured(experiment, fitting)
        assert list(found) == fitting
        missing = [name for name, values in found.items() if not np.isfinite(values[0])]
        assert set(missing) <= {"median_swing_spacing", "first_swing_spacing"}


def test_names_of_a_plugin_are_checked(own_registry: None) -> None:
    with pytest.raises(ValueError, match="'seconds' is already registered by topcli"):
        measure("seconds", summary="again")
    for taken in ("row", "outcome", "cpu", "h", "T", "top.c0", "initial.NAME", "scheme.tol", "sample"):
        with pytest.raises(ValueError, match="a column of the results has this name already"):
            measure(taken, summary="clash")
    with pytest.raises(ValueError, match="no spaces"):
        measure("two words", summary="odd")
    with pytest.raises(ValueError, match="a family, and no other measure"):
        measure("odd.NAME", summary="odd")
    with pytest.raises(ValueError, match="a family, and no other measure"):
        measure("odd", summary="odd", names=lambda top, scheme, options: ["a"])
    measure("odd", summary="odd", needs=["gamma7"])(lambda batch: None)
    with pytest.raises(MeasureMisfitError, match="it needs 'gamma7', which top 'kowalevski' under scheme 'hk'"):
        resolve_measures(["odd"], Kowalevski(), HK)


FILE = """
import topcli

@topcli.measure("omega1.top", summary="largest omega1", unit="rate", needs=["omega1"])
def largest(batch):
    return batch.columns["omega1"].max(axis=1)

@topcli.measure("last.NAME", summary="last value of NAME", needs=["states"], noun="component",
                names=lambda top, scheme, options: top.components)
def last(batch, name):
    return batch.states[:, -1, batch.experiment.top.components.index(name)]
"""


def load(path: Path) -> None:
    load_plugin_file(path)


def test_measures_from_a_file(tmp_path: Path, own_registry: None) -> None:
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    load(path)
    assert MEASURES["omega1.top"].origin == str(path)
    experiment = load_experiment("kowalevski_hk", ["N=200", "h=0.01"])
    found = measured(experiment, ["omega1.top", "last.gamma2", "last.omega3"])
    assert found["omega1.top"][0] == max(found.batch.states[0, :, 0])
    assert (found["last.gamma2"][0], found["last.omega3"][0]) == tuple(found.batch.last[0, [4, 2]])
    with pytest.raises(UsageError, match="has no component 'gamma4'; did you mean 'gamma"):
        resolve_measures(["last.gamma4"], experiment.top, experiment.scheme)


def free(scheme: str, h: float, N: int, **top: float) -> Experiment:
    kind = {"kind": "euler", "A": 3.0, "B": 2.0, "C": 1.0, **top}
    return load_experiment({"top": kind, "initial": {"omega": [0.3, 0.4, 1.5]}, "scheme": scheme, "h": h, "N": N})


def shared(monkeypatch: pytest.MonkeyPatch, max_bytes: int = 1 << 20) -> SharedReferences:
    found = SharedReferences(max_bytes)
    monkeypatch.setattr("topcli.runs.references.REFERENCES", found)
    return found


def max_error(experiment: Experiment) -> float:
    return float(measured(experiment, ["max_error", "final_error"])["max_error"][0])


def kowalevski(scheme: str, h: float, N: int) -> Experiment:
    return load_experiment("kowalevski_hk", [f"scheme={scheme}", f"h={h!r}", f"N={N}"])


@pytest.mark.slow
def test_a_reference_is_computed_once_for_all_schemes(monkeypatch: pytest.MonkeyPatch) -> None:
    found = shared(monkeypatch)
    alone = [max_error(kowalevski(scheme, 0.125, 80)) for scheme in ("rk4", "hk", "rk2")]
    assert len(found._states) == 1
    max_error(kowalevski("hk", 0.0625, 160))
    assert len(found._states) == 2
    for scheme, error in zip(("rk4", "hk", "rk2"), alone, strict=True):
        shared(monkeypatch)
        assert max_error(kowalevski(scheme, 0.125, 80)) == error


@pytest.mark.slow
def test_another_top_state_or_direction_has_another_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    found = shared(monkeypatch)
    errors = {
        max_error(free("rk4", 0.125, 80)),
        max_error(free("rk4", 0.125, 80, B=2.5)),
        max_error(free("rk4", -0.125, 80)),
        max_error(free("rk4", 0.25, 40)),
    }
    assert len(errors) == 4
    assert len(found._states) == 4


def test_the_references_that_are_kept_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    each = 81 * (1 + 6) * 8
    found = shared(monkeypatch, 2 * each)
    scene = ["N=80", "h=0.125"]
    first, second, third = (
        load_experiment("kowalevski_hk", [*scene, f"initial.omega=[{omega}, 0, 0]"]) for omega in (1.0, 1.1, 1.2)
    )
    errors = [max_error(experiment) for experiment in (first, second, first, third)]
    assert found._bytes <= 2 * each
    assert max_error(first) == errors[0]
    too_small = shared(monkeypatch, 55)
    assert max_error(first) == errors[0]
    assert too_small._bytes == 0


def test_a_motion_that_cannot_be_followed_is_named_and_spoils_only_its_error(monkeypatch: pytest.MonkeyPatch) -> None:
    shared(monkeypatch)
    experiment = load_experiment("kowalevski_hk", ["N=20", "h=1e7"])
    states = [experiment.y0, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0)]
    found = measured(experiment, ["max_error", "final_error", "steps"], states)
    assert np.isnan(found["max_error"]).all()
    assert {run for run, _, _ in found.faults} == set(np.flatnonzero(found.batch.whole).tolist())
    assert all(reason.startswith("the reference would need at least ") for _, _, reason in found.faults)
    assert found["steps"][1] == 20.0


def test_too_many_rows_for_the_memory_are_refused_with_a_way_out() -> None:
    experiment = load_experiment("kowalevski_hk", ["N=1e9", "h=1e-3"])
    measures = resolve_measures(["swings", "max_error"], experiment.top, experiment.scheme)
    with pytest.raises(UsageError) as caught:
        measured(experiment, ["swings", "max_error"])
    assert str(caught.value) == (
        "output.every: 1000000001 recorded rows do not fit in memory for swings, max_error; "
        "record fewer with output.every: 34 or more"
    )
    sparse = load_experiment("kowalevski_hk", ["N=1e9", "h=1e-3", "output.every=34"])
    assert Measuring(sparse, measures).size == 1


def test_a_closed_form_serves_only_its_own_tops() -> None:
    assert reference_of(Kowalevski(), judged=HK).closed_form is None
    assert reference_of(Euler(A=3.0, B=2.0, C=1.0), judged=EULER_HK).closed_form is not None
    exact: Scheme = find_scheme("exact", "euler")
    assert reference_of(Euler(A=3.0, B=2.0, C=1.0), judged=exact).closed_form is None
    assert 0.0 < max_error(free("exact", 0.1, 100)) < 1e-13
