"""The tops: their registry, constants and invariants, their parameters in configs, and what they warn of."""

from __future__ import annotations

import pytest

from declared import Heavy
from topcli.contracts import Top
from topcli.errors import UsageError
from topcli.runs.simulate import simulate
from topcli.tops import BUILT_IN, CATALOGUE, TOPS, Tops, kind_of, top_names
from topcli.tops.bodies import moment_warnings
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.lagrange import Lagrange


def test_built_in_forms_and_kinds_are_those_of_their_classes() -> None:
    for form in BUILT_IN:
        fresh = Tops(BUILT_IN)
        assert (fresh[form].form, fresh[form].kind) == (form, kind_of(form))
    bodies = ["kowalevski", "euler", "euler+gamma", "lagrange", "lagrange/inertial", "heavy"]
    assert top_names() == [*bodies, *CATALOGUE, "custom"]


@pytest.mark.parametrize("form", BUILT_IN)
def test_the_constants_of_a_step_are_what_the_registry_says(form: str) -> None:
    """Each text, evaluated by Python with the parameters of the top, against the number that steps get."""
    numbers = [name for name, field in TOPS[form].model_fields.items() if field.annotation is float]
    parameters = {name: 1.7 - 0.35 * i for i, name in enumerate(numbers)}
    top = TOPS[form](**parameters)
    known = {**parameters, "C": parameters.get("C", parameters.get("A", 0.0) / 2)}
    said = [eval(text.partition(" = ")[2] or text, {}, known) for text in top.step_constants]
    assert said == pytest.approx(top.constants(), rel=1e-15)
    assert len(said) == len(top.constants()) > 0


# parameters


@pytest.mark.parametrize(
    ("moments", "named"),
    [
        ((1.0, 1.0, 2.0), ""),
        ((0.1, 0.7, 0.8), ""),  # a flat body, although 0.1 + 0.7 < 0.8 in doubles
        ((0.1, 0.7, 0.8 * (1.0 + 0.9e-12)), ""),
        ((0.1, 0.7, 0.8 * (1.0 + 1.1e-12)), "C"),
        ((1.0, 3.1, 2.0), "B"),
        ((9.0, 1, 2), "A"),
    ],
)
@pytest.mark.parametrize("top", [Heavy, Euler, EulerGamma])
def test_impossible_moments_are_warned_of(top: type[Top], moments, named: str) -> None:
    A, B, C = moments
    found = moment_warnings(top(A=A, B=B, C=C))
    assert len(found) == bool(named)
    for line in found:
        assert f"{named} = {max(moments):g} >" in line


def test_unequal_moments_are_refused_and_heavy_is_offered() -> None:
    base = {"initial": {"omega": [1, 0, 0], "gamma": [0, 0, 1]}, "scheme": "hk", "h": 0.1, "N": 10}
    with pytest.raises(UsageError, match=r"B: must equal A = 1\.0 .* not 2\.0.*heavy"):
        simulate(top={"kind": "lagrange", "A": 1.0, "B": 2.0}, **base)
    assert Lagrange(A=3.0).B == 3.0
    assert Lagrange(A=1.0, B=1.0) == Lagrange(A=1.0)
    assert "triangle" in moment_warnings(Lagrange(C=2.5))[0]
    assert moment_warnings(Lagrange(C=2.0)) == []
