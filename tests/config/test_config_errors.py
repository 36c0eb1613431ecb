"""Messages about a wrong config: file, line, key, the mistake and its correction."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from config_texts import BASE, BASE_TOML, refusal, write
from topcli.config.load import load_experiment
from topcli.config.text import key_lines, parse_yaml
from topcli.contracts import Stepper
from topcli.errors import ConfigError, UnknownNameError
from topcli.schemes import registry

GAMMA, OMEGA = "[auto, 0, 1e-3]", "[2, 0, 0]"
WRONG = [
    # what is replaced, by what, the line and the key of the message, what it says
    ("c0: 1", "c_0: 1", 2, "top.c_0", "unknown key; did you mean 'c0'?"),
    ("c0: 1", "c0: '1'", 2, "top.c0", "must be a number, not the text '1'"),
    ("c0: 1", "c0: .nan", 2, "top.c0", "must be a finite number, not nan"),
    ("c0: 1", "A: -2", 2, "top.A", "must be greater than 0"),
    ("kowalevski", "kowalewski", 2, "top.kind", "did you mean 'kowalevski'?"),
    ("{kind: kowalevski, c0: 1}", "kowalewski", 2, "top", "did you mean 'kowalevski'?"),
    ("{kind: kowalevski, c0: 1}", "{c0: 1}", 2, "top", "'kind' is missing; known: "),
    ("{kind: kowalevski, c0: 1}", "3", 2, "top", "must be a name (kowalevski"),
    ("h: 0.001", "h: 0", 7, "h", "must not be zero"),
    ("h: 0.001", "h: .nan", 7, "h", "must be a finite number, not nan"),
    ("h: 0.001", "h: -.inf", 7, "h", "must be a finite number, not -inf"),
    ("h: 0.001", "h: true", 7, "h", "must be a number, not true"),
    ("h: 0.001", "h: '0.001'", 7, "h", "must be a number, not the text '0.001'"),
    ("h: 0.001", "h:", 7, "h", "must be a number, not nothing"),
    ("h: 0.001", "H: 0.001", 7, "H", "unknown key; did you mean 'h'?"),
    ("h: 0.001\n", "", 1, "h", "missing; give the step size"),
    ("h: 0.001\nN: 100", "h: 1e300\nN: 1e12", 8, "N", "is not finite"),
    ("N: 100", "N: 0", 8, "N", "must be at least 1, not 0"),
    ("N: 100", "N: -5", 8, "N", "must be at least 1, not -5"),
    ("N: 100", "N: 2.5", 8, "N", "must be a whole number, not 2.5"),
    ("N: 100", "N: 1e13", 8, "N", "must be at most 1000000000000"),
    ("N: 100", "T: many", 8, "T", "must be a number, not the text 'many'"),
    ("N: 100", "T: 0.0505", 8, "T", "nearest: T = 0.05 (N = 50) or T = 0.051 (N = 51)"),
    ("N: 100", "T: -0.1", 8, "T", "must have the sign of h = 0.001, not -0.1"),
    ("N: 100", "N: many", 8, "N", "must be a whole number, not the text 'many'"),
    ("hk", "hkk", 6, "scheme", "unknown scheme 'hkk'; did you mean 'hk'?"),
    ("hk", "tumbler", 6, "scheme", "scheme 'tumbler' does not fit top 'kowalevski'; it fits euler"),
    ("hk", "{name: hkk}", 6, "scheme.name", "did you mean 'hk'?"),
    ("hk", "{Name: hk}", 6, "scheme", "'Name' should be 'name'"),
    ("hk", "{name: hk, branch: sign}", 6, "scheme.branch", "unknown key"),
    ("hk", "{name: hybrid, brunch: sign}", 6, "scheme.brunch", "did you mean 'branch'?"),
    ("hk", "{name: hybrid, branch: sgn}", 6, "scheme.branch", "must be 'nearest' or 'sign', not the text 'sgn'"),
    ("hk", "[hk]", 6, "scheme", "must be a name (backlund"),
    ("scheme", "shceme", 6, "shceme", "unknown key; did you mean 'scheme'?"),
    (GAMMA, "[1, 0, 1e-3]", 5, "initial.gamma", "gamma² = 1.000001 is off by 1e-06"),
    (GAMMA, "[1, 0, 1e-3]", 5, "initial.gamma", "initial.normalize: true"),
    (GAMMA, "[0, 0, 0]", 5, "initial.gamma", "is off by -1"),
    (GAMMA, "[1e200, 0, 0]", 5, "initial.gamma", "is off by inf"),
    (GAMMA, "[0, 0, 0]\n  normalize: true", 5, "initial.gamma", "zero vector"),
    (GAMMA, "[auto, 0, 1]\n  normalize: 1", 6, "initial.normalize", "must be true or false, not 1"),
    (GAMMA, "[auto, auto, 0]", 5, "initial.gamma", "only one component may be auto"),
    (GAMMA, "[auto, 1, 1]", 5, "initial.gamma", "the squares of the others sum to 2 > 1"),
    (GAMMA, "[0, 1]", 5, "initial.gamma", "a list of 3 numbers (gamma1, gamma2, gamma3), not 2"),
    (GAMMA, "1", 5, "initial.gamma", "a list of 3 numbers"),
    (GAMMA, "[auto, .inf, 0]", 5, "initial.gamma", "gamma2 must be a finite number, not inf"),
    (GAMMA, "[atuo, 0, 0]", 5, "initial.gamma", "gamma1 must be a number, or auto, +auto, -auto"),
    (OMEGA, "[2, .nan, 0]", 4, "initial.omega", "omega2 must be a finite number, not nan"),
    (OMEGA, "[auto, 0, 0]", 4, "initial.omega", "omega1 must be a number, not the text 'auto'"),
    (OMEGA, "[2, true, 0]", 4, "initial.omega", "omega2 must be a number, not true"),
    (OMEGA, f"[{'9' * 350}, 0, 0]", 4, "initial.omega", "omega1 must be a finite number"),
    ("omega:", "omgea:", 4, "initial.omgea", "unknown key; did you mean 'omega'?"),
    (f"  gamma: {GAMMA}\n", "", 3, "initial.gamma", "missing; give (gamma1, gamma2, gamma3); auto completes it"),
    ("format: csv", "format: hdf5", 10, "output.format", "must be 'parquet' or 'csv', not the text 'hdf5'"),
    ("format: csv", "every: 101", 10, "output.every", "must be at most N = 100, not 101"),
    ("format: csv", "every: 0", 10, "output.every", "must be at least 1"),
    ("format: csv", "evry: 1", 10, "output.evry", "did you mean 'every'?"),
    ("format: csv", "columns: []", 10, "output.columns", "at least one column"),
    ("format: csv", "columns: [t, gama1]", 10, "output.columns", "unknown column 'gama1'; did you mean 'gamma1'"),
    ("format: csv", "columns: [t, t]", 10, "output.columns", "names 't' twice"),
    ("format: csv", "columns: t", 10, "output.columns", "must be a list"),
    ("\n  format: csv", " 3", 9, "output", "must be a section with format, every, columns, attitude, digits, not 3"),
    ("name: x", "name: a/b", 1, "name", "path separator"),
    ("name: x", r"name: a\b", 1, "name", "path separator"),
    ("name: x", "name: ''", 1, "name", "must not be empty"),
    ("name: x", "name: '  '", 1, "name", "must not be empty"),
    ("name: x", "name: 'x '", 1, "name", "must not start or end with a space: 'x '"),
    ("name: x", "name: ' x'", 1, "name", "must not start or end with a space: ' x'"),
    ("name: x", "name: 'x\u00a0'", 1, "name", "must not start or end with a space"),
    ("name: x", "name: ..", 1, "name", "must not start with a dot"),
    ("name: x", "name: .x", 1, "name", "must not start with a dot"),
    ("name: x", "name: -x", 1, "name", "must not start with a dot or a dash"),
    ("name: x", r'name: "a\nb"', 1, "name", "control characters"),
    ("name: x", f"name: {'y' * 101}", 1, "name", "at most 100 characters"),
    ("name: x", f"name: {'é' * 100}x", 1, "name", "at most 100 characters"),
    ("name: x", "name: 3", 1, "name", "must be text"),
]


@pytest.fixture
def euler_scheme(own_registry: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scheme that steps another top only."""
    monkeypatch.setitem(registry.TOPS, "euler", registry.TOPS["kowalevski"])

    @registry.scheme(
        "tumbler",
        top="euler",
        title="nothing",
        order=1,
        explicit=True,
        self_adjoint=False,
        citation="none",
        equations="none",
    )
    def _build(top: Any, options: Any) -> Stepper:
        """Stay where you are."""
        return Stepper(lambda y, h, p: y, 3)


