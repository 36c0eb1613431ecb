"""Output to the terminal: no control characters, no markup, no long messages, one style of errors."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cases import cases_of
from conftest import ROOT
from sweep_rows import write_rows
from topcli.errors import (
    MESSAGE_LENGTH,
    TopcliError,
    UsageError,
    clipped,
    printable,
    quoted,
    shortened,
)

CONFIGS = ROOT / "configs"
HK = str(CONFIGS / "kowalevski_hk.yaml")
EVIL = "\x1b]0;own\x07\x1b[31m\u202egnp\x9b2J\x7f\n\r\tx[link=http://evil]y[/link]:boom:\udcff"
"""ESC, BEL, bidi, C1, DEL, line ends, rich's markup and half of a surrogate pair."""
NAME = EVIL.replace("/", "|").replace("\udcff", "")
LONG = "x" * 100_000


def assert_safe(*texts: str) -> None:
    for text in texts:
        assert all(line.isprintable() for line in text.split("\n")), repr(text)


@pytest.mark.slow
@given(st.text())
def test_printable_text_has_no_control_characters(text: str) -> None:
    assert printable(text).isprintable()
    if text.isprintable():
        assert printable(text) == text


def test_printable_shows_what_it_replaces() -> None:
    assert printable("a\x1b[0m\n\x9b\u202e\u200bγ²") == r"a\x1b[0m\n\x9b\u202e\u200bγ²"
    assert quoted("x" * 100) == "'" + "x" * 57 + "...'"
    assert shortened("x" * 60) == "x" * 60
    assert clipped("a" * 50 + "b" * 50, 25) == "a" * 10 + " ... " + "b" * 10


def test_an_error_is_printable_and_bounded_and_keeps_its_lines() -> None:
    error = UsageError("one\ntwo\x1b", "three")
    assert str(error) == "one\\ntwo\\x1b\nthree"
    assert error.lines == ("one\\ntwo\\x1b", "three")
    for count in (1, 2, 3):
        assert len(str(TopcliError(*["a" * 5000 + "the end"] * count))) <= MESSAGE_LENGTH
    assert str(TopcliError("a" * 5000 + "the end")).endswith("the end")
    assert str(TopcliError()) == ""


ATTACKS = """
EVIL
run kowalevski_hk --set scheme=EVIL
run kowalevski_hk --set output.columns=['NAME']
run kowalevski_hk --out file/NAME
    500
run --EVIL
compare EVIL hk
plot EVIL
table NAME
    500
table swept --rows EVIL --value max_error
claims EVIL
"""
"""Commands, and below some of them how much of a name they repeat, which are paths."""


@pytest.mark.slow
@pytest.mark.parametrize(("command", "most"), cases_of(ATTACKS))
def test_no_argument_reaches_the_terminal_raw_or_at_length(cli, in_tmp: Path, command: str, most: list[str]) -> None:
    """Names are repeated to 60 characters; paths, and what typer repeats, are cut in the middle."""
    (in_tmp / "file").write_text("")
    write_rows(in_tmp / "swept", {"h": [0.1]}, {"max_error": [1.0]})
    for evil, name in ((EVIL, NAME), (LONG, LONG)):
        said = cli(*(word.replace("EVIL", evil).replace("NAME", name) for word in command.split()))
        assert (said.code, said.out) == (2, "")
        assert said.err.startswith("error: ")
        assert_safe(said.err)
        assert len(said.err) < 1000
        limit = int(most[0]) if most else 240 if "(see topcli" in said.err else 60
        assert max(map(len, re.findall("x+", said.err)), default=0) <= limit


def test_nothing_given_prints_the_help(cli) -> None:
    said = cli()
    assert said.code == 2
    assert "Run and compare:" in said.out + said.err


FAULTS = [
    (ZeroDivisionError(EVIL), 70, "bug in topcli"),
    (OSError(13, "Permission denied", "some/folder"), 1, "error: some/folder: permission denied\n"),
    (ImportError("libarrow.so: failed to map segment", name="pyarrow.lib"), 1, "enough memory"),
]


@pytest.mark.parametrize(("fault", "code", "said"), FAULTS, ids=["bug", "file", "package"])
def test_an_exception_is_printed_safely_and_blamed_on_whose_it_is(
    fault: Exception, code: int, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from topcli.__main__ import main

    scope: dict = {"fault": fault}  # the file decides whose bug it is
    ours = ROOT / "src" / "topcli" / "cli" / "app.py"
    exec(compile("def broken():\n    raise fault", str(ours), "exec"), scope)
    monkeypatch.setattr("topcli.cli.app.call", scope["broken"])
    with pytest.raises(SystemExit) as leaving:
        main()
    err = capsys.readouterr().err
    assert leaving.value.code == code
    assert_safe(err)
    assert said in err
    assert ("Traceback" in err) == (code == 70)


# what a new user sees


TOPCLI = [sys.executable, "-m", "topcli"]


@pytest.mark.slow
def test_messages_follow_the_data_in_one_log(tmp_path: Path) -> None:
    """As in topcli ... 2>&1 | tee log, where Python keeps what goes to stdout."""
    command = [*TOPCLI, "compare", "hk", "--set", "N=200", "--save", "hk.json"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=tmp_path, env=environment
    )
    lines = done.stdout.splitlines()
    assert lines[0].startswith("kowalevski_hk")
    assert lines.index("wrote hk.json") > 10
