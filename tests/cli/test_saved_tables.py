"""Tables of studies in files: CSV with all digits, Markdown and LaTeX as on a terminal."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import Said
from topcli.table import Cells, latex_text

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


def test_comparisons_and_hard_cases_are_rows_of_csv(
    cli: Callable[..., Said], saved: Callable[..., dict[str, str]]
) -> None:
    command = ("compare", "hk", "rk4", "--set", "T=1", "--set", "h=0.01")
    rows = records(saved(*command, "--save", "mine.csv")["mine.csv"])
    assert {row["scheme"]: float(row["max_error"]) for row in rows} == {
        row["scheme"]: row["max_error"] for row in cli(*command, "--json").json()["schemes"]
    }
    files = saved("stress", "hk", "--case", "one-step", "--top", "lagrange", "--save", "cases.csv")
    assert {"cases_grid_lagrange.csv", "cases_questions.csv"} < set(files)
    rows = records(files["cases.csv"])
    assert [(row["scheme"], row["case"], row["outcome"]) for row in rows] == [("hk", "one-step", "held")]


def test_markdown_and_latex_have_the_cells_of_the_terminal(
    cli: Callable[..., Said], saved: Callable[..., dict[str, str]]
) -> None:
    (scheme,) = cli("order", "rk4", "--top", "euler", "--max-steps", "300", "--json").json()["schemes"]
    smallest = min(point["error"] for point in scheme["points"])
    mantissa, _, power = f"{smallest:.1e}".partition("e")
    files = saved("order", "rk4", "--top", "euler", "--max-steps", "300", "--save", "mine.md")
    row = next(line for line in files["mine.md"].splitlines() if line.startswith("| rk4 |"))
    assert f"{smallest:.1e}" in row
    assert f"| {scheme['order']:.2f} |" in row
    text = saved("order", "rk4", "--top", "euler", "--max-steps", "300", "--save", "mine.tex")["mine.tex"]
    assert rf"${mantissa} \times 10^{{{int(power)}}}$" in text
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 2
    for part in re.findall(r"\\begin\{tabular\}\{(\w+)\}(.*?)\\end", text, re.DOTALL):
        lines = [line for line in part[1].splitlines() if line.endswith(r"\\")]
        assert {line.count("&") + 1 for line in lines} == {len(part[0])}


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        ("1.5e-06 to 2", r"$1.5 \times 10^{-6}$ to $2$"),
        ("-0.25 ± 1e-9", r"$-0.25$ $\pm$ $1 \times 10^{-9}$"),
        ("2l", "2l"),
        ("m_gamma 50 %", r"m\_gamma $50$ \%"),
        ("γ²", r"$\gamma^{2}$"),
        ("hk:h=0.02", r"hk:h=$0.02$"),
        ("–", "--"),
    ],
)
def test_numbers_and_signs_in_latex(text: str, latex: str) -> None:
    assert latex_text(text) == latex


def test_a_latex_table_aligns_numbers_to_the_right() -> None:
    cells = Cells("", ["name", "x"], [["a_b", "1e-3"]], "A note")
    assert cells.latex("A title") == [
        r"% needs \usepackage{booktabs}",
        r"\begin{table}",
        r"\centering",
        r"\caption{A title. A note.}",
        r"\begin{tabular}{lr}",
        r"\toprule",
        r"name & x \\",
        r"\midrule",
        r"a\_b & $1 \times 10^{-3}$ \\",
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]


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