@pytest.mark.slow
@pytest.mark.usefixtures("euler_scheme")
@pytest.mark.parametrize(("old", "new", "line", "key", "says"), WRONG)
def test_wrong_value_is_reported_by_line(tmp_path: Path, old: str, new: str, line: int, key: str, says: str) -> None:
    assert BASE.count(old) >= 1
    path = write(tmp_path, BASE.replace(old, new, 1))
    messages = refusal(path).splitlines()
    start = f"{path}:{line}: {key}: "
    assert any(text.startswith(start) and says in text for text in messages), messages


def test_base_config_is_valid(tmp_path: Path) -> None:
    assert load_experiment(write(tmp_path, BASE)).output.format == "csv"
    assert load_experiment(write(tmp_path, BASE_TOML, "good.toml")).output.every == 20


SYNTAX = [
    (BASE + "name: y\n", ":11:1: name: the key is given twice, first on line 1"),
    (BASE.replace("omega:", "gamma:"), ":5:3: initial.gamma: the key is given twice, first on line 4"),
    (BASE.replace("c0: 1", "c0: 1, c0: 2"), ":2:32: top.c0: the key is given twice, first on line 2"),
    (BASE.replace("hk", "!!python/object:os.system x"), ":6:9: YAML: tags such as '!!python/object:os.system' are"),
    (BASE.replace("h: 0.001", "h: !!float 1"), ":7:4: YAML: tags such as '!!float' are"),
    (BASE.replace("h: 0.001", "h: ! 1"), ":7:4: YAML: tags such as '!'"),
    (BASE + "<<: {a: 1}\n", ":11:1: merge keys (<<) are not allowed"),
    (BASE + "a: &a [*a]\n", ":11:8: alias *a is inside its own anchor"),
    (BASE + "a: *b\n", ":11:4: alias *b: no anchor &b"),
    (BASE + "3: a\n", ":11:1: keys are names, not 3"),
    (BASE + "null: a\n", ":11:1: keys are names, not nothing"),
    (BASE + "? [a]\n: 3\n", ":11:3: keys are names, not lists or sections"),
    (BASE + "---\nname: y\n", ":11:1: a second document starts here"),
    (BASE + "\tx: 1\n", ":11:1: YAML: found character '\\t' that cannot start any token; indent with spaces"),
    (BASE + "x: a: b\n", ":11:5: YAML: mapping values are not allowed here"),
    (BASE + "x: [1,\n", ":12:1: YAML: "),
    (BASE + "x: 'a\n", ":12:1: YAML: found unexpected end of stream"),
    (BASE + "x: \x07\n", ":11: YAML: the character U+0007 is not allowed"),
    (BASE.replace("hk", '"\\ud800"'), ":6:9: scheme: the text holds half of a surrogate pair"),
    ("", ": is empty; `topcli init` writes a config"),
    ("# nothing\n\n", ": is empty; `topcli init` writes a config"),
    ("- a\n", ":1: a config is a list of `key: value` lines, not a list"),
    ("a: " + "[" * 1000, ":1:20: nested deeper than 16 levels"),
    ("a: [" + "1," * 6000 + "]", ": more than 5000 values"),
    (b"name: a\0b", ": is a binary file; a config is UTF-8 text"),
    (b"name: x\nh: \xff\xfe", ":2: is not UTF-8 text (byte 0xff)"),
    (b"#" * 1_000_001, ": 1000001 bytes; a config is at most 1000000"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("text", "says"), SYNTAX)
def test_wrong_yaml_is_reported_with_its_line(tmp_path: Path, text: str | bytes, says: str) -> None:
    path = write(tmp_path, text)
    message = refusal(path)
    assert message.startswith(str(path))
    assert message[len(str(path)) :].startswith(says) or (not says.startswith(":1") and says in message)


def test_alias_bomb_is_refused(tmp_path: Path) -> None:
    def tower(levels: int) -> str:
        rows = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
        rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, levels)]
        return "\n".join(rows) + "\n"

    data, _ = parse_yaml(tower(3), "bomb")
    assert data["a2"] == [[[1] * 9] * 9] * 9
    with pytest.raises(ConfigError, match=r"bomb:4:\d+: more than 5000 values \(aliases expanded\)"):
        parse_yaml(tower(10), "bomb")
    deep = "a0: &a0 [1]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 30))
    with pytest.raises(ConfigError, match="nested deeper than 16 levels"):
        parse_yaml(deep, "bomb")
    path = write(tmp_path, BASE.replace("[2, 0, 0]", "&w [2, 0, 0]").replace(GAMMA, "*w\n  normalize: true"))
    assert load_experiment(path).y0 == (2.0, 0.0, 0.0, 1.0, 0.0, 0.0)


