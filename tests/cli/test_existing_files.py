"""Files that exist are kept unless ``--force`` is given; stored results are found by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import Said

SHORT = ("--set", "h=0.01", "--set", "T=1")
WRITERS = {
    "table": "table swept --rows scheme --value max_error --out mine.csv --format csv",
    "report": "report short --out mine.html",
    "animate": "animate turning --out mine.gif --seconds 0.2",
    "init": "init mine.yaml",
    "compare": "compare hk --save mine.json",
    "check": "check --scheme hk --top euler --save mine.json",
    "figure": "compare hk --set h=0.01 --set T=1 --plot mine.svg",
    "plot": "plot fig1 --format svg --out .",
    "order": "order hk --max-steps 100 --h 0.05 --h 0.025 --save mine.json",
}
"""A command that writes a file, by a name for it."""


@pytest.fixture
def stored(cli: Callable[..., Said], in_tmp: Path) -> Callable[..., Said]:
    """Call a command in a folder with a run, a run with attitudes and a sweep."""
    assert cli("run", "euler_hk", *SHORT, "--set", "name=short", "-q").code == 0
    assert cli("run", "euler_attitude", "--set", "N=50", "--set", "name=turning", "-q").code == 0
    study = "name: swept\nbase: {top: euler, initial: {omega: [1, 0.5, 0.2]}, h: 0.1, N: 10}\n"
    (in_tmp / "swept.yaml").write_text(study + "grid: {scheme: [hk, rk4]}\nmeasure: [max_error]\n")
    assert cli("sweep", "swept.yaml", "-q").code == 0
    return cli


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_file_of_somebody_else_is_kept(name: str, stored: Callable[..., Said], in_tmp: Path) -> None:
    words = WRITERS[name].split()
    before = {path for path in in_tmp.iterdir() if path.is_file()}
    assert stored(*words, "-q") == Said(0, "", "")
    written = sorted({path for path in in_tmp.iterdir() if path.is_file()} - before)
    assert written
    for path in written:
        path.write_text("mine")
    said = stored(*words, "-q")
    assert (said.code, said.out) == (2, "")
    assert said.err.startswith("error: ")
    assert said.err.endswith("exists already; choose another name or folder, or use --force to replace it\n")
    assert {path.read_text() for path in written} == {"mine"}
    assert stored(*words, "--force", "-q") == Said(0, "", "")
    assert "mine" not in {path.read_bytes().decode(errors="replace") for path in written}


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        "verify short",
        "verify swept",
        "report swept --out page.html",
        "table swept --rows scheme --value max_error",
        "animate turning --out turning.gif --seconds 0.2",
        "plot sweep swept --x scheme --y max_error --out pictures",
        "show swept --row 1",
    ],
)
def test_a_stored_result_is_found_by_name_or_path(line: str, stored: Callable[..., Said], in_tmp: Path) -> None:
    force = ["--force"] if "--out" in line else []
    by_name = stored(*line.split())
    assert by_name.code == 0, by_name.err
    (in_tmp / "results").rename(in_tmp / "elsewhere")
    elsewhere = stored(*line.split(), "--results", "elsewhere", *force)
    assert elsewhere.code == 0, elsewhere.err
    name = line.split()[2 if line.startswith("plot") else 1]
    by_path = stored(*line.replace(name, f"elsewhere/{name}", 1).split(), *force)
    assert by_path.code == 0, by_path.err
    assert by_path.out == elsewhere.out
    missing = stored(*line.replace(name, "nowhere", 1).split(), *force)
    assert missing.code == 2
    assert "nowhere" in missing.err


@pytest.mark.parametrize("name", ["mine", "results/mine", "results/mine/"])
def test_a_stored_run_is_no_config(cli: Callable[..., Said], name: str) -> None:
    assert cli("run", "euler_hk", *SHORT, "--set", "name=mine", "-q").code == 0
    said = cli("run", name)
    assert said.code == 2
    assert said.err == f"error: {name!r} is a stored run; its config is results/mine/config.yaml\n"
    assert "(up to date)" in cli("run", "results/mine/config.yaml").err
