"""Output to the terminal: no control characters, no markup, no long messages, one style of errors."""

from __future__ import annotations

import ast
import json
import os
import re
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from config_texts import BASE, refusal, write
from conftest import ROOT
from topcli.errors import MESSAGE_LENGTH, TopcliError, UsageError, clipped, printable, quoted, shortened

CONFIGS = ROOT / "configs"
HK = str(CONFIGS / "kowalevski_hk.yaml")
EVIL = "\x1b]0;own\x07\x1b[31m\u202egnp\x9b2J\x7f\n\r\tx[link=http://evil]y[/link]:boom:\udcff"
"""ESC, BEL, bidi, C1, DEL, line ends, rich's markup and half of a surrogate pair."""
NAME = EVIL.replace("/", "|").replace("\udcff", "")
LONG = "x" * 100_000


def assert_safe(*texts: str) -> None:
    for text in texts:
        assert all(line.isprintable() for line in text.split("\n")), repr(text)


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


def calls(path: Path) -> list[ast.Call]:
    return [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]


@pytest.mark.slow
def test_only_one_module_prints() -> None:
    """Whoever prints past ``talk`` prints raw characters. Pipes to other processes are no terminal."""
    for path in sorted((ROOT / "src" / "topcli").rglob("*.py")):
        if path.name == "output.py":
            continue
        for call in calls(path):
            where = f"{path}:{call.lineno}"
            stream = next((ast.unparse(word.value) for word in call.keywords if word.arg == "file"), "sys.stdout")
            if isinstance(call.func, ast.Name) and call.func.id == "print" and stream.startswith("sys."):
                assert path.name == "__main__.py", where
                assert all(isinstance(one, ast.Constant) or "strerror" in ast.unparse(one) for one in call.args), where
            assert not (isinstance(call.func, ast.Attribute) and call.func.attr in ("echo", "secho")), where


@pytest.mark.slow
def test_lines_of_an_error_are_arguments() -> None:
    """A line end inside a line would be printed as an escape."""
    for path in sorted((ROOT / "src" / "topcli").rglob("*.py")):
        for call in calls(path):
            name = getattr(call.func, "id", getattr(call.func, "attr", ""))
            if name in ("UsageError", "ConfigError", "RunError", "UnknownNameError", "SchemeCodeError", "TopcliError"):
                texts = [node.value for node in ast.walk(call) if isinstance(node, ast.Constant)]
                assert not any("\n" in text for text in texts if isinstance(text, str)), f"{path}:{call.lineno}"


ATTACKS = [
    ("run", NAME),
    ("run", NAME + ".yaml"),
    ("run", f"{NAME}/x.yaml"),
    ("run", HK, "--set", f"name={EVIL}"),
    ("run", HK, "--set", f"scheme={EVIL}"),
    ("run", HK, "--set", f"{EVIL}=1"),
    ("run", HK, "--set", f"top={EVIL}"),
    ("run", HK, "--set", f"output.columns=['{NAME}']"),
    ("run", HK, "--format", EVIL),
    ("run", HK, "--scheme-file", NAME),
    ("run", HK, "--out", f"file/{NAME}", "--set", "N=3"),
    ("compare", EVIL, "hk"),
    ("compare", "hk", "--set", f"scheme={EVIL}"),
    ("compare", "hk", f"hk+{EVIL}"),
    ("bench", "--scene", EVIL),
    ("bench", "--against", EVIL),
    ("bench", EVIL, "--against", "none"),
    ("plot", EVIL),
    ("plot", "fig1", "--format", EVIL),
    ("plot", "fig1", "--configs", NAME),
    ("plot", "sweep", NAME),
    ("plot", "fig1", "--x", EVIL),
    ("table", NAME, "--rows", "h", "--value", "seconds"),
    ("table", "file", "--rows", "h", "--value", "seconds", "--format", EVIL),
    ("order", EVIL),
    ("order", "hk", "--top", EVIL),
    ("order", "hk", "--config", EVIL),
    ("lax", EVIL),
    ("roundoff", EVIL),
    ("stress", EVIL),
    ("claims", EVIL),
    ("stress", "--case", EVIL),
    ("stress", "hk", "--set", f"scheme.{EVIL}=1"),
    ("list", "runs", "--out", NAME),
    ("list", "cases", "--top", EVIL),
    ("show", EVIL),
    ("init", NAME),
    (EVIL,),
    ("run", f"--{EVIL}"),
    ("list", EVIL),
    ("run", HK, "--threads", EVIL),
]


