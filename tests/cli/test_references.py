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

import topcli
from conftest import ROOT
from topcli import __version__
from topcli.cli.app import all_commands
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
    """Sources and pages, without the bibliography."""
    files = [*(ROOT / "src").rglob("*.py"), *(ROOT / "docs").glob("*.md")]
    return " ".join(re.sub(r"\s+", " ", one.read_text(encoding="utf-8")) for one in files)


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


def test_addresses_of_a_work_are_those_of_its_bibtex() -> None:
    works = bibliography()
    assert works["bellon1999"].addresses == {
        "doi:10.1007/s002200050652": "https://doi.org/10.1007/s002200050652",
        "arXiv:chao-dyn/9805006": "https://arxiv.org/abs/chao-dyn/9805006",
    }
    assert set(works["hairer2006dmv"].addresses.values()) == {works["hairer2006dmv"].fields["url"]}
    assert works["kahan1993"].addresses == {}
    for one in works.values():
        assert ("eprint" in one.fields) == ("archiveprefix" in one.fields)
        assert re.fullmatch(r"10\.\d{4}/\S+", one.fields.get("doi", "10.1000/none"))
        assert all(name in one.text for name in one.addresses)


def test_a_work_is_named_by_its_words() -> None:
    assert [entry.key for entry in works_in("after Hairer 2000")] == ["hairer2000"]
    assert [entry.key for entry in works_in("Kimura, Hirota 2000; Kahan 1993")] == ["kimura2000", "kahan1993"]
    assert works_in("Hairer 2001") == []
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


def test_the_page_of_commands_has_all_options(made: Path) -> None:
    """Each option with its help, its default and its bounds."""
    page = text(made, "parts/commands")
    sections = dict(re.findall(r"^#{3,4} topcli ([^\n]+)\n(.*?)(?=^##|\Z)", page, re.MULTILINE | re.DOTALL))
    contexts = all_commands()
    assert list(sections) == list(contexts)
    for name, context in contexts.items():
        shown = {cell.strip("`").split(" ")[0].strip(","): rest for cell, rest in rows(sections[name]).items()}
        for parameter in context.command.params:
            if parameter.param_type_name != "option" or "--plugin" in parameter.opts:
                continue
            first = min(parameter.opts, key=len)
            meaning, extra = shown[first]
            assert meaning.replace("`", "").replace("\\", "").strip() == parameter.help
            assert ("repeatable" in extra) == parameter.multiple
            if isinstance(parameter.show_default, str):
                assert parameter.show_default in extra.replace("\\", "").replace("`", "")
    assert "[default" not in page
    assert "\n--" not in page.replace("| ---", "")


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
            assert all(part.strip() in page for part in re.split(r",\s*\\q?quad|\n\n", scheme.formula))
            assert all(limit in page for limit in scheme.limits.values())
            assert all(f"| `{key}` |" in page for key in scheme.options.model_fields)
            assert f"`{scheme.top}`" in page
            assert all(part in page for part in scheme.doc.replace("``", "`").split("\n\n"))
        assert page.count("$$") % 2 == 0
        assert f"```{{index}} ! {name}," in page


@pytest.mark.parametrize(
    ("title", "names"),
    [
        (
            "Hirota-Kimura scheme (Kahan's method)",
            ["Hirota-Kimura", "Hirota Kimura", "Kahan's method", "Kahan method", "Kahan"],
        ),
        ("Classical Runge-Kutta method", ["Runge-Kutta", "Runge Kutta"]),
        ("Closed-form solution of the Hirota-Kimura map", []),
    ],
)
def test_the_search_finds_a_scheme_by_its_authors(maker: ModuleType, title: str, names: list[str]) -> None:
    found = dict.fromkeys(sys.modules["descriptor_pages"].search_names(title))
    assert list(found) == [title, *names]


def test_every_symbol_of_a_formula_is_defined(maker: ModuleType) -> None:
    """``symbols_of`` raises KeyError for a symbol without a meaning; each row shows a symbol of the formula."""
    pages = sys.modules["descriptor_pages"]
    for name, schemes in pages.grouped().items():
        for tops, formula in pages.distinct(schemes, {one.top: one.formula for one in schemes}):
            assert pages.symbols_of(formula, name, tops.partition(",")[0]), name
    for top in TOPS.values():
        assert pages.symbols_of(top.formula, top=top.form)
    assert pages.symbols_of(r"\dot y = f(y)") == [
        ("y", pages.symbols_of("y")[0][1]),
        ("f", r"right-hand side of the equations of motion, $\dot y = f(y)$"),
    ]
    with pytest.raises(KeyError, match=r"no meaning of \\+chi in"):
        pages.symbols_of(r"y' = y + h\,\chi_1(y)")


def test_every_symbol_with_a_meaning_occurs(maker: ModuleType) -> None:
    pages, symbols = sys.modules["descriptor_pages"], sys.modules["symbols"]
    used = set()
    for name, schemes in pages.grouped().items():
        for tops, formula in pages.distinct(schemes, {one.top: one.formula for one in schemes}):
            first = tops.partition(",")[0]
            used |= {(name, first if (name, first) in symbols.OWN else ""), ("", "")}
            shown = {symbol for symbol, _ in pages.symbols_of(formula, name, first)}
            own = symbols.OWN.get((name, first)) or symbols.OWN.get((name, ""), {})
            assert {f"{key}i" if key.endswith("_") else key.rstrip("^(") for key in own} <= shown, name
    assert set(symbols.OWN) <= used | {("", form) for form in TOPS}


