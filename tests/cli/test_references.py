"""Citations, which name works of complete BibTeX, and the reference, equal to what is declared."""

from __future__ import annotations

import json
import re
import sys
from importlib import import_module
from types import ModuleType

import pytest
from ruamel.yaml import YAML

import topcli
from conftest import ROOT
from topcli import __version__
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import all_schemes
from topcli.studies.cite import bibliography
from topcli.sweeps.measures import MEASURES
from topcli.tops import TOPS

REQUIRED = {"article": {"journal", "volume", "year", "pages"}, "book": {"publisher", "year"}, "misc": {"note"}}


def keys(bibtex: str) -> list[str]:
    return re.findall(r"^@\w+\{(.+),$", bibtex, re.MULTILINE)


def fields(bibtex: str) -> dict[str, str]:
    return dict(re.findall(r"^  (\w+) = \{(.*?)\},$", bibtex, re.MULTILINE | re.DOTALL))


def test_every_scheme_composition_and_top_has_a_work_and_no_work_names_another() -> None:
    declared = {*(scheme.name for scheme in all_schemes()), *(top.kind for top in TOPS.values()), *COMPOSITIONS}
    assert frozenset.union(*(used for _, used in bibliography().values())) - {""} == declared


@pytest.mark.parametrize("key", bibliography())
def test_works_are_complete(key: str) -> None:
    bibtex, _ = bibliography()[key]
    kind, entry = bibtex[1:].partition("{")[0], fields(bibtex)
    assert {"author", "title"} | REQUIRED[kind] <= set(entry)
    assert bibtex.count("{") == bibtex.count("}")
    assert bibtex.isascii()
    assert keys(bibtex) == [key]
    assert ("eprint" in entry) == ("archiveprefix" in entry)
    assert re.fullmatch(r"10\.\d{4}/\S+", entry.get("doi", "10.1000/none"))


def test_cite_prints_the_works_of_a_scheme_a_composition_and_a_top(cli) -> None:
    hk = keys(cli("cite", "HK").out)
    assert hk == ["sogo", "celledoni2013", "hirota2000", "kahan1993", "kimura2000", "petrera2011"]
    assert keys(cli("cite", "backlund+kahan-li8").out) == ["bobenko1989", "kuznetsov2000", "kahan1997"]
    assert keys(cli("cite", "kowalevski", "suzuki4").out) == ["sogo", "kowalevski1889", "suzuki1990"]
    assert keys(cli("cite", "euler+gamma").out) == keys(cli("cite", "euler").out) == ["sogo", "euler1765"]
    assert "title = {Discretization of the {Euler} top}," in cli("cite", "hk").out


def test_cite_alone_cites_topcli_and_the_paper(cli) -> None:
    """As the file for GitHub does; the paper has no year in either: its manuscript bears no date."""
    entries = json.loads(cli("cite", "--json").out)["entries"]
    assert [entry["key"] for entry in entries] == ["topcli", "sogo"]
    own, paper = (fields(entry["bibtex"]) for entry in entries)
    file = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert (own["title"], own["version"]) == (file["title"], __version__) == (file["title"], file["version"])
    (reference,) = file["references"]
    assert re.sub("[{}]", "", paper["title"]) == reference["title"].replace("–", "--")
    assert "year" not in {*reference, *paper}


# the parts of the reference that are generated


@pytest.fixture(scope="module")
def maker() -> ModuleType:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        import reference_pages
    finally:
        sys.path.pop(0)
    return reference_pages


def test_every_public_object_is_documented(maker: ModuleType) -> None:
    page = "\n".join(maker.api_part())
    for name in set(topcli.__all__) - {"__version__"}:
        assert f":: topcli.{name}\n" in page
    for name in re.findall(r":: topcli\.(\S+)", page):
        module, _, last = name.rpartition(".")
        assert getattr(import_module(f"topcli.{module}") if module else topcli, last).__doc__


def test_every_measure_is_listed(maker: ModuleType) -> None:
    page = "\n".join(maker.measures_part())
    assert [name for name in MEASURES if f"| `{name}` |" not in page] == []
