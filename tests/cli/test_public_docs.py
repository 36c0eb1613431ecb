"""The documentation of the Python interface: complete sections, and examples that give what they show."""

from __future__ import annotations

import doctest
import inspect

import pytest

import topcli


@pytest.mark.parametrize("name", ["compare", "order", "run", "simulate", "simulate_ensemble", "stress", "sweep"])
def test_public_functions_document_every_parameter_and_their_example_runs(name: str) -> None:
    function = getattr(topcli, name)
    text = inspect.getdoc(function) or ""
    for section in ("Parameters", "Returns", "Raises", "Examples"):
        assert f"\n{section}\n{'-' * len(section)}\n" in text
    for parameter in inspect.signature(function).parameters.values():
        stars = {parameter.VAR_KEYWORD: "**", parameter.VAR_POSITIONAL: "*"}.get(parameter.kind, "")
        assert f"\n{stars}{parameter.name}" in text
    globs = {"__name__": "__main__"}
    (example,) = doctest.DocTestFinder(recurse=False).find(function, name, globs=globs)
    result = doctest.DocTestRunner(optionflags=doctest.FAIL_FAST).run(example)
    assert result.attempted > 3
    assert not result.failed
