"""Every table that a person sees, in each format and on pages, from recorded results with distinct numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import golden
import topcli
from shown import distinct, named_differently
from stored_results import BASE
from topcli.cli.output import table_lines
from topcli.pages.page import rendered
from topcli.pages.studies import study_chapter
from topcli.runs.report import ENSEMBLE, INVARIANTS
from topcli.studies import STUDIES, find_study
from topcli.studies.study import Result

UNCHANGED = ("h", "N", "power", "steps", "copies", "declared_order", "duration", "degree", "size")
RESULTS = golden.DATA / "results"
SCHEMES = ("hk", "rk4", "hybrid", "exact")


def measured(name: str, out: Path) -> Any:
    """A result of a study, small."""
    short = {"overrides": ["N=300"]}
    run = topcli.run("euler_hk", out, name="one", N=300, progress=False).folder
    return {
        "order": lambda: topcli.order("hk", "rk4", "bohlin-a", steps=300),
        "stress": lambda: topcli.stress("hk", "rk4", cases=["pole", "delone"]),
        "claims": lambda: topcli.claims(["matrix-m", "hybrid-reversible", "hk-heavy-equation"]),
        "lax": lambda: topcli.lax("kowalevski", "hk", "backlund", overrides=["N=40"]),
        "roundoff": lambda: topcli.roundoff("hk", "euler_hk", steps=300, copies=2),
        "lyapunov": lambda: topcli.lyapunov("kowalevski_hk", spectrum=True, overrides=["N=2000", "h=0.05"]),
        "frequencies": lambda: topcli.frequencies("kowalevski_generic_hk", overrides=["N=2000"]),
        "integrability": lambda: topcli.integrability("suslov"),
        "check": lambda: topcli.check(schemes=["rk4"], top="euler"),
        "compare": lambda: topcli.compare("hk", "bs", "exact", config="euler_hk", **short),
        "analyse": lambda: topcli.analyse(run / "series.parquet", "euler_hk"),
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


def shown_text(tables: Any, data: Any) -> dict[str, Any]:
    return {
        table.name: {
            "terminal": table_lines(
                (c := table.cells(data)).header, c.lines, range(1, len(c.header)), 100, keys=c.keys
            ),
            "caption": c.caption,
            "title": table.title_of(data),
            "marks": dict(c.marks),
            **{form: table.text(data, form).splitlines() for form in ("markdown", "latex", "csv")},
        }
        for table in tables
    }


@pytest.mark.parametrize("name", STUDIES)
def test_study(name: str, tmp_path: Path) -> None:
    data, study = recorded(name, tmp_path), find_study(name)
    result = Result(data)
    parts = study.printed_of(result, verbose=False) if name != "claims" else ()
    printed = [part if isinstance(part, str) else part.name for part in parts]
    page = rendered([study_chapter(study, result, None)], "t", draw=lambda picture: "")
    tables = [*study.tables_of(data), *study.frames]
    text = {
        "tables": shown_text(tables, data),
        "printed": printed,
        "page": [line for line in page.splitlines() if "Written by" not in line],
    }
    golden.check(
        f"study_{name}",
        text | {"faults": [str(fault) for fault in (study.faults(data) if study.faults else ())]},
        rel=1e-15,
    )


@pytest.mark.parametrize("name", ["run", "ensemble"])
def test_report(name: str, tmp_path: Path) -> None:
    data = recorded(name, tmp_path)
    data = data.get("report", data)
    golden.check(f"report_{name}", {"tables": shown_text([INVARIANTS if name == "run" else ENSEMBLE], data)})


@pytest.mark.parametrize("name", [*STUDIES, "run", "ensemble"])
def test_results_still_have_the_recorded_shape(name: str, tmp_path: Path) -> None:
    data = json.loads(json.dumps(measured(name, tmp_path).as_dict()))
    data.pop("series", None)
    assert shape(data) == shape(recorded(name, tmp_path))