TOML = [
    ("c0 = 1.0", "c_0 = 1.0", ":6: top.c_0: unknown key; did you mean 'c0'?"),
    ('kind = "kowalevski"\nc0', '"kind" = "kowalevski"\nc_0', ":6: top.c_0: unknown key"),
    ("every = 20", "every = 2000", ":12: output.every: must be at most N = 100, not 2000"),
    ("0.001", "nan", ":2: h: must be a finite number, not nan"),
    ("0.001", "2025-02-03", ":2: h: must be a number, text, list or section, not a date"),
    ("0.001", f"0x{'f' * 3000}", ":2: h: an integer of more than 1024 bits"),
    ("0.001", "1" * 5000, ": TOML: a number has too many digits"),
    ("N = 100", "N 100", ":3:3: TOML: Expected '=' after a key"),
    ("[output]\n", "[top]\n", ":11:5: TOML: Cannot declare ('top',) twice"),
    ("every = 20\n", "every = 20\nevery = 3\n", ":13:10: TOML: Cannot overwrite a value; is a key given twice?"),
    ('gamma = ["auto", 0, 1e-3]', "gamma = [1, 1, 1]", ":10: initial.gamma: must be a unit vector"),
    ("N = 100", "a" + ".a" * 100_000 + " = 1", ":3: TOML: a key of more than 16 parts"),
    ("N = 100", "N = " + "[" * 100_000, ": TOML: nested too deeply"),
    (BASE_TOML, "", ": is empty"),
]


