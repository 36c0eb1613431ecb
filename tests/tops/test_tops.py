"""The registry of the tops: names known without import, classes imported when needed."""

from __future__ import annotations

import subprocess
import sys

import pytest

from topcli.tops import BUILT_IN, TOPS, Tops, top_names


def test_built_in_forms_and_kinds_are_those_of_their_classes() -> None:
    for form in BUILT_IN:
        fresh = Tops()
        kind = fresh.kind(form)
        assert (fresh[form].form, fresh[form].kind) == (form, kind)
        assert fresh.kind(form) == kind
    assert top_names() == ["kowalevski", "euler", "euler+gamma", "lagrange", "lagrange/inertial", "heavy"]


def test_a_top_can_be_added_replaced_and_removed() -> None:
    tops = Tops()
    tops["odd"] = TOPS["heavy"]
    assert (tops["odd"], tops.kind("odd"), len(tops)) == (TOPS["heavy"], "heavy", len(BUILT_IN) + 1)
    del tops["odd"]
    assert list(tops) == list(BUILT_IN)
    with pytest.raises(KeyError):
        tops["odd"]


def test_loading_a_scene_imports_only_what_it_names() -> None:
    code = (
        "import sys; from topcli.config.load import load_experiment; load_experiment('kowalevski_hybrid');"
        "print(*(name for name in sys.modules if name.startswith(('topcli.tops.', 'topcli.config.'))))"
    )
    found = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert [name for name in found if name.startswith("topcli.tops.")] == ["topcli.tops.kowalevski"]
    assert not {"topcli.config.toml_text", "topcli.config.ensemble", "topcli.config.members"} & set(found)
    assert "topcli.config.yaml_text" in found
