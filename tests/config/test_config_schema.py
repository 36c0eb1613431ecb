"""The JSON Schema of a config and the starter config."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from config_texts import CONFIGS, FILES, write
from topcli.config.load import load_experiment
from topcli.config.schema import config_schema, starter_config
from topcli.config.text import parse_yaml
from topcli.errors import TopcliError, UnknownNameError
from topcli.schemes import registry


@pytest.mark.parametrize("scheme", registry.names_for("kowalevski"))
def test_starter_config_loads(tmp_path: Path, scheme: str) -> None:
    text = starter_config("kowalevski", scheme, schema="schemas/top.json")
    assert text.startswith("# yaml-language-server: $schema=schemas/top.json\n")
    started = load_experiment(write(tmp_path, text))
    paper = load_experiment(CONFIGS / f"kowalevski_{scheme.replace('-', '_')}.yaml")
    assert started == paper
    for key, value in started.resolved()["scheme"].items():
        assert f"  # {key}: " in text if value is None else f"  {key}: " in text


def test_starter_config_refuses_unknown_names() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'hybrid'"):
        starter_config("kowalevski", "hybird")
    with pytest.raises(UnknownNameError, match="did you mean 'kowalevski'"):
        starter_config("kowalewski")


def fits(schema: Any, value: Any, root: Any = None) -> bool:
    """True if ``value`` satisfies ``schema``, for the keywords that the config's schema uses."""
    root = root or schema
    checks = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}

    def of_type(name: str) -> bool:
        if name in ("number", "integer"):
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            return number and (name == "number" or float(value).is_integer())
        return isinstance(value, checks[name])

    def keyword(name: str, limit: Any) -> bool:
        match name:
            case "type":
                return any(of_type(kind) for kind in ([limit] if isinstance(limit, str) else limit))
            case "const":
                return value == limit and isinstance(value, bool) == isinstance(limit, bool)
            case "enum":
                return value in limit
            case "not":
                return not fits(limit, value, root)
            case "anyOf":
                return any(fits(inner, value, root) for inner in limit)
            case "oneOf":
                return sum(fits(inner, value, root) for inner in limit) == 1
            case "allOf":
                return all(fits(inner, value, root) for inner in limit)
            case "if":
                return not fits(limit, value, root) or fits(schema["then"], value, root)
            case "properties" if isinstance(value, dict):
                return all(fits(limit[key], item, root) for key, item in value.items() if key in limit)
            case "required" if isinstance(value, dict):
                return all(key in value for key in limit)
            case "additionalProperties" if isinstance(value, dict):
                return limit is not False or value.keys() <= schema["properties"].keys()
            case "items" if isinstance(value, list):
                return all(fits(limit, item, root) for item in value)
            case "minItems" | "maxItems" if isinstance(value, list):
                return len(value) >= limit if name == "minItems" else len(value) <= limit
            case "uniqueItems" if isinstance(value, list):
                return len(set(map(repr, value))) == len(value)
            case "minimum" if isinstance(value, (int, float)):
                return value >= limit
            case "maximum" if isinstance(value, (int, float)):
                return value <= limit
            case "exclusiveMinimum" if isinstance(value, (int, float)):
                return value > limit
            case "maxLength" if isinstance(value, str):
                return len(value) <= limit
            case "pattern" if isinstance(value, str):
                return re.search(limit, value) is not None
            case _:
                known = {"$schema", "title", "description", "default", "then", "properties", "required"}
                known |= {"additionalProperties", "items", "minItems", "maxItems", "uniqueItems", "minimum"}
                known |= {"maximum", "exclusiveMinimum", "maxLength", "pattern"}
                assert name in known, name
                return True

    return all(keyword(name, limit) for name, limit in schema.items())


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_schema_accepts(path: Path) -> None:
    schema = config_schema()
    assert schema["$schema"].endswith("2020-12/schema")
    assert fits(schema, load_experiment(path).resolved())
    assert fits(schema, parse_yaml(starter_config(), "starter")[0])
    timed = {key: value for key, value in load_experiment(path).resolved().items() if key != "N"}
    assert not fits(schema, timed)
    assert fits(schema, timed | {"T": 0.5})
    assert not fits(schema, timed | {"T": 0})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("h", 0),
        ("h", "0.1"),
        ("N", 0),
        ("N", 2.5),
        ("T", 50),
        ("top.c_0", 1),
        ("top.A", 0),
        ("top.kind", "x"),
        ("scheme", "x"),
        ("scheme.name", "x"),
        ("scheme.branch", "x"),
        ("scheme.chart", "single"),
        ("initial.omga", [1, 2, 3]),
        ("initial.omega", ["auto", 1, 2]),
        ("initial.gamma", [0, 1]),
        ("output.format", "x"),
        ("output.columns", ["gama1"]),
        ("output.columns", []),
        ("output.columns", ["t", "t"]),
        ("name", "a/b"),
        ("name", ""),
        ("foo", 1),
    ],
)
def test_schema_refuses_what_the_loader_refuses(key: str, value: object) -> None:
    data = load_experiment(CONFIGS / "kowalevski_hybrid.yaml").resolved()
    section = data
    for part in key.split(".")[:-1]:
        section = section[part]
    section[key.split(".")[-1]] = value
    assert not fits(config_schema(), data)
    with pytest.raises(TopcliError):
        load_experiment(data)


def test_schema_describes_every_key() -> None:
    schema = config_schema()
    assert all(section.get("description") for section in schema["properties"].values())
    then = schema["allOf"][0]["then"]["properties"]
    parameters = then["top"]["anyOf"][1]["properties"]
    assert all(parameters[key]["description"] for key in ("c0", "A"))
