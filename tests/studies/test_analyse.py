"""Series of other programs: usual files are read, all else is refused; exact motions, known defects, own runs."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import topcli
from cases import table_of
from topcli.errors import UsageError
from topcli.studies.analyse import read_frame
from topcli.studies.report import Report

SYMMETRIC: dict[str, Any] = {
    "top": {"kind": "euler", "A": 2.0, "B": 2.0, "C": 1.0},
    "initial": {"omega": [0.5 * math.cos(1.0), 0.5 * math.sin(1.0), 2.0]},
    "scheme": "hk",
    "h": 0.01,
    "N": 100,
}
"""A symmetric body: its first two components turn with the rate (A - C) omega3 / A = 1."""
EVEN = np.linspace(0.0, 20.0, 2001)
TIMES = {
    "even": EVEN,
    "uneven": EVEN + 0.003 * np.sin(7.0 * EVEN) * EVEN * (20.0 - EVEN) / 100.0,
    "backward": -EVEN,
    "uneven backward": -(EVEN**1.2),
}


def motion(t: np.ndarray) -> dict[str, np.ndarray]:
    """The exact motion of the symmetric body."""
    turn = t - 1.0
    return {"t": t, "omega1": 0.5 * np.cos(turn), "omega2": -0.5 * np.sin(turn), "omega3": np.full(len(t), 2.0)}


def analysed(folder: Path, data: dict[str, Any], config: Any = SYMMETRIC, **options: Any) -> Report:
    path = folder / "series.parquet"
    pd.DataFrame(data).to_parquet(path)
    return topcli.analyse(path, config=config, **options)


def figures(report: Report) -> dict[str, Any]:
    return {row["figure"]: row["value"] for row in report.tables[0].rows}


def laws(report: Report) -> pd.DataFrame:
    return report.tables[1].frame()


# files


@pytest.mark.parametrize(
    "content",
    [
        "\ufefft,a\r\n0,1\r\n0.5,2\r\n",
        "# t;a\n0;1\n0.5;2\n",
        "t\ta\n0.0\t1e0\n\n5e-1\t2\n",
        't , "a"\n0, 1\n0.5, +2\n',
        "b,t,a\nword,0,1\n,0.5,2\n",
        "t;a;note\n0;1;x,y\n0,5;2,0;z\n",
        "# by a program\n# t a\n0 1\n0.5 2\n",
        "# comment\nt,a\n0,1 # first\n0.5,2\n",
    ],
)
def test_tables_are_read_however_they_are_written(tmp_path: Path, content: str) -> None:
    (tmp_path / "x.csv").write_bytes(content.encode())
    with gzip.open(tmp_path / "x.csv.gz", "wb") as file:
        file.write(content.encode())
    for name in ("x.csv", "x.csv.gz"):
        assert read_frame(tmp_path / name)[["t", "a"]].to_numpy(float).tolist() == [[0.0, 1.0], [0.5, 2.0]]


@pytest.mark.parametrize("separator", [",", ";"])
def test_numbers_keep_all_their_bits(tmp_path: Path, separator: str) -> None:
    random = np.random.default_rng(3)
    values = random.standard_normal(1000) * 10.0 ** random.integers(-300, 300, 1000)
    text = f"t{separator}a\n" + "".join(f"{n}{separator}{value!r}\n" for n, value in enumerate(values.tolist()))
    (tmp_path / "x.csv").write_text(text if separator == "," else text.replace(".", ","))
    np.testing.assert_array_equal(read_frame(tmp_path / "x.csv")["a"], values)


@pytest.mark.parametrize(
    ("content", "words"),
    table_of(r"""