@pytest.mark.slow
def test_properties_are_those_declared(made: Path) -> None:
    tops = sorted(one.top for one in all_schemes() if one.name == "hk")
    found = rows(text(made, "schemes/hk"))
    assert (found["order"], found["self-adjoint"]) == (["2"], ["yes"])
    lines = text(made, "schemes/hk").splitlines()
    head = next(line for line in lines if line.startswith("| top |")).strip("| ").split(" | ")[1:]
    hk = {top: dict(zip(head, found[f"`{top}`"], strict=True)) for top in tops}
    assert hk["lagrange"]["conserved exactly"] == r"$m\cdot e_3$"
    assert hk["kowalevski"]["conserved exactly"] == "nothing"
    assert hk["kowalevski"]["not conserved exactly"] == r"$\gamma^2$, $2\ell$, $E$, $k^2$"
    assert r"\kappa_{12}" in hk["euler"]["conserved in modified form"]
    bohlin = rows(text(made, "schemes/bohlin-a"))
    assert (bohlin["order"], bohlin["self-adjoint"], bohlin["step"]) == (["1"], ["no"], ["explicit"])
    assert bohlin["conserved exactly"] == [r"$\gamma^2$, $k^2$"]
    assert bohlin["not conserved exactly"] == [r"$2\ell$, $E$"]


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
    found = rows(text(made, "parts/config"))
    assert {f"`{name}`" for name in Config.model_fields} <= set(found)
    assert found["`every`"][:2] == ["whole number ≥ 1, ≤ 1e+12", "`1`"]
    assert found["`format`"][:2] == ["`parquet` or `csv`", "`parquet`"]
    assert found["`h`"][1] == "required"
    assert found["`output`"][1] == "see below"


@pytest.mark.slow
def test_the_gallery_has_every_figure_with_its_page_and_command(made: Path) -> None:
    page = text(made, "parts/gallery")
    assert re.findall(r"\[\*\*(.+?)\*\*\]\(reference/figures/\1\.md\) (.+)", page) == [
        (name, figure.title) for name, figure in FIGURES.items()
    ]
    thumbnails = re.findall(r"\]\(reference/(figures/\S+\.small\.png)\)", page)
    assert "figures/fig1.small.png" in thumbnails
    assert all((made / name).is_file() for name in thumbnails)
    for name, figure in FIGURES.items():
        shown = text(made, f"figures/{name}")
        assert f"\ntopcli plot {name}\n" in shown
        assert figure.title in shown
        assert (f"]({name}.png)" in shown) == (made / "figures" / f"{name}.png").is_file()


@pytest.mark.slow
def test_the_bibliography_lists_all_works_and_marks_those_not_checked(made: Path) -> None:
    page = text(made, "parts/bibliography")
    assert re.findall(r"^\(work-(.+)\)=$", page, re.MULTILINE) == [
        one.key for one in sorted(bibliography().values(), key=lambda one: (one.surnames, one.fields.get("year", "")))
    ]
    marked = [key for key in bibliography() if "**Not checked" in page.split(f"(work-{key})=")[1].split("(work-")[0]]
    assert marked == [key for key, one in bibliography().items() if "not checked" in str(one.fields).lower()]
    assert "`hk`" in page.split("(work-kahan1993)=")[1].split("(work-")[0]
    for one in bibliography().values():
        shown = page.split(f"(work-{one.key})=")[1].split("(work-")[0]
        for name, address in one.addresses.items():
            assert shown.count(f"[{name}]({address})") == 1
            assert shown.count(name) == (2 if name == address else 1), "not repeated outside its link"


@pytest.mark.slow
def test_names_in_code_lead_to_pages_that_exist(maker: ModuleType, made: Path) -> None:
    found = maker.named_pages("schemes")
    assert {one.name for one in all_schemes()} | set(TOPS) | {"topcli.run", "topcli.contracts.Stepper"} <= set(found)
    assert all((made / f"{page.removeprefix('reference/')}.md").is_file() for page in found.values())
    assert set(found) - set(maker.named_pages("reports")) == {"exact"}  # a verdict there


@pytest.mark.slow
def test_every_public_object_has_a_page(made: Path) -> None:
    page = text(made, "parts/api")
    for name in set(topcli.__all__) - {"__version__"}:
        assert f"[`topcli.{name}`](reference/api/" in page
    for file in re.findall(r"reference/(api/.+?)\.md", page):
        assert "{eval-rst}" in text(made, file)
    assert len({path.name.lower() for path in (made / "api").iterdir()}) == len(list((made / "api").iterdir()))


@pytest.mark.slow
def test_files_of_the_root_are_pages_whose_links_lead_somewhere(made: Path) -> None:
    for name, first in (("changelog", "# Changelog"), ("contributing", "# Contributing to topcli")):
        page = text(made, name)
        assert page.startswith(first)
        for target in re.findall(r"\]\(([^)#:]+)", page):
            assert (ROOT / "docs" / "reference" / target).resolve().is_file(), target
    assert "\n- numba>=" in text(made, "parts/requirements")


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
