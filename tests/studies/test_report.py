"""A report is rendered alike everywhere: each cell equals its number, on a terminal, in JSON, files and pages."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import topcli
from conftest import Said
from topcli import STUDIES
from topcli.errors import UsageError
from topcli.studies import SILENT, Watch, find_study
from topcli.studies.report import Report, Table

Cli = Callable[..., Said]
ROWS = [
    {"scheme": "hk", "max_error": 1.0 / 3.0, "steps": 7, "ok": True, "hidden": 0.25},
    {"scheme": "rk4 <b>", "max_error": 2e-9 / 3.0, "steps": 12, "ok": False, "hidden": math.nan},
    {"scheme": "exact", "max_error": None, "steps": 1},
]
FINE = [{"h": 0.1 * 2.0**-k, "hk": 0.01 * 4.0**-k} for k in range(3)]


def made_up(
    *names: str,
    config: str | Path = "kowalevski_hk",
    overrides: Sequence[str] = (),
    sizes: Sequence[float] = (),
    max_steps: int = 1000,
    kind: Literal["taylor", "exact"] = "taylor",
    limit: float | None = None,
    fast: bool = False,
    watch: Watch = SILENT,
) -> Report:
    """Return the arguments.

    Parameters
    ----------
    *names : str
        Names of things. Not in the help.
    config, overrides
        As everywhere.
    sizes : sequence of float
        Step sizes.
    max_steps : int
        Largest number.
    kind : {"taylor", "exact"}
        Kind of the reference.
    limit : float, optional
        Largest value.
    fast : bool
        Hurry up.
    watch : Watch
        Observer.
    """
    watch.begin("made up", unit="things")
    watch(1, 1)
    arguments = {"names": list(names), "config": str(config), "overrides": list(overrides), "sizes": list(sizes)}
    arguments |= {"max_steps": max_steps, "kind": kind, "limit": limit, "fast": fast}
    columns = {"h": np.array([row["h"] for row in FINE])}

    def draw(axes: Any, looks: Callable[..., Any]) -> None:
        for label, style in looks(["hk", "rk4"]).items():
            axes.loglog(columns["h"], columns["h"], label=label, **style)

    tables = [
        Table("Main", ROWS, {"steps": lambda n: f"{n} steps"}, ("hidden",)),
        Table("Fine print", FINE, detail=True),
    ]
    notes, errors = ["a note"], ["an error"]
    return Report("made_up", "A <title>", "The answer.", tables, notes, errors, 4, arguments, columns, draw)


order = made_up


@pytest.fixture
def listed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(STUDIES, "order", (__name__, "Return the arguments."))


def test_cells_of_a_table_are_its_numbers() -> None:
    main = made_up().tables[0]
    assert main.cells(verbose=False).header == ["scheme", "max error", "steps", "ok"]
    assert main.cells().lines == [
        ["hk", "0.333", "7 steps", "yes", "0.25"],
        ["rk4 <b>", "6.67e-10", "12 steps", "no", "nan"],
        ["exact", "–", "1 steps", "–", "–"],
    ]
    assert main.cells().numbers == [1, 2, 3, 4]
    frame = made_up().table
    assert frame.index.name == "scheme"
    assert frame["max_error"].tolist()[:2] == [row["max_error"] for row in ROWS[:2]]


def test_the_command_has_the_options_of_the_function(cli: Cli, listed: None) -> None:
    said = cli(
        "order", "a", "b", "--set", "x=1", "--set", "y=2", "--h", "0.1", "--max-steps", "1e3", "--fast", "--json"
    )
    arguments = {"names": ["a", "b"], "config": "kowalevski_hk", "overrides": ["x=1", "y=2"], "sizes": [0.1]}
    assert said.json()["config"] == {**arguments, "max_steps": 1000, "kind": "taylor", "limit": None, "fast": True}
    assert cli("order", "--limit", "2", "--kind", "exact", "--json").json()["config"]["limit"] == 2.0
    helped = " ".join(cli("order", "--help").out.split())
    texts = ("Names of things.", "Largest number.", "[default: 1000]", "--kind taylor|exact", "--fast Hurry up.")
    for text in texts:
        assert text in helped
    assert "Not in the help" not in helped
    for wrong in (
        ("--max-steps", "1.5"),
        ("--kind", "other"),
        ("--h", "fine"),
        ("--plot", "x.txt"),
        ("--save", "x.png"),
    ):
        assert cli("order", *wrong).code == 2


def test_a_terminal_shows_title_answer_tables_notes_and_errors(cli: Cli, listed: None) -> None:
    said = cli("order")
    assert said.code == 4
    assert said.out.splitlines()[:4] == ["A <title>", "The answer.", "", "Main"]
    assert "Fine print" not in said.out
    assert "hidden" not in said.out
    assert said.err == "a note\nerror: an error\n"
    verbose = cli("order", "-v").out
    assert "hidden" in verbose
    assert "Fine print" in verbose
    assert cli("order", "-q") == Said(4, "", "error: an error\n")


def test_files_tables_and_pages_show_the_stored_record(cli: Cli, listed: None, monkeypatch: pytest.MonkeyPatch) -> None:
    said = cli("order", "--save", "r.json", "--plot", "r.svg")
    assert said.err.splitlines()[:2] == ["wrote r.svg", "wrote r.json"]
    assert Path("r.svg").read_text().startswith("<?xml")
    stored = json.loads(Path("r.json").read_text())
    assert stored["tables"][0]["rows"] == [{**row, "hidden": None} if "nan" in str(row) else row for row in ROWS]
    cells = made_up().tables[0].cells()
    assert stored["tables"][0]["cells"]["lines"] == cells.lines
    assert json.loads(cli("order", "--json").out)["tables"] == stored["tables"]
    monkeypatch.delitem(STUDIES, "order")  # no code of the study is needed any more
    output = cli("table", "r.json").out
    assert all(cell in output for line in cells.lines for cell in line)
    assert cli("table", "r.json", "--format", "csv").out.splitlines()[0] == "scheme,max_error,steps,ok,hidden"
    assert (
        cli("table", "r.json", "--table", "fine_print", "--format", "csv").out == made_up().tables[1].frame().to_csv()
    )
    assert "did you mean 'fine_print'" in cli("table", "r.json", "--table", "fineprint").err
    assert cli("report", "r.json", "--out", "r.html").code == 0
    page = Path("r.html").read_text()
    assert all(escape(text) in page for text in ("A <title>", "The answer.", "a note", "an error", "Fine print"))
    assert "data:image/svg+xml;base64," in page
    for line in cells.lines:
        assert all(f">{escape(cell)}<" in page for cell in line)


def test_tables_are_saved_by_the_ending(in_tmp: Path) -> None:
    report = made_up()
    assert "| hk | 0.333 | 7 steps | yes | 0.25 |" in report.save("x.md").read_text()
    assert r"$6.67 \times 10^{-10}$" in report.save("x.tex").read_text()
    with pytest.raises(UsageError, match="unknown type of file"):
        report.save("x.doc")
    with pytest.raises(UsageError, match="no picture"):
        Report("c", "t").plot()
    assert repr(report) == "<Report of made_up: The answer.>"
    assert "rk4 &lt;b&gt;" in report._repr_html_()


@pytest.mark.parametrize("name", STUDIES)
def test_the_python_function_is_that_of_the_module(name: str) -> None:
    function = getattr(topcli, name)
    assert function is find_study(name)
    assert function.__module__ == STUDIES[name][0]
    assert (function.__doc__ or "").splitlines()[0] == STUDIES[name][1]
    assert len(STUDIES[name][1]) <= 60