b""                               cannot be read as CSV with a header (it has no line of names)
b"t,\xff\n0,1\n"                  cannot be read as CSV with a header ('utf-8' codec
b"t,omega1\n0,1\n0.5,2,3\n"       Expected 2 fields in line
b"t,omega1\n0,1,5\n0.5,2,3\n"     Length of header or names does not match length of data
b"t,omega1\n0,1\n0.5\n"           row 2: omega1 is not a finite number: ''
b"t,omega1\n0,True\n1,True\n"     row 1: omega1 is not a finite number: 'True'
b"t,omega1\n0,1\n1,2\n2,nan\n"    row 3: omega1 is not a finite number: 'nan'
b"t;omega1\n0;1.234,5\n"          row 1: omega1 is not a finite number: '1.234,5'
b"t,omega1\n0,1\n"                1 row; a series needs at least 2
b"t,omega1\n0,1\n1,2\n1,2\n"      row 3: t = 1.0 after 1.0; times must increase from row to row
b"t,omega1\n0,1\n-1,2\n-.5,2\n-2,1\n-3,1\n"  row 3: t = -0.5 after -1.0; times must decrease from row to row
"""),
)
def test_what_is_no_series_is_refused_in_a_line(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(content)
    rename = [] if b"omega1" not in content else ["omega2=omega1", "omega3=omega1"]
    with pytest.raises(UsageError) as caught:
        topcli.analyse(path, config=SYMMETRIC, rename=rename)
    (line,) = caught.value.lines
    assert line.startswith(f"{path}: ")
    assert words in line


def test_columns_are_renamed_by_names_and_formulas(tmp_path: Path) -> None:
    data = dict(zip(("time", "w x", "w_y", "omega3"), motion(EVEN).values(), strict=True))
    data |= {"w_y": 4.0 * data["w_y"], "time": data["time"] * 1e3}
    report = analysed(tmp_path, data, rename=["t=time/1000, omega1=w x", "omega2=w_y/4"])
    assert figures(report)["max error"] < 1e-13


# analyses


@pytest.mark.parametrize("kind", TIMES)
def test_an_exact_motion_and_one_whose_spin_grows(tmp_path: Path, kind: str) -> None:
    """omega3 gains 1e-4 t, which moves m.omega = 4.5 by (2 + 1e-4 t)^2 - 4, and the state by 1e-4 |t|."""
    t = TIMES[kind]
    report = analysed(tmp_path, motion(t))
    assert figures(report)["times"].endswith(", uneven" if "uneven" in kind else ", even")
    assert [figures(report)[name] for name in ("rows", "steps", "steps from")] == [2001, 2000, "rows - 1"]
    assert figures(report)["max error"] < 1e-14
    assert laws(report)["verdict"].tolist() == ["exact", "exact"]
    assert laws(report)["first"].tolist() == pytest.approx([5.0, 4.5])
    ours, reference = figures(report)["first spacing of minima of omega2"].removesuffix(")").split(" (reference ")
    assert [float(ours), float(reference)] == pytest.approx([2.0 * math.pi] * 2, abs=1e-6)

    report, end = analysed(tmp_path, motion(t) | {"omega3": 2.0 + 1e-4 * t}), float(t[-1])
    assert figures(report)["final error"] == pytest.approx(1e-4 * abs(end), rel=1e-9)
    np.testing.assert_allclose(report.columns["error"], 1e-4 * np.abs(t), atol=1e-13)
    row = laws(report).loc["m·ω"]
    assert row["max_deviation"] == pytest.approx(abs((2.0 + 1e-4 * end) ** 2 - 4.0), rel=1e-9)
    if "uneven" in kind:
        assert (row["verdict"], report.notes) == ("undecided", ["m², m·ω: undecided: a drift needs rows at even times"])
        assert row["drift"] is None
    else:
        assert row["verdict"] == "drifting"
        assert row["drift"] == pytest.approx(4e-4, rel=2e-3)


@pytest.mark.parametrize("gap", [1.0, 1.6, 6.3])
def test_minima_need_rows_between_them(tmp_path: Path, gap: float) -> None:
    """The period is 2 pi: six rows show it, four do not, and rows every 6.3 look like a slow oscillation."""
    report = analysed(tmp_path, motion(np.arange(0.0, 1000.0, gap)))
    shown = f"rows {gap:g} apart in time are too few to show the swings of omega2; record more of them"
    assert report.notes == ([] if gap == 1.0 else [f"warning: no minima: {shown}"])
    (spacing,) = [value for name, value in figures(report).items() if name.startswith("first spacing")]
    assert spacing.startswith("6.28" if gap == 1.0 else "–")


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_limits_of_agreement(tmp_path: Path, factor: float) -> None:
    """The start may be off by a millionth of the largest component, 2."""
    off, within = factor * 2e-6, factor < 1.0
    data = motion(EVEN)
    summary = figures(analysed(tmp_path, data | {"omega3": data["omega3"] + off, "t": EVEN + 7.0}))
    assert summary["first row − config"] == pytest.approx(off, rel=1e-6)
    assert summary["reference from"] == ("the config's initial state" if within else "the first row")
    # from the first row, omega1 and omega2 turn faster by off / 2: 0.5 * 20 * off / 2 after t = 20
    assert summary["final error"] == pytest.approx(off if within else 5.0 * off, rel=1e-3)


@pytest.mark.parametrize(
    ("n", "steps", "expected"),
    [
        (5 + 10 * np.arange(2001), None, (20000, "column n")),
        (5 + 10 * np.arange(2001), 9, (9, "--steps")),
        (np.sin(EVEN), None, (2000, "rows - 1")),  # another quantity of that name
    ],
)
def test_steps_decide_the_round_off_bound(
    tmp_path: Path, n: np.ndarray, steps: int | None, expected: tuple[int, str]
) -> None:
    report = analysed(tmp_path, motion(EVEN) | {"n": n}, steps=steps)
    assert (figures(report)["steps"], figures(report)["steps from"]) == expected
    bound = 20.0 * 2.0**-52 * math.sqrt(expected[0]) * 4.5
    assert laws(report).loc["m·ω", "round_off_bound"] == pytest.approx(bound)


def test_a_reference_out_of_reach_leaves_the_rest(tmp_path: Path) -> None:
    report = analysed(tmp_path, motion(EVEN) | {"t": EVEN * 1e9})
    no_error, no_minima = report.notes
    assert no_minima.startswith("warning: no minima: rows 1e+07 apart")
    assert no_error.startswith("warning: no error: the reference would need at least 1e+10 Taylor steps")
    assert figures(report)["max error"] is None
    assert laws(report)["verdict"].tolist() == ["exact", "exact"]
    assert set(report.columns) == {"t", "deviation of m²", "deviation of m·ω"}


def test_a_motion_that_leaves_its_energy_surface_is_noted(tmp_path: Path) -> None:
    """The limit is 100 times the sum of the terms: omega3^2 = 450 at most, beside 0.5."""
    start = topcli.simulate("heavy_hk", ["N=1"])
    data = {"t": EVEN[:50], **{name: np.full(50, start[name][0]) for name in start.top.components}}
    assert "energy surface" not in str(analysed(tmp_path, data, "heavy_hk").notes)
    data["omega1"][40:] = 1e4
    words = f"far off its energy surface at row 41 (t = {data['t'][40]:.6g})"
    assert words in str(analysed(tmp_path, data, "heavy_hk").notes)


def test_a_stored_run_gets_the_verdicts_of_its_report(tmp_path: Path) -> None:
    """Extremes, deviations and verdicts are the same bits."""
    sets = ["N=3000", "h=-0.01", "output.every=3", "output.format=csv"]
    folder = topcli.run("kowalevski_hk", tmp_path, overrides=sets, progress=False).folder
    report = topcli.analyse(next(folder.glob("series.*")), config="kowalevski_hk", overrides=sets)
    assert (figures(report)["steps from"], figures(report)["first row − config"]) == ("column n", 0.0)
    stored = pd.DataFrame(json.loads((folder / "report.json").read_text())["invariants"])
    for name in ("max_deviation", "first", "min", "max", "verdict"):
        assert laws(report)[name].tolist() == stored[name].tolist()
