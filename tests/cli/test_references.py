"""Citations, which name works of complete BibTeX, and the pages of the reference, equal to what is declared."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from ruamel.yaml import YAML

from conftest import ROOT
from topcli import __version__
from topcli.config.models import Config, Output
from topcli.figures.catalogue import FIGURES
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import all_schemes, find_scheme, unload_plugin_files
from topcli.studies.citations import bibliography, plain_text, works_in
from topcli.tops import TOPS

NO_WORK = {"scipy.integrate.DOP853"}
"""Clauses of citations that name software."""
REQUIRED = {"article": {"journal", "volume", "year", "pages"}, "book": {"publisher", "year"}, "misc": {"note"}}
MINE = """
import topcli
from topcli.contracts import Stepper


@topcli.scheme("mine", top="euler", title="rest", order=1, explicit=True, self_adjoint=True,
               citation="Private {notes} 2020", equations="y' = y")
def build(top, options):
    '''Nothing moves.'''
    return Stepper(lambda y, h, p: y, 3)
"""


def citations() -> list[str]:
    return sorted({one.citation for one in (*all_schemes(), *TOPS.values(), *COMPOSITIONS.values())})


def keys(bibtex: str) -> list[str]:
    return re.findall(r"^@\w+\{(.+),$", bibtex, re.MULTILINE)


def test_every_clause_of_a_citation_names_a_work() -> None:
    clauses = [clause.strip() for text in citations() for clause in text.split(";")]
    assert [one for one in clauses if not works_in(one) and one not in NO_WORK] == []


def sources() -> str:
    """Sources and pages, without the bibliography and what is generated from citations."""
    files = [*(ROOT / "src").rglob("*.py"), *(ROOT / "docs").glob("*.md")]
    return " ".join(re.sub(r"\s+", " ", one.read_text(encoding="utf-8")) for one in files if one.name != "schemes.md")


@pytest.mark.slow
def test_every_work_is_cited() -> None:
    cited = {entry.key for text in (*citations(), sources()) for entry in works_in(text)}
    assert set(bibliography()) - cited == {"topcli"}


def dated(text: str) -> set[tuple[str, str]]:
    """Authors and years of citations such as "Moser, Veselov 1991" in a clause."""
    name = r"[A-ZÀ-Ö][\w'-]+(?:, [A-ZÀ-Ö][\w'-]+)*"
    return {
        (found[1], found[2]) for found in re.finditer(rf"(?:^|; |after |and |\()({name}),? (1[789]\d\d|20\d\d)\b", text)
    }


def test_years_of_citations_are_those_of_the_bibliography() -> None:
    known = {(entry.surnames, entry.fields.get("year")) for entry in bibliography().values()}
    named = set().union(*map(dated, citations()))
    assert len(named) > 20
    assert named - known == set()
    assert dated("after Cooper 1987; Kahan 1994") == {("Cooper", "1987"), ("Kahan", "1994")}
    assert ("Kahan", "1994") not in known


@pytest.mark.parametrize("key", bibliography())
def test_works_are_complete(key: str) -> None:
    entry = bibliography()[key]
    assert {"author", "title"} | REQUIRED[entry.kind] <= set(entry.fields)
    assert entry.bibtex.count("{") == entry.bibtex.count("}")
    assert entry.bibtex.isascii()
    assert not set("{}\\") & set(entry.text)
    assert keys(entry.bibtex) == [key]


def test_a_work_is_named_by_all_its_authors() -> None:
    assert [entry.key for entry in works_in("after Hairer 2000")] == ["hairer2000"]
    assert [entry.key for entry in works_in("Hairer, Lubich, Wanner, Geometric Numerical Integration")] == [
        "hairer2006"
    ]
    assert works_in("Somebody, Hairer 2000") == []
    assert works_in("Hairer 2001") == []
    assert works_in("Yoshida, Phys. Lett. A 150 (1991) 262") == []
    assert plain_text(r"{B{\"a}cklund} {\`A} {\o} 1--2") == "Bäcklund À ø 1–2"


def test_cite_prints_the_works_of_a_scheme_in_its_order(cli) -> None:
    hk = keys(cli("cite", "HK").out)
    assert hk == ["kahan1993", "hirota2000", "celledoni2013", "petrera2011", "sogo", "kimura2000"]
    assert keys(cli("cite", "backlund+kahan-li8").out) == ["kuznetsov2000", "bobenko1989", "kahan1997"]
    assert keys(cli("cite", "kowalevski").out) == ["kowalevski1889", "sogo"]
    assert keys(cli("cite", "suzuki4").out) == ["suzuki1990"]
    both = keys(cli("cite", "kowalevski", "hk").out)
    assert both == ["kowalevski1889", "sogo", *hk[:-2], "kimura2000"]
    assert "title = {Discretization of the {Euler} top}," in cli("cite", "hk").out


def test_cite_alone_cites_topcli_and_the_paper(cli) -> None:
    """As the file for GitHub does; the paper has no year in either: its manuscript bears no date."""
    printed = cli("cite").out
    assert keys(printed) == ["topcli", "sogo"]
    assert f"version = {{{__version__}}}," in printed
    file = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    works = bibliography()
    assert (file["title"], file["version"]) == (plain_text(works["topcli"].fields["title"]), __version__)
    (paper,) = file["references"]
    assert paper["title"].replace("--", "–") == plain_text(works["sogo"].fields["title"])
    assert works["sogo"].surnames == paper["authors"][0]["family-names"]
    assert "year" not in {*paper, *works["sogo"].fields}


def test_cite_as_json(cli) -> None:
    data = json.loads(cli("cite", "midpoint4", "--json").out)
    assert [entry["key"] for entry in data["entries"]] == ["dahlby2011", "cooper1987"]
    assert all(entry["bibtex"].startswith("@article{") for entry in data["entries"])


def test_a_plugin_is_cited_by_its_own_words(cli, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    request.addfinalizer(unload_plugin_files)
    (tmp_path / "mine.py").write_text(MINE)
    printed = cli("cite", "mine", "--plugin", str(tmp_path / "mine.py")).out
    assert printed == "@misc{mine,\n  note = {Private notes 2020},\n}\n"


# the generated pages of the reference


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        import reference_pages
    finally:
        sys.path.pop(0)
    return reference_pages


@pytest.fixture(scope="module")
def made(maker: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reference")
    maker.write_pages(folder)
    return folder


def text(folder: Path, name: str) -> str:
    return (folder / f"{name}.md").read_text(encoding="utf-8")


def rows(page: str) -> dict[str, list[str]]:
    """Cells of all rows of tables by their first cell."""
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in page.splitlines() if line[:1] == "|"]
    return {row[0].strip(): row[1:] for row in cells}


def test_types_of_keys_are_in_words(maker: ModuleType) -> None:
    assert maker.keys_of(Output)[1][:3] == ("`every`", "whole number ≥ 1, ≤ 1e+12", "`1`")
    assert maker.table(("a", "b"), [("x|y", "z")])[2] == r"| x\|y | z |"


def test_wide_formulas_are_broken_at_gaps(maker: ModuleType) -> None:
    rows = sys.modules["descriptor_pages"].rows_of
    assert rows(r"a = b, \qquad c = d") == r"a = b, \qquad c = d"
    part = "a" * 30
    broken = rows(rf"{part}, \qquad {part}, \qquad b")
    assert broken.splitlines() == [r"\begin{gathered}", rf"{part},\\[4pt]", rf"{part}, \qquad b", r"\end{gathered}"]
    made = r"\begin{aligned}" + part + r"\\" + part + r"\end{aligned}"
    assert rows(made) == made


@pytest.mark.slow
def test_there_is_a_page_for_each_scheme_and_top(made: Path) -> None:
    assert {path.stem for path in (made / "schemes").glob("*.md")} == {one.name for one in all_schemes()}
    assert len(list((made / "tops").glob("*.md"))) == len(TOPS)
    for name in {one.name for one in all_schemes()}:
        page = text(made, f"schemes/{name}")
        for scheme in (one for one in all_schemes() if one.name == name):
            assert all(part.strip() in page for part in re.split(r", \\qquad|\n\n", scheme.formula))
            assert all(limit in page for limit in scheme.limits.values())
            assert all(f"| `{key}` |" in page for key in scheme.options.model_fields)
        assert page.count("$$") % 2 == 0


@pytest.mark.slow
def test_properties_are_those_declared(made: Path) -> None:
    found = rows(text(made, "schemes/hk"))
    tops = sorted(one.top for one in all_schemes() if one.name == "hk")
    assert [re.sub(r"\[(.*)\].*", r"\1", cell) for cell in found[""]] == tops
    assert (found["order"], found["self-adjoint"]) == (["2"] * len(tops), ["yes"] * len(tops))
    hk = {key: dict(zip(tops, cells, strict=True)) for key, cells in found.items() if len(cells) == len(tops)}
    assert hk["conserves exactly"]["lagrange"] == r"$m\cdot e_3$"
    assert hk["conserves exactly"]["kowalevski"] == "nothing"
    assert hk["not exactly"]["kowalevski"] == r"$\gamma^2$, $2\ell$, $E$, $k^2$"
    assert r"\kappa_{12}" in hk["in modified form"]["euler"]
    bohlin = rows(text(made, "schemes/bohlin-a"))
    assert (bohlin["order"], bohlin["self-adjoint"], bohlin["step"]) == (["1"], ["no"], ["explicit"])
    assert (bohlin["conserves exactly"], bohlin["not exactly"]) == ([r"$\gamma^2$, $k^2$"], [r"$2\ell$, $E$"])


@pytest.mark.slow
def test_a_page_shows_the_bibtex_that_cite_prints(made: Path, cli) -> None:
    for page, name in (("schemes/midpoint4", "midpoint4"), ("tops/lagrange-inertial", "lagrange/inertial")):
        assert cli("cite", name).out in text(made, page)


@pytest.mark.slow
def test_tops_list_their_schemes_parameters_and_integrals(made: Path) -> None:
    page = text(made, "tops/heavy")
    found = rows(page)
    assert {f"[`{one.name}`](../schemes/{one.name}.md)" for one in all_schemes() if one.top == "heavy"} <= set(found)
    assert found["`B`"][:2] == ["number > 0", "`1.5`"]
    assert found["$m\\cdot\\gamma$"][0] == "`m_gamma`"
    assert r"J\dot\omega = J\omega\times\omega + \gamma\times r" in page


@pytest.mark.slow
def test_the_table_of_integrable_maps_is_that_of_the_registry(made: Path) -> None:
    page = text(made, "integrable")
    declared = [one for one in all_schemes() if one.integrable]
    assert page.count("\n| [`") == len(declared) > 5
    (line,) = (line for line in page.splitlines() if line.startswith("| [`backlund`]"))
    assert "Kuznetsov, Vanhaecke 2000; Bobenko, Reyman, Semenov-Tian-Shansky 1989" in line
    assert "Lie-Poisson bracket of e(3)" in line
    assert "we know of no earlier one" in page
    assert "the first" not in page


@pytest.mark.slow
def test_every_key_of_a_config_is_listed(made: Path) -> None:
    found = rows(text(made, "config"))
    assert {f"`{name}`" for name in Config.model_fields} <= set(found)
    assert found["`every`"][:2] == ["whole number ≥ 1, ≤ 1e+12", "`1`"]
    assert found["`format`"][:2] == ["`parquet` or `csv`", "`parquet`"]
    assert found["`h`"][1] == "required"
    assert found["`output`"][1] == "see below"


@pytest.mark.slow
def test_the_gallery_has_every_figure_with_its_command(made: Path) -> None:
    page = text(made, "gallery")
    assert re.findall(r"^topcli plot (\S+)$", page, re.MULTILINE) == list(FIGURES)
    assert all(f"## {name}\n\n{figure.title}.\n" in page for name, figure in FIGURES.items())
    assert all((made / name).is_file() for name in re.findall(r"\]\((\S+\.png)\)", page))
    assert "](fig1.png)" in page


@pytest.mark.slow
def test_pages_are_written_only_if_they_change(maker: ModuleType, made: Path) -> None:
    page, stale = made / "schemes" / "hk.md", made / "schemes" / "gone.md"
    os.utime(page, (1.0, 1.0))
    stale.write_text("# Gone\n", encoding="utf-8")
    maker.write_pages(made)
    assert page.stat().st_mtime == 1.0
    assert not stale.exists()
    page.write_text("changed", encoding="utf-8")
    maker.write_pages(made)
    assert find_scheme("hk", "heavy").title in page.read_text(encoding="utf-8")