@pytest.mark.slow
@pytest.mark.parametrize("arguments", ATTACKS, ids=lambda arguments: " ".join(arguments)[:20].encode("unicode_escape"))
def test_no_argument_reaches_the_terminal_raw(cli, in_tmp: Path, arguments: tuple[str, ...]) -> None:
    (in_tmp / "file").write_text("")
    said = cli(*arguments)
    assert said.code == 2
    assert_safe(said.out, said.err)
    assert said.err.startswith("error: ")
    assert said.out == ""


PATHS = {("run", NAME + ".yaml"), ("run", f"{NAME}/x.yaml"), ("init", NAME), ("list", "runs", "--out", NAME)}
PATHS |= {("plot", "fig1", "--configs", NAME), ("run", HK, "--scheme-file", NAME), ("plot", "sweep", NAME)}
PATHS |= {("table", NAME, "--rows", "h", "--value", "seconds")}


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [one for one in ATTACKS if "N=3" not in one],
    ids=lambda arguments: " ".join(arguments)[:20].encode("unicode_escape"),
)
def test_no_message_is_long(cli, arguments: tuple[str, ...]) -> None:
    """Names are repeated to 60 characters; paths, and what typer repeats, are cut in the middle."""
    said = cli(*(part.replace(EVIL, LONG).replace(NAME, LONG) for part in arguments))
    assert said.code == 2
    assert 0 < len(said.err) < 1000
    typer = "(see topcli" in said.err
    assert max(map(len, re.findall("x+", said.err)), default=0) <= (500 if arguments in PATHS else 240 if typer else 60)


TEXTS = [
    BASE + f"{json.dumps(EVIL)}: 1\n",
    BASE + f"a: *{'b' * 50_000}\n",
    BASE + "a: *\u202ebc\n",
    BASE + f"a: &{'b' * 50_000} [*{'b' * 50_000}]\n",
    BASE.replace("name: x", f"name: {json.dumps(EVIL)}"),
    BASE.replace("name: x", f"name: {json.dumps(LONG)}"),
    BASE.replace("kowalevski", json.dumps(EVIL)),
    BASE.replace("hk", json.dumps(LONG)),
    BASE.replace("omega", json.dumps(EVIL)),
    BASE.replace("omega", json.dumps(LONG[:100])),
    BASE.replace("format: csv", f"columns: [{json.dumps(LONG)}, {json.dumps(EVIL)}]"),
    BASE.replace("hk", f"{{name: hk, compose: {json.dumps(LONG)}}}"),
    BASE + f"ensemble: {{random: {{count: 3, omega: {json.dumps(LONG)}, gamma: {json.dumps(EVIL)}}}}}\n",
    BASE + f'ensemble: {{grid: {{{json.dumps(LONG)[:200]}": [1]}}}}\n',
]


@pytest.mark.slow
@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_no_content_of_a_config_reaches_the_terminal_raw(tmp_path: Path, text: str) -> None:
    message = refusal(write(tmp_path, text.encode("utf-8", "surrogatepass")))
    assert_safe(message)
    assert len(message) <= MESSAGE_LENGTH


@pytest.mark.skipif(os.name == "nt", reason="such names are not possible")
def test_control_characters_in_file_names_are_escaped(cli, in_tmp: Path) -> None:
    (in_tmp / f"{NAME[:60].replace(chr(0), '')}.yaml").write_text("")
    (in_tmp / ("y" * 240 + ".yaml")).write_text("")
    said = cli("run", "zzz.yaml")
    assert r"\x1b]0;own" in said.err
    assert_safe(said.err)
    assert len(said.err) < 400


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="such names are not possible")
@pytest.mark.parametrize("terminal", [False, True])
def test_foreign_runs_are_listed_as_data(cli, in_tmp: Path, monkeypatch: pytest.MonkeyPatch, terminal: bool) -> None:
    from topcli.cli import output

    cli("run", HK, "--name", "kowalevski_hk", "--set", "N=20", "--quiet")
    folder = in_tmp / "results" / "kowalevski_hk"
    manifest = json.loads((folder / "manifest.json").read_text())
    hostile = manifest | {"outcome": EVIL + LONG, "ended": EVIL, "config": manifest["config"] | {"h": EVIL}}
    (folder / "manifest.json").write_text(json.dumps(hostile))
    folder.rename(folder.with_name(NAME))
    monkeypatch.setattr(output, "_terminal", lambda stream: terminal)
    said = cli("list", "runs")
    assert said.code == 0
    assert_safe(said.out, said.err)
    assert len(said.out) < 2000
    if not terminal:
        assert printable(NAME) in said.out  # the markup too is data
    document = cli("list", "runs", "--json")
    assert_safe(document.out)
    assert document.json()["runs"][0]["name"] == NAME


