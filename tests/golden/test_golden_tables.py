"""Every table that a person sees, in each format and on pages, from recorded results with distinct numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import golden
import topcli
from shown import distinct, named_differently
from stored_results import BASE
from topcli.cli.output import table_lines
from topcli.runs.report import report_tables

UNCHANGED = ("h", "N", "power", "steps", "copies", "declared_order", "duration", "degree", "size")
RESULTS = golden.DATA / "results"


def measured(name: str, out: Path) -> Any:
    """A result of a study, small."""
    return {
        "run": lambda: topcli.run({**BASE, "scheme": "hk"}, out, name="r", progress=False),
        "ensemble": lambda: topcli.run(
            {**BASE, "scheme": "hk", "N": 50, "ensemble": {"random": {"count": 9, "gamma": "sphere"}}}, out, name="m"
        ),
    }[name]()


def recorded(name: str, out: Path) -> Any:
    """The recorded result of a study, each number and verdict different from all others."""
    path = RESULTS / f"{name}.json"
    if golden.WRITE:
        data = json.loads(json.dumps(measured(name, out).as_dict()))
        data.pop("series", None)
        data = named_differently(distinct(data, 1, keep=UNCHANGED), ("model", "steps_from"))
        text = json.dumps(data, indent=1, ensure_ascii=False).replace(str(out), "OUT")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return json.loads(path.read_text(encoding="utf-8"))


def shape(data: Any) -> Any:
    """Keys of plain data, of lists those of the first element."""
    if isinstance(data, dict):
        return {key: shape(value) for key, value in sorted(data.items())}
    return [shape(data[0])] if isinstance(data, list) and data else None


@pytest.mark.parametrize("name", ["run", "ensemble"])
def test_report(name: str, tmp_path: Path) -> None:
    data = recorded(name, tmp_path)
    table = report_tables(data.get("report", data))[0]
    cells = table.cells()
    terminal = table_lines(replace(cells, numbers=True))
    texts = {form: table.text(form).splitlines() for form in ("markdown", "latex", "csv")}
    golden.check(
        f"report_{name}", {"terminal": terminal, "caption": cells.caption, "marks": dict(cells.marks), **texts}
    )


@pytest.mark.parametrize("name", ["run", "ensemble"])
def test_results_still_have_the_recorded_shape(name: str, tmp_path: Path) -> None:
    data = json.loads(json.dumps(measured(name, tmp_path / "new").as_dict()))
    data.pop("series", None)
    assert shape(data) == shape(recorded(name, tmp_path))
