"""``topcli cite`` and the bibliography: every citation names its works, and every work is complete BibTeX."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from conftest import ROOT
from topcli import __version__
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import all_schemes, unload_scheme_files
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


def texts() -> str:
    """Sources and pages, without the bibliography and what is generated from citations."""
    files = [*(ROOT / "src").rglob("*.py"), *(ROOT / "docs").glob("*.md")]
    return " ".join(re.sub(r"\s+", " ", one.read_text(encoding="utf-8")) for one in files if one.name != "schemes.md")


def test_every_work_is_cited() -> None:
    cited = {entry.key for text in (*citations(), texts()) for entry in works_in(text)}
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
    assert keys(cli("cite", "HK").out) == ["kahan1993", "hirota2000", "petrera2011", "sogo", "kimura2000"]
    assert keys(cli("cite", "backlund+kahan-li8").out) == ["kuznetsov2000", "bobenko1989", "kahan1997"]
    assert keys(cli("cite", "kowalevski").out) == ["kowalevski1889", "sogo"]
    assert keys(cli("cite", "suzuki4").out) == ["suzuki1990"]
    both = keys(cli("cite", "kowalevski", "hk").out)
    assert both == ["kowalevski1889", "sogo", "kahan1993", "hirota2000", "petrera2011", "kimura2000"]
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


def test_cite_suggests_names(cli) -> None:
    for name, suggestion in (("kowalevsky", "kowalevski"), ("bohlin-d", "bohlin-"), ("hk+kahan", "kahan-li")):
        done = cli("cite", name)
        assert (done.code, done.out) == (2, "")
        assert "did you mean '" + suggestion in done.err


def test_a_plugin_is_cited_by_its_own_words(cli, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    request.addfinalizer(unload_scheme_files)
    (tmp_path / "mine.py").write_text(MINE)
    printed = cli("cite", "mine", "--scheme-file", str(tmp_path / "mine.py")).out
    assert printed == "@misc{mine,\n  note = {Private notes 2020},\n}\n"
