"""``topcli analyse`` as a user calls it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

HEADER = "time,w_x,w_y,w_z"
COLUMNS = "t=time,omega1=w_x,omega2=w_y,omega3=w_z"


def spin(path: str, omega3: np.ndarray) -> np.ndarray:
    """Write a rotation about the third axis of ``euler_hk``; return the times."""
    t = np.linspace(0.0, 10.0, len(omega3)) ** 1.1
    zero = np.zeros(len(t))
    np.savetxt(path, np.column_stack([t, zero, zero, omega3]), delimiter=",", header=HEADER, comments="")
    return t


@pytest.mark.slow
def test_a_csv_file_is_analysed_and_drawn(cli: Callable[..., Any]) -> None:
    t = spin("mine.csv", 1.3 + 1e-6 * np.linspace(0.0, 1.0, 200))
    command = ("analyse", "mine.csv", "--config", "euler_hk", "--columns", COLUMNS, "--plot", "--out", "pictures")
    said = cli(*command, "--json")
    found = said.json()
    assert (said.code, said.err) == (0, "")
    assert (found["command"], found["file"], found["rows"]) == ("analyse", "mine.csv", 200)
    assert found["max_error"] == pytest.approx(1e-6, rel=1e-6)
    assert found["files"] == [f"pictures/analyse_euler_hk_mine.{suffix}" for suffix in ("png", "pdf", "parquet")]
    drawn = pq.read_table(found["files"][-1])
    np.testing.assert_allclose(drawn.column("t").to_numpy(), t, rtol=1e-15)
    assert drawn.column("error").to_numpy()[-1] == found["end_error"]
    assert all(Path(file).is_file() for file in found["files"])
    plain = cli(*command)
    assert plain.err.splitlines() == [f"wrote {file}" for file in found["files"]]
    assert "the first row" in plain.out


def test_what_the_tables_leave_out_is_said(cli: Callable[..., Any]) -> None:
    spin("mine.csv", np.append(np.full(20, 1.3), 1e4))
    said = cli("analyse", "mine.csv", "--config", "euler_hk", "--columns", COLUMNS, "--set", "top.A=3")
    assert said.code == 0
    assert "mine.csv" in said.out.splitlines()[0]
    cli("run", "euler_gamma", "--set", "N=50", "--name", "euler_gamma", "--quiet")
    said = cli("analyse", "results/euler_gamma/series.parquet", "--config", "euler_hk")
    assert said.err == "not read: gamma1, gamma2, gamma3; the config's initial state has no such components\n"
    cli("run", "heavy_rk4", "--set", "N=50", "--name", "heavy_rk4", "--quiet", "--format", "csv")
    lines = Path("results/heavy_rk4/series.csv").read_text().splitlines()
    names = lines[0].split(",")
    cells = lines[-1].split(",")
    cells[names.index("omega2")] = "1e5"
    Path("left.csv").write_text("\n".join([*lines[:-1], ",".join(cells), ""]))
    said = cli("analyse", "left.csv", "--config", "heavy_rk4")
    t = cells[names.index("t")]
    assert said.err == f"warning: left.csv: far off its energy surface at row 51 (t = {float(t):.6g})\n"


def test_a_missing_reference_is_said_and_shown(cli: Callable[..., Any]) -> None:
    Path("far.csv").write_text("t,omega1,omega2,omega3\n0,0,0,1.3\n1e12,0,0,1.3\n")
    said = cli("analyse", "far.csv", "--config", "euler_hk")
    assert said.code == 0
    assert said.err.startswith("warning: no error: the reference would need at least 5e+11 Taylor steps ")
    shown = {line[:18].strip(): line[18:].strip() for line in said.out.splitlines()}
    assert (shown["reference from"], shown["max error"], shown["error at the end"]) == ("none", "–", "–")


def test_errors_have_one_line_and_write_nothing(cli: Callable[..., Any]) -> None:
    spin("mine.csv", np.full(5, 1.3))
    for more, words in (
        ((), "mine.csv: no columns t, omega1, omega2, omega3; known: time, w_x, w_y, w_z; --columns t=COLUMN names it"),
        (("--columns", f"{COLUMNS},omega4=x"), "unknown name 'omega4'; did you mean"),
        (("--columns", COLUMNS, "--steps", "0"), "'--steps'"),
        (("--columns", COLUMNS, "--config", "euler_ensemble"), "ensemble"),
    ):
        said = cli("analyse", "mine.csv", "--config", "euler_hk", *more, "--plot")
        assert said.code == 2
        assert said.out == ""
        assert words in said.err
        assert said.err.startswith("error: ")
        assert len(said.err.splitlines()) == 1
    assert not [path for path in Path("results").rglob("*") if path.is_file()]
