"""Citations, which name works of complete BibTeX, and the reference, equal to what is declared."""

from __future__ import annotations

import json
import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest
from ruamel.yaml import YAML

import topcli
from conftest import ROOT
from topcli import __version__
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import all_schemes
from topcli.studies.citations import bibliography, plain_text, works_in
from topcli.sweeps.measures import MEASURES
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
    assert works["kahan1993"].addresses == {}
    for one in works.values():
        assert ("eprint" in one.fields) == ("archiveprefix" in one.fields)
        assert re.fullmatch(r"10\.\d{4}/\S+", one.fields.get("doi", "10.1000/none"))
        assert all(name in one.text for name in one.addresses)


def test_a_work_is_named_by_its_words() -> None:
    assert [entry.key for entry in works_in("after Cooper 1987")] == ["cooper1987"]
    assert [entry.key for entry in works_in("Kimura, Hirota 2000; Kahan 1993")] == ["kimura2000", "kahan1993"]
    assert works_in("Cooper 1988") == []
    assert plain_text(r"{B{\"a}cklund} {\`A} {\o} 1--2") == "Bäcklund À ø 1–2"


def test_cite_prints_the_works_of_a_scheme_in_its_order(cli) -> None:
    hk = keys(cli("cite", "HK").out)
    assert hk == ["kahan1993", "hirota2000", "kimura2000", "petrera2011", "celledoni2013", "sogo"]
    assert keys(cli("cite", "backlund+kahan-li8").out) == ["kuznetsov2000", "bobenko1989", "kahan1997"]
    assert keys(cli("cite", "kowalevski").out) == ["kowalevski1889", "sogo"]
    assert keys(cli("cite", "suzuki4").out) == ["suzuki1990"]
    both = keys(cli("cite", "kowalevski", "hk").out)
    assert both == ["kowalevski1889", "sogo", *hk[:-1]]
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
    data = json.loads(cli("cite", "dmv", "--json").out)
    assert [entry["key"] for entry in data["entries"]] == ["moser1991", "mclachlan1995", "mclachlan2005"]
    assert all(entry["bibtex"].startswith("@article{") for entry in data["entries"])


def test_a_plugin_is_cited_by_its_own_words(cli, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    printed = cli("cite", "mine", "--plugin", str(tmp_path / "mine.py")).out
    assert printed == "@misc{mine,\n  note = {Private notes 2020},\n}\n"


# the parts of the reference that are generated


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        import reference_pages
    finally:
        sys.path.pop(0)
    return reference_pages


def rows(page: str) -> dict[str, list[str]]:
    """Cells of all rows of tables by their first cell."""
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in page.splitlines() if line[:1] == "|"]
    return {row[0].strip(): row[1:] for row in cells}


def sections(page: str) -> dict[str, str]:
    """Text of each section by its heading."""
    return dict(re.findall(r"^#{2,4} ([^\n]+)\n(.*?)(?=^##|\Z)", page, re.MULTILINE | re.DOTALL))


def test_every_public_object_is_documented(maker: ModuleType) -> None:
    page = "\n".join(maker.api_part())
    for name in set(topcli.__all__) - {"__version__"}:
        assert f":: topcli.{name}\n" in page
    for name in re.findall(r":: topcli\.(\S+)", page):
        module, _, last = name.rpartition(".")
        assert getattr(import_module(f"topcli.{module}") if module else topcli, last).__doc__


def test_every_measure_is_listed(maker: ModuleType) -> None:
    assert {f"`{name}`" for name in MEASURES} <= set(rows("\n".join(maker.measures_part())))
