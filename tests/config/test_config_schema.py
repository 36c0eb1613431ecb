"""The JSON Schema of a config."""

from __future__ import annotations

from functools import cache

import pytest

from config_texts import FILES, PLAIN
from json_schema import fits
from topcli.config.load import load, load_experiment
from topcli.config.schema import config_schema
from topcli.config.text import parse_yaml
from topcli.errors import TopcliError

schema_of_configs = cache(config_schema)


@pytest.mark.slow
def test_schema_accepts_the_packaged_scenes() -> None:
    schema = schema_of_configs()
    assert schema["$schema"].endswith("2020-12/schema")
    assert all(section.get("description") for section in schema["properties"].values())
    for path in FILES:
        resolved = load_experiment(path).resolved()
        assert fits(schema, resolved), path
        timed = {key: value for key, value in resolved.items() if key != "N"}
        assert [fits(schema, timed | more) for more in ({}, {"T": 0.5})] == [False, True]


CUSTOM = "{kind: custom, components: [x], field: {x: k*x}, parameters: {k: 1}, invariants: {i: {value: x, on: {i: 0}}}"
ACCEPTED = f"""
scheme: hk+suzuki4
scheme: {{name: hk, compose: suzuki4, project: 2}}
initial: {{from: one, normalize: true}}
ensemble: {{random: {{count: 3, gamma: {{near: 0.1}}, omega: {{energy: 4.0}}}}, store: final}}
ensemble: {{grid: {{omega1: [1.0], top.c0: {{from: 0.0, to: 1.0, count: 2}}}}}}
top: {CUSTOM}, k: 0.5}}
"""
REFUSED = f"""
h: '0.1'
N: 0
N: 2.5
T: 50
top: {{kind: kowalevski, c_0: 1}}
top: {{kind: kowalevski, A: 0}}
top: {{kind: x}}
scheme: {{name: hybrid, branch: x}}
output: {{columns: []}}
foo: 1
ensemble: {{randm: {{}}}}
top: {CUSTOM}, k: x}}
top: {{kind: custom, field: 0}}
"""


@pytest.mark.slow
@pytest.mark.parametrize("text", [*REFUSED.strip().splitlines(), *ACCEPTED.strip().splitlines()])
def test_schema_judges_as_the_loader(text: str) -> None:
    data = PLAIN | parse_yaml(text, "x")[0]
    assert fits(schema_of_configs(), data) == (text in ACCEPTED)
    if text in REFUSED:
        with pytest.raises(TopcliError):
            load(data)
