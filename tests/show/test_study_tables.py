"""What a study stores is read and drawn again, by its path or its name."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

import topcli
from conftest import Said
from topcli.errors import UsageError
from topcli.show.report import StudyReport

Cli = Callable[..., Said]
SCHEMES = ("hk", "rk4", "bohlin-a", "hybrid", "hk+kahan-li6", "midpoint")
CASES: dict[str, Callable[[], StudyReport]] = {
    "order": lambda: topcli.order(*SCHEMES, steps=300),
    "stress": lambda: topcli.stress(*SCHEMES[:4], top="kowalevski", cases=["pole", "huge", "delone", "resonance"]),
    "claims": lambda: topcli.claims(["hk-heavy-equation", "hybrid-reversible", "hybrid-k-sq", "bohlin-angle"]),
    "lax": lambda: topcli.lax("kowalevski", *SCHEMES[:4], "backlund", overrides=["N=40"]),
    "roundoff": lambda: topcli.roundoff("hk", "euler_hk", steps=300, copies=2),
    "lyapunov": lambda: topcli.lyapunov("kowalevski_hk", spectrum=True, overrides=["N=2000", "h=0.05"]),
    "frequencies": lambda: topcli.frequencies("kowalevski_generic_hk", angle=["gamma1,gamma2"], overrides=["N=2000"]),
    "integrability": lambda: topcli.integrability("euler"),
    "check": lambda: topcli.check(schemes=["backlund"], top="kowalevski"),
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
