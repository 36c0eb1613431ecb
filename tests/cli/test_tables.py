"""Tables fit the terminal: no line too long, no word broken, every cell there, whatever the command."""

from __future__ import annotations

import re
import sys
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import ROOT
from topcli.cli import output
from topcli.cli.output import table_lines

COMMANDS = [
    "list tops",
    "list schemes",
    "list compositions",
    "list scenes",
    "list cases",
    "list figures",
    "doctor",
    "compare hk hybrid bohlin-a rk4 taylor --set N=40",
    "lax kowalevski hk rk4 --set N=40",
    "lax euler hk --set N=40",
    "run euler_hk --set N=40",
    "run euler_ensemble --set N=40",
    "analyse results/euler_hk/series.parquet --config euler_hk",
    "roundoff hk --config euler_hk --steps 300 --copies 2",
    "order hk rk4 bs --top euler --steps 600",
    "stress rk4 hk --top euler --case spherical --case one-step --case resonance",
]


def words(text: str) -> Counter[str]:
    return Counter(text.split())


@pytest.mark.slow
@pytest.mark.parametrize("width", [60, 80, 120])
@pytest.mark.parametrize("command", COMMANDS)
def test_tables_fit_the_terminal(cli, monkeypatch: pytest.MonkeyPatch, command: str, width: int) -> None:
    """Each table as the command hands it over, against the lines printed for it."""
    if command.startswith("analyse"):
        assert cli("run", "euler_hk", "--set", "N=4000", "--name", "euler_hk", "--quiet").code == 0
    tables = []
    monkeypatch.setattr(output, "screen_width", lambda: width)
    original = output.table_lines

    def record(header, rows, right, limit, **options):
        lines = original(header, rows, right, limit, **options)
        tables.append(([header, *rows], limit, lines))
        return lines

    monkeypatch.setattr(output, "table_lines", record)
    monkeypatch.setattr(output, "_terminal", lambda stream: stream is sys.stdout)
    monkeypatch.setenv("TERM", "xterm")
    said = cli(*command.split())
    assert said.code == 0, said.err
    assert tables
    for table, limit, lines in tables:
        assert limit == width
        assert max(map(len, lines)) <= width
        printed = words("\n".join(lines))
        for row in table:
            for cell in row:
                assert not words(cell) - printed, cell
    assert all(len(line) <= width for line in said.out.splitlines())


def test_a_wide_table_is_split_into_blocks_that_repeat_the_label() -> None:
    rows = [["first row", "1.5e-10", "22", "333"], ["second row", "1", "2", "3"]]
    assert table_lines(["", "column a", "b", "c"], rows, (1, 2, 3), 23) == [
        "             column   b",
        "                  a",
        "first row   1.5e-10  22",
        "second row        1   2",
        "",
        "              c",
        "first row   333",
        "second row    3",
    ]


def test_columns_that_name_a_row_are_repeated_together() -> None:
    rows = [["m²", "plain", "1.5e-10", "22.5"], ["m²", "kept", "2.5e-10", "33.5"]]
    assert table_lines(["", "sums", "drift", "cost"], rows, (2, 3), 20, keys=2) == [
        "    sums     drift",
        "m²  plain  1.5e-10",
        "m²  kept   2.5e-10",
        "",
        "    sums   cost",
        "m²  plain  22.5",
        "m²  kept   33.5",
    ]


def test_prose_is_wrapped_at_words_and_indented_labels_stay_indented() -> None:
    lines = table_lines([], [["  a label", "one two three four five six"], ["x", "y"]], (), 24)
    assert lines == ["  a label  one two three", "           four five six", "x          y"]


@pytest.mark.slow
def test_a_table_elsewhere_than_on_a_terminal_has_whole_lines(cli) -> None:
    out = cli("list", "scenes").out.splitlines()
    scenes = cli("list", "scenes", "--json").json()["scenes"]
    assert len(out) == len(scenes) + 1
    for line, scene in zip(out[1:], scenes, strict=True):
        assert line.split()[:3] == [scene["name"], scene["top"], scene["scheme"]]
        assert line.endswith(scene["about"])


def test_text_is_left_aligned_and_numbers_right_aligned(cli) -> None:
    header, *rows = cli("list", "compositions").out.splitlines()
    for name, right in (("order", True), ("stages", True), ("title", False), ("citation", False)):
        start, end = header.index(name), header.index(name) + len(name)
        for row in rows:
            edge, beyond = (row[end - 1], row[end : end + 1]) if right else (row[start], row[start - 1])
            assert edge != " ", name
            assert beyond in (" ", ""), name


def test_the_table_of_the_readme_is_real(cli) -> None:
    readme = (ROOT / "docs" / "higher-order.md").read_text(encoding="utf-8")
    for line in cli("list", "compositions").out.splitlines():
        assert f"{line}\n" in readme


cells = st.text("abc xyz0123456789.-", max_size=30).map(lambda text: " ".join(text.split()))


@pytest.mark.slow
@given(
    st.integers(1, 8).flatmap(lambda n: st.lists(st.lists(cells, min_size=n, max_size=n), min_size=1, max_size=5)),
    st.integers(20, 130),
    st.integers(1, 3),
)
def test_any_table_keeps_every_character_within_the_width(rows: list[list[str]], width: int, keys: int) -> None:
    lines = table_lines(rows[0], rows, range(1, len(rows[0])), width, keys=keys)
    assert all(len(line) <= width for line in lines)
    letters = Counter(re.sub(r"\s", "", "".join(lines)))
    assert not Counter(re.sub(r"\s", "", "".join(cell for row in [rows[0], *rows] for cell in row))) - letters


def test_measures_of_a_top_are_listed_one_by_one(cli) -> None:
    families = {item["name"] for item in cli("list", "measures", "--json").json()["measures"]}
    assert {"drift.NAME", "swing_spacing", "seconds"} <= families
    items = {item["name"]: item for item in cli("list", "measures", "--top", "kowalevski", "--json").json()["measures"]}
    assert {f"{family}.{name}" for family in ("drift", "deviation") for name in ("gamma_sq", "energy")} <= set(items)
    assert not [name for name in items if "NAME" in name]
    assert items["drift.k_sq"]["summary"] == "fitted slope of k_sq per unit time"
    assert items["drift.k_sq"]["unit"] == "unit of k_sq per time"
    assert items["seconds"]["reproducible"] is False
    assert items["steps"]["of_failed"] is True
