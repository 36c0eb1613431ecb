"""The registry of the tops: names known without import, classes imported when needed."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from conftest import ROOT
from topcli.tops import BUILT_IN, TOPS, Tops, top_names


def test_built_in_forms_and_kinds_are_those_of_their_classes() -> None:
    for form in BUILT_IN:
        fresh = Tops(BUILT_IN)
        kind = fresh.kind(form)
        assert (fresh[form].form, fresh[form].kind) == (form, kind)
        assert fresh.kind(form) == kind
    assert top_names() == ["kowalevski", "euler", "euler+gamma", "lagrange", "lagrange/inertial", "heavy"]


def test_a_top_can_be_added_replaced_and_removed() -> None:
    tops = Tops(BUILT_IN)
    tops["odd"] = TOPS["heavy"]
    assert (tops["odd"], tops.kind("odd"), len(tops)) == (TOPS["heavy"], "heavy", len(BUILT_IN) + 1)
    del tops["odd"]
    assert list(tops) == list(BUILT_IN)
    with pytest.raises(KeyError):
        tops["odd"]


UNLIKE_DEFAULTS = {
    "kowalevski": {"c0": -0.7, "A": 3.1},
    "euler": {"A": 3.3, "B": 2.1, "C": 0.9},
    "euler+gamma": {"A": 3.3, "B": 2.1, "C": 0.9},
    "lagrange": {"A": 1.7, "C": 0.3, "mu": 1.3},
    "lagrange/inertial": {},
    "heavy": {"A": 2.3, "B": 1.9, "C": 0.8, "x0": 0.3, "y0": -0.4, "z0": 1.1},
}


@pytest.mark.parametrize("form", BUILT_IN)
def test_the_constants_of_a_step_are_what_the_registry_says(form: str) -> None:
    """Each text, evaluated by Python with the parameters of the top, against the number that steps get."""
    parameters = UNLIKE_DEFAULTS[form]
    top = TOPS[form](**parameters)
    known = {**parameters, "C": parameters.get("C", parameters.get("A", 0.0) / 2)}
    said = [eval(text.partition(" = ")[2] or text, {}, known) for text in top.step_constants]
    assert said == pytest.approx(top.constants(), rel=1e-15)
    assert len(said) == len(top.constants()) > 0


def test_an_author_of_a_step_is_told_what_p_contains(cli: Callable[..., Any]) -> None:
    tops = {item["form"]: item["step_p"] for item in cli("list", "tops", "--json").json()["tops"]}
    assert tops["kowalevski"] == ["c = c0/C"]
    for form, constants in tops.items():
        assert ", ".join(constants) in cli("list", "tops").out, form
    assert "constants p of a step: c = c0/C" in cli("show", "hybrid").out.splitlines()
    rows = re.findall(r"^\| `(\w+)` \| (`.*) \|$", (ROOT / "docs" / "tops.md").read_text(), re.MULTILINE)
    for form in ("kowalevski", "euler", "lagrange", "heavy"):
        (cells,) = [row for name, row in rows if name == form and row.startswith(f"`{tops[form][0]}`")]
        assert all(f"`{constant}`" in cells for constant in tops[form]), form


def test_loading_a_scene_imports_only_what_it_names() -> None:
    code = (
        "import sys; from topcli.config.load import load_experiment; load_experiment('kowalevski_hybrid');"
        "print(*(name for name in sys.modules if name.startswith(('topcli.tops.', 'topcli.config.'))))"
    )
    found = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert {name for name in found if name.startswith("topcli.tops.")} == {"topcli.tops.kowalevski"}
    assert "topcli.config.ensemble" not in found
    assert "topcli.config.text" in found
