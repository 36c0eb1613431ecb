"""Tables of studies in files: CSV with all digits, and names that are refused."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import Said

ORDER = ("order", "hk", "rk4", "--top", "euler", "--max-steps", "300")


@pytest.fixture
def saved(cli: Callable[..., Said], in_tmp: Path) -> Callable[..., dict[str, str]]:
    """Files that a command writes with ``--save``, by their names."""

    def call(*command: str) -> dict[str, str]:
        said = cli(*command, "-q")
        assert (said.code, said.err) == (0, "")
        return {path.name: path.read_text() for path in in_tmp.iterdir() if path.is_file()}

    return call


def records(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines()))


def test_csv_has_all_digits(cli: Callable[..., Said], saved: Callable[..., dict[str, str]]) -> None:
    schemes = cli(*ORDER, "--json").json()["schemes"]
    files = saved(*ORDER, "--save", "mine.csv")
    assert set(files) == {"mine.csv", "mine_errors.csv"}
    for row, scheme in zip(records(files["mine.csv"]), schemes, strict=True):
        assert row["scheme"] == scheme["scheme"]
        assert float(row["order"]) == scheme["order"]
    errors = {
        (name, float(row["h"])): float(row[name])
        for row in records(files["mine_errors.csv"])
        for name in ("hk", "rk4")
        if row[name]
    }
    assert errors == {(row["scheme"], point["h"]): point["error"] for row in schemes for point in row["points"]}


def test_another_ending_is_refused_before_anything_is_measured(cli: Callable[..., Said]) -> None:
    said = cli("roundoff", "hk", "--steps", "1e11", "--save", "mine.xlsx")
    message = "error: --save mine.xlsx: unknown type of file; use a name ending in .json, .csv, .md or .tex\n"
    assert (said.code, said.err) == (2, message)


def test_no_file_of_a_set_replaces_another(cli: Callable[..., Said], in_tmp: Path) -> None:
    (in_tmp / "mine_errors.csv").write_text("mine")
    said = cli(*ORDER, "--save", "mine.csv", "-q")
    assert (said.code, said.out) == (2, "")
    assert "--save mine_errors.csv: exists already" in said.err
    assert not (in_tmp / "mine.csv").exists()
