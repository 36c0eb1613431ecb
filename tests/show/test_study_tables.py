"""Tables of all studies: in one block at 80 columns, and with the same content in every format."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

import topcli
from conftest import Said
from topcli.cli.output import PIPE_WIDTH, table_lines
from topcli.errors import UsageError
from topcli.show.report import StudyReport
from topcli.show.tables import tables_of
from topcli.studies import STUDIES
from topcli.table import Cells, Table, escaped, latex_text, number

Cli = Callable[..., Said]
SCHEMES = ("hk", "rk4", "bohlin-a", "hybrid", "hk+kahan-li6", "hk-projected")
CASES: dict[str, Callable[[], StudyReport]] = {
    "order": lambda: topcli.order(*SCHEMES, steps=300),
    "stress": lambda: topcli.stress(*SCHEMES[:4], top="kowalevski", cases=["pole", "huge", "delone", "resonance"]),
    "claims": lambda: topcli.claims(["hk-heavy-equation", "hybrid-reversible", "hybrid-k-sq", "bohlin-angle"]),
    "lax": lambda: topcli.lax("kowalevski", *SCHEMES[:4], "backlund", overrides=["N=40"]),
    "roundoff": lambda: topcli.roundoff("hk", "euler_hk", steps=300, copies=2),
    "lyapunov": lambda: topcli.lyapunov("kowalevski_hk", spectrum=True, overrides=["N=2000", "h=0.05"]),
    "frequencies": lambda: topcli.frequencies("kowalevski_generic_hk", angle=["gamma1,gamma2"], overrides=["N=2000"]),
    "integrability": lambda: topcli.integrability("euler"),
    "check": lambda: topcli.check(schemes=["dg4"], top="kowalevski"),
    "compare": lambda: topcli.compare(*SCHEMES, config="kowalevski_generic_hk", overrides=["N=300"]),
    "analyse": lambda: topcli.analyse(
        topcli.run("kowalevski_generic_hk", "results", overrides=["N=300"], progress=False).folder / "series.parquet",
        "kowalevski_generic_hk",
    ),
}
"""A result of each study that is as wide as usual ones."""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], StudyReport]:
    folder = tmp_path_factory.mktemp("studies")

    @cache
    def of(name: str) -> StudyReport:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            return CASES[name]()

    return of


def printed(report: StudyReport, verbose: bool) -> list[Table | str]:
    return list(report.declaration.printed_of(report.result, verbose))


def lines_of(cells: Cells, width: int) -> list[str]:
    right = range(1, len(cells.header)) if cells.numbers is True else cells.numbers or ()
    return table_lines(cells.header, cells.lines, right, width, keys=cells.keys)


def test_every_study_has_a_case() -> None:
    assert set(CASES) == set(STUDIES)


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_the_answer_comes_first_and_each_table_is_one_block(name: str, results: Callable[[str], StudyReport]) -> None:
    report = results(name)
    data = report.study
    if not report.result.of or name != "claims":  # named claims are printed one by one
        first, *parts = printed(report, verbose=False)
        if answer := report.declaration.answer(data):
            assert first == answer
        else:
            parts = [first, *parts]
        for table in [part for part in parts if isinstance(part, Table)]:
            assert "" not in lines_of(table.cells(data, detail=False), PIPE_WIDTH), table.name


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_every_table_has_the_same_cells_in_every_format(name: str, results: Callable[[str], StudyReport]) -> None:
    report = results(name)
    data = report.study
    tables = tables_of(report.declaration, data)
    for table in tables.named.values():
        cells = table.cells(data)
        if not cells.lines:
            continue
        shown = [line for line in table.text(data, "markdown").splitlines() if line.startswith("| ")]
        assert len(shown) == len(cells.lines) + 2
        if "|" not in str(cells.lines):
            assert [part.strip() for part in shown[-1].strip("|").split("|")] == [
                one.strip() for one in cells.lines[-1]
            ]
        latex = table.text(data, "latex")
        assert latex.count(r"\\") == len(cells.lines) + bool(cells.header)
        assert " & ".join(map(latex_text, cells.lines[-1])) + r" \\" in latex
        frame = table.frame(data)
        rows = list(csv.reader(io.StringIO(table.text(data, "csv"))))
        assert len(rows) == len(frame) + 1
        assert rows[0] == [*([table.index] if table.index else []), *frame.columns]
        for row, values in zip(rows[1:], frame.to_numpy().tolist(), strict=True):
            for text, value in zip(row[len(row) - len(values) :], values, strict=True):
                assert not isinstance(value, float) or value != value or float(text) == value


def test_symbols_and_numbers_are_set_in_mathematics() -> None:
    assert escaped("γ² of 50% & κ₁₂, m·ω") == r"$\gamma^{2}$ of 50\% \& $\kappa_{12}$, m$\cdot\omega$"
    assert latex_text("1.2e-05") == r"$1.2 \times 10^{-5}$"
    assert latex_text("0.57 ± 0.10") == r"$0.57$ $\pm$ $0.10$"
    assert latex_text("a_b") == r"a\_b"


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0009996, 3, "0.001"),
        (0.00123456, 3, "0.00123"),
        (1234.5, 3, "1234"),
        (0.5, 3, "0.5"),
        (123456.0, 3, "1.23e+05"),
        (2.4e-16, 2, "2.4e-16"),
        (0.0, 3, "0"),
        (float("inf"), 3, "inf"),
        (None, 3, "–"),
    ],
)
def test_numbers_have_so_many_significant_digits(value: float | None, digits: int, text: str) -> None:
    assert number(value, digits) == text


@pytest.mark.slow
def test_what_a_study_stores_is_read_by_table_by_path_or_by_name(cli: Cli) -> None:
    command = ("order", "hk", "rk4", "--top", "euler", "--max-steps", "300")
    said = cli(*command, "--save", "results/order.json", "--quiet")
    assert (said.code, said.out) == (0, "")
    shown = cli("table", "order.json").out
    assert "smallest" in shown
    assert "largest error at each h" in shown
    for ending, form in ((".csv", "csv"), (".tex", "latex"), (".md", "markdown")):
        assert cli(*command, "--save", f"orders{ending}", "--quiet").code == 0
        text = Path(f"orders{ending}").read_text(encoding="utf-8")
        assert text == cli("table", "results/order.json", "--format", form).out
    errors = cli("table", "order.json", "--table", "errors", "--format", "csv")
    assert errors.out.splitlines()[0] == "h,hk,rk4"
    assert errors.err == ""
    assert "--table: errors, table" in cli("table", "order.json", "--format", "csv").err
    assert "did you mean 'errors'" in cli("table", "order.json", "--table", "erors").err
    assert cli("table", "order.json", "--rows", "h").code == 2


@pytest.mark.slow
def test_what_a_study_stores_is_drawn_by_plot_by_path_or_by_name(cli: Cli) -> None:
    command = ("order", "hk", "rk4", "--top", "euler", "--max-steps", "300")
    assert cli(*command, "--save", "results/mine.json", "--plot", "--quiet").code == 0
    drawn = {path.name: path.read_bytes() for path in Path("results/figures").glob("*.parquet")}
    assert cli("plot", "mine.json", "--format", "svg", "--out", "again").code == 0
    assert [path.suffix for path in sorted(Path("again").iterdir())] == [".parquet", ".svg"]
    assert {path.name for path in Path("again").glob("*.parquet")} == set(drawn)


@pytest.mark.slow
def test_a_run_has_its_report_as_a_table(cli: Cli) -> None:
    cli("run", "euler_hk", "--set", "N=100", "--set", "name=one", "--quiet")
    report = cli("run", "euler_hk", "--set", "N=100", "--set", "name=one", "--json").json()["runs"][0]
    rows = list(csv.DictReader(io.StringIO(cli("table", "one", "--format", "csv").out)))
    assert [float(row["max_deviation"]) for row in rows] == [one["max_deviation"] for one in report["invariants"]]
    assert re.search(r"conservation laws|invariant", cli("table", "one").out)


@pytest.mark.slow
def test_a_file_that_is_no_result_or_damaged_is_refused(cli: Cli) -> None:
    assert cli("order", "hk", "--max-steps", "100", "--save", "order.json", "--quiet").code == 0
    text = Path("order.json").read_text(encoding="utf-8")
    Path("order.json").write_text(text.replace('"h": 0.5', '"h": 0.25'), encoding="utf-8")
    assert "its SHA-256 differs" in cli("table", "order.json").err
    Path("other.json").write_text('{"a": 1}', encoding="utf-8")
    for place, reason in (("other.json", "not a result of a study"), ("nowhere", "no such file or folder")):
        said = cli("table", place)
        assert said.code == UsageError.exit_code
        assert reason in said.err
