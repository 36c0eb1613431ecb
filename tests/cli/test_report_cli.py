"""``topcli report`` at the command line: what it finds, what it writes, what it refuses."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import Said
from reading_html import read_html
from resuming import killed
from stored_results import experiment, store_run, store_sweep
from topcli.pages.page import all_chapters

Cli = Callable[..., Said]


@pytest.fixture
def stored(in_tmp: Path) -> Path:
    """A working folder with ``results/one``."""
    store_run(in_tmp / "results", "one", N=60)
    return in_tmp


@pytest.mark.slow
def test_a_run_is_found_by_name_by_folder_and_by_a_file_in_it(cli: Cli, stored: Path) -> None:
    for place in ("one", "results/one", "results/one/series.parquet", "results/one/manifest.json"):
        (chapter,) = all_chapters([place], stored / "results")
        assert (chapter.title, chapter.state) == ("one", "completed")
    said = cli("report", "one", "one", "--out", "page.html")
    assert (said.code, said.out, said.err) == (0, "", "wrote page.html\n")
    assert [heading.text for heading in read_html((stored / "page.html").read_text()).all("h1")] == ["one"]


@pytest.mark.slow
def test_json_names_the_results(cli: Cli, stored: Path) -> None:
    store_sweep(stored / "elsewhere", "swept")
    said = cli("report", "one", "elsewhere/swept", "--out", "new/page.html", "--json")
    found = said.json()
    assert found["file"] == "new/page.html"
    assert [(one["name"], one["kind"], one["state"]) for one in found["results"]] == [
        ("one", "run", "completed"),
        ("swept", "sweep", "finished"),
    ]
    assert said.err == ""


@pytest.mark.slow
def test_no_page_is_written_on_a_damaged_result(cli: Cli, stored: Path) -> None:
    (stored / "results" / "one" / "report.json").unlink()
    said = cli("report", "one", "--out", "page.html")
    assert said.code == 1
    assert "report.json: damaged: missing" in said.err
    assert not (stored / "page.html").exists()


@pytest.mark.slow
def test_a_page_is_written_whole_or_not_at_all(cli: Cli, stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = stored / "page.html"
    page.write_text("mine")

    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr("os.replace", full)
        said = cli("report", "one", "--out", "page.html", "--force")
    assert said.code == 2
    assert said.err == "error: --out page.html: cannot be written (No space left on device)\n"
    assert page.read_text() == "mine"
    assert sorted(path.name for path in stored.iterdir()) == ["page.html", "results"]
    assert cli("report", "one", "--out", "page.html", "--force").code == 0
    assert page.read_text().startswith("<!doctype html>")


def test_no_page_is_written_on_an_unfinished_run(cli: Cli, in_tmp: Path, small_chunks: None) -> None:
    folder = killed(in_tmp / "results", experiment("long", N=5000), 3)
    for place in ("long", str(folder)):
        said = cli("report", place, "--out", "page.html")
        assert said.code == 2
        assert "unfinished" in said.err
    assert not (in_tmp / "page.html").exists()


@pytest.mark.slow
def test_a_stored_comparison_is_reported_with_pictures(cli: Cli, in_tmp: Path) -> None:
    arguments = ["compare", "hk", "hybrid", "--config", "kowalevski_generic_hk", "--set", "N=200", "--save", "c.json"]
    said = cli(*arguments)
    assert (said.code, said.err.splitlines()[0]) == (0, "wrote c.json")
    assert cli(*arguments).err.startswith("error: --save c.json: exists already")
    assert cli(*arguments, "--force").code == 0
    assert cli("report", "c.json", "--out", "page.html").err == "wrote page.html\n"
    page = read_html((in_tmp / "page.html").read_text())
    assert len(page.all("img")) == 1
    assert "unknown type of file" in cli(*arguments[:-1], "c.yaml").err
