"""Output to a terminal, a log and a pipe: no control characters, no traceback, lines that fit, one style of errors."""

from __future__ import annotations

import ast
import math
import os
import re
import subprocess
import sys
from decimal import Decimal
from pathlib import Path

import pytest

from conftest import ROOT
from terminal import in_terminal
from topcli.cli.output import table_lines
from topcli.config.files import scene_files
from topcli.errors import ExitCode
from topcli.runs.report import invariant_table
from topcli.table import Cells, plus_minus, rounded_up, two_digits

EVIL = "\x1b]0;own\x07\x1b[31m\u202egnp\x9b2J\x7f\n\r\tx[link=http://evil]y[/link]:boom:"
"""ESC, BEL, bidi, C1, DEL, line ends and rich's markup."""
TOPCLI = [sys.executable, "-m", "topcli"]
CONTROLS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")
MOST_LINES = 12


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        ["NAME"],
        ["run", "kowalevski_hk", "--set", "scheme=NAME"],
        ["run", "kowalevski_hk", "--set", "output.columns=['NAME']"],
        ["run", "--NAME"],
        ["compare", "NAME", "hk"],
        ["plot", "NAME"],
        ["table", "NAME"],
        ["claims", "NAME"],
    ],
)
def test_no_argument_reaches_the_terminal_raw(cli, command: list[str]) -> None:
    for name in (EVIL, "x" * 100_000):
        said = cli(*(word.replace("NAME", name) for word in command))
        assert (said.code, said.out) == (2, "")
        assert said.err.startswith("error: ")
        assert all(line.isprintable() for line in said.err.split("\n"))


FAULTS = [
    (ZeroDivisionError(EVIL), 70, "bug in topcli"),
    (OSError(13, "Permission denied", "some/folder"), 1, "error: some/folder: permission denied\n"),
    (MemoryError(), 1, "error: not enough memory\n"),
    (ImportError("libarrow.so: failed to map segment", name="pyarrow.lib"), 1, "enough memory"),
]


@pytest.mark.parametrize(("fault", "code", "words"), FAULTS, ids=["bug", "file", "memory", "package"])
def test_an_exception_is_printed_safely_and_blamed_on_whose_it_is(
    fault: Exception, code: int, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from topcli.__main__ import main

    scope: dict = {"fault": fault}  # the file decides whose bug it is
    ours = ROOT / "src" / "topcli" / "cli" / "app.py"
    exec(compile("def broken():\n    raise fault", str(ours), "exec"), scope)
    monkeypatch.setattr("topcli.cli.app.call", scope["broken"])
    with pytest.raises(SystemExit) as leaving:
        main()
    err = capsys.readouterr().err
    assert (leaving.value.code, words in err, "Traceback" in err) == (code, True, code == 70)
    assert all(line.isprintable() for line in err.split("\n"))


@pytest.mark.slow
def test_messages_follow_the_data_in_one_log(tmp_path: Path) -> None:
    """As in topcli ... 2>&1 | tee log, where Python keeps what goes to stdout."""
    command = [*TOPCLI, "compare", "hk", "--set", "N=200", "--save", "hk.json"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    lines = subprocess.run(command, **streams, cwd=tmp_path, env=environment).stdout.splitlines()
    assert lines[0].startswith("kowalevski_hk")
    assert lines.index("wrote hk.json") > 10
    assert not {"\x1b", "━"} & set("".join(lines)), "neither colours nor boxes in a pipe"


@pytest.mark.slow
def test_every_packaged_scene_prints_at_most_12_lines_of_80_columns(tmp_path: Path) -> None:
    scenes = list(scene_files())
    code, text = in_terminal([*TOPCLI, "run", *scenes, "--set", "N=24"], tmp_path)
    assert (code, "\x1b[32mexact\x1b[0m" in text) == (0, True)
    lines = [line for line in CONTROLS.sub("", text).splitlines() if "━" not in line]  # without the progress bar
    begins = [i for i, line in enumerate(lines) if re.search(r"\b(completed|all \d+ trajectories)\b", line)]
    assert len(begins) == len(scenes)
    ends = [*begins[1:], len(lines) - 1]  # the last line counts the runs
    for begin, end in zip(begins, ends, strict=True):
        warnings = sum("warning: " in line for line in lines[begin:end])
        titles = 1  # the name, which a single run does not print
        assert end - begin - warnings - titles <= MOST_LINES, lines[begin:end]
    assert max(map(len, lines)) <= 80


def test_a_wide_table_is_printed_in_blocks_that_begin_with_the_keys() -> None:
    lines = table_lines(Cells("", ["name", "one", "two"], [["a", "1" * 9, "2" * 9], ["b", "3", "4"]]), width=18)
    assert lines == ["name        one", "a     111111111", "b             3", "", *[
        "name        two", "a     222222222", "b             4"]]  # fmt: skip
    marked = Cells("", ["k", "v"], [["a", "lost"]], numbers=False, marks={"lost": "bad"})
    coloured = table_lines(marked, rule=True, coloured=True)
    assert coloured == ["k  v", "─" * 7, "a  \x1b[31mlost\x1b[0m"]


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (-8.523e-5, 2.2e-5, "(-8.5 ± 2.2)e-05"),
        (9.99e-5, 3.1e-9, "(9.99000 ± 0.00031)e-05"),
        (0.0999, 0.00996, "0.100 ± 0.010"),
        (12345.6, 3.2, "12345.6 ± 3.2"),
        (3e-9, 2e-7, "(0.0 ± 2.0)e-07"),
        (1.0, 0.0, "1"),
        (1.0, float("inf"), "1"),
    ],
)
def test_a_number_ends_at_the_second_digit_of_its_error(value: float, error: float, text: str) -> None:
    assert plus_minus(value, error) == text
    if "±" in text:  # the printed value is within half a unit of its last digit
        power = Decimal(10) ** int(text.partition(")e")[2] or 0)
        printed, _, spread = text.strip("(").partition(")")[0].partition(" ± ")
        unit = Decimal(1).scaleb(int(Decimal(spread).as_tuple().exponent)) * power
        assert abs(Decimal(printed) * power - Decimal(value)) <= unit * Decimal("0.51")


@pytest.mark.parametrize("value", [0.0, 5e-324, 1e-320, 2.3e-308, 1.234e-7, 1.0, 12.01, 9.99e99, 1.7e308, math.inf])
def test_numbers_are_rounded_up_to_two_digits(value: float) -> None:
    above = rounded_up(value)
    assert invariant_table([{"symbol": "E", "drift_bound": value}]).cells().lines[0][1] == two_digits(above)
    assert value <= above
    if 1e-300 < value < 1e300:
        assert above <= 1.1 * value
        assert float(f"{above:.1e}") == pytest.approx(above, rel=1e-12)


@pytest.mark.slow
def test_only_one_module_prints_and_exit_codes_are_documented_alike() -> None:
    """Text printed past it may hold control characters."""
    for path in sorted((ROOT / "src" / "topcli").rglob("*.py")):
        calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        names = {ast.unparse(call.func) for call in calls if not any(word.arg == "file" for word in call.keywords)}
        assert path.name == "output.py" or not {"print", "typer.echo", "typer.secho"} & names, path
    page = (ROOT / "docs" / "running.md").read_text(encoding="utf-8").split("## Exit codes")[1]
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)] == list(ExitCode)