@pytest.mark.parametrize(("old", "new", "says"), TOML)
def test_wrong_toml_is_reported_with_its_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert BASE_TOML.count(old) == 1
    path = write(tmp_path, BASE_TOML.replace(old, new), "bad.toml")
    message = refusal(path)
    assert message.startswith(f"{path}{says}")


def test_toml_key_lines() -> None:
    text = 'a.b = """\nx = 1\n"""\nc = {d = [1,\n2], e = "]"}\n[[f."g h"]]\ni = \'#\' # j = 1\n\n  [k]\nl=[\n]\nm=1'
    lines = key_lines(text)
    assert lines[("a",)] == lines[("a", "b")] == 1
    assert lines[("c",)] == 4
    assert lines[("f", "g h")] == 6
    assert lines[("f", "g h", "i")] == 7
    assert lines[("k", "l")] == 10
    assert lines[("k", "m")] == 12
    assert ("x",) not in lines
    assert not any("j" in path for path in lines)


def test_several_mistakes_are_reported_at_once(tmp_path: Path) -> None:
    text = BASE.replace("h: 0.001", "h: 0").replace("c0", "c_0").replace("hk", "hkk").replace("100", "0")
    messages = refusal(write(tmp_path, text)).splitlines()
    assert len(messages) == 3
    assert messages[2].endswith("(and 1 more)")
    assert {line.split(": ")[1] for line in messages} == {"h", "N", "top.c_0"}


def test_wrong_type_names_the_expected_type(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError):
        load_experiment(write(tmp_path, BASE.replace("hk", "hkk")))
    with pytest.raises(ConfigError):
        load_experiment(write(tmp_path, BASE.replace("hk", "hkk").replace("100", "0")))


def test_unreadable_config_files_are_refused(tmp_path: Path) -> None:
    write(tmp_path, BASE, "wobble.yaml")
    (tmp_path / "folder.yaml").mkdir()
    assert refusal(tmp_path / "woble.yaml") == f"{tmp_path}/woble.yaml: no such file; did you mean 'wobble.yaml'?"
    assert refusal(tmp_path / "q.yaml").endswith("q.yaml: no such file; configs there: folder.yaml, wobble.yaml")
    assert "nor is there a folder" in refusal(tmp_path / "no" / "x.yaml")
    assert "is a folder" in refusal(tmp_path / "folder.yaml")
    assert "ends in .yaml, .yml or .toml" in refusal(tmp_path / "x.txt")
    assert "ends in .yaml, .yml or .toml" in refusal(str(tmp_path / "x"))
    assert "cannot be read" in refusal("a\0.yaml")
    assert "cannot be read: File name too long" in refusal("y" * 300 + ".yaml")
    crlf = write(tmp_path, b"\xef\xbb\xbf" + BASE.replace("\n", "\r\n").encode(), "crlf.yaml")
    assert load_experiment(crlf) == load_experiment(tmp_path / "wobble.yaml")