def test_markup_is_data_in_the_progress_bar(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    from topcli.cli import output

    monkeypatch.setattr(output, "_terminal", lambda stream: True)
    monkeypatch.setenv("TERM", "xterm")
    times = iter([0.0, 0.0, 10.0, 11.0, 12.0, 13.0])
    teller = output.ProgressDisplay(1, False, lambda: next(times))
    teller.begin("[link=http://evil]a[/link]:boom:\x1b[31m\x9b")
    teller(5, 10)
    shown = teller._bar.get_renderable()
    from rich.console import Console

    with Console(width=200, markup=False, emoji=False).capture() as captured:
        Console(width=200).print(shown)
    teller.close()
    out = capsys.readouterr().out + captured.get()
    assert r"[link=http://evil]a[/link]:boom:\x1b[31m\x9b" in out


def test_yaml_of_exclamation_marks_is_read_in_linear_time(tmp_path: Path) -> None:
    """Tenfold text takes tenfold CPU time, not a hundredfold: the ratio is that of a quadratic reader at 30."""

    def seconds(length: int) -> float:
        path = write(tmp_path, "!" * length)
        began = time.process_time()
        message = refusal(path)
        assert "tags such as '!!!" in message
        return time.process_time() - began

    small = min(seconds(100_000) for _ in range(3))
    assert seconds(1_000_000) < 30.0 * small + 0.1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("rnu",), "error: no such command 'rnu'; did you mean 'run'? (see topcli --help)"),
        (("run",), "error: missing argument 'CONFIG' (see topcli run --help)"),
        (
            ("run", HK, "--thread", "2"),
            "error: no such option: --thread; did you mean --threads? (see topcli run --help)",
        ),
        (("run", HK, "--out"), "error: option '--out' requires an argument"),
        (("schema", "x"), "error: got unexpected extra argument(s) (x) (see topcli schema --help)"),
    ],
)
def test_errors_of_usage_look_like_all_others(cli, arguments: tuple[str, ...], message: str) -> None:
    said = cli(*arguments)
    assert (said.code, said.out, said.err) == (2, "", message + "\n")


def test_nothing_given_prints_the_help(cli) -> None:
    said = cli()
    assert said.code == 2
    assert "Commands:" in said.out + said.err


def test_help_is_readable(cli, monkeypatch: pytest.MonkeyPatch) -> None:
    """Summaries whole at 80 columns; no types of Python, no backticks; a metavar for every option with a value."""
    monkeypatch.setenv("COLUMNS", "80")
    from typer.main import get_command

    from topcli.cli.app import app

    groups = {"": get_command(app)}
    groups["list"] = groups[""].commands["list"]  # type: ignore[attr-defined]
    for group, command in groups.items():
        out = cli(*group.split(), "--help").out
        for name, one in command.commands.items():  # type: ignore[attr-defined]
            summary = (one.help or "").split("\n\n")[0].replace("\n", " ")
            assert len(summary) <= 60, summary
            assert summary in out
            if name == "list":
                continue
            text = cli(*group.split(), name, "--help").out
            assert not re.search("<[a-z]", text), name
            assert "`" not in text, name
            for parameter in one.params:
                assert re.fullmatch("[A-Z].*[^.][.]", parameter.help), f"{name} {parameter.name}"
                if parameter.param_type_name == "option" and not parameter.is_flag and parameter.name != "help":
                    assert parameter.metavar, f"{name} {parameter.name}"
        assert "..." not in out.split("Commands:")[1].replace("[ARGS]...", "")
        assert "`" not in out


def test_exit_codes_are_documented_alike() -> None:
    import topcli.errors
    from topcli.cli.app import app

    readme = (ROOT / "docs" / "exit-codes.md").read_text(encoding="utf-8")
    for code in (0, 1, 2, 3, 4, 70, 130):
        for text in (readme, topcli.errors.__doc__ or "", str(app.info.epilog)):
            assert f" {code} " in f" {text} ".replace("\n", " ").replace("  ", " "), code


def test_an_internal_error_is_printed_safely(cli, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    from topcli.__main__ import main

    scope: dict = {"EVIL": EVIL}  # the file decides whose bug it is
    ours = ROOT / "src" / "topcli" / "cli" / "app.py"
    exec(compile("def broken():\n    raise ZeroDivisionError(EVIL)", str(ours), "exec"), scope)
    monkeypatch.setattr("topcli.cli.app.call", scope["broken"])
    with pytest.raises(SystemExit) as leaving:
        main()
    err = capsys.readouterr().err
    assert leaving.value.code == 70
    assert_safe(err)
    assert "bug in topcli" in err
