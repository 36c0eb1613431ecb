"""The generated pages of the reference: complete, and equal to what the package declares and prints."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from conftest import ROOT
from topcli.config.models import Config, Output
from topcli.figures.catalogue import FIGURES
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.tops import TOPS


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
    assert found["order"] == ["2"] * 5
    assert found["conserves exactly"][tops.index("lagrange")] == r"$m\cdot e_3$"
    assert found["conserves exactly"][tops.index("kowalevski")] == "nothing"
    assert found["not exactly"][tops.index("kowalevski")] == r"$\gamma^2$, $2\ell$, $E$, $k^2$"
    assert r"\kappa_{12}" in found["in modified form"][tops.index("euler")]
    assert found["self-adjoint"] == ["yes"] * 5
    bohlin = rows(text(made, "schemes/bohlin-a"))
    assert (bohlin["order"], bohlin["self-adjoint"], bohlin["step"]) == (["1"], ["no"], ["explicit"])
    assert bohlin["conserves exactly"] == [r"$\gamma^2$, $k^2$"]
    assert bohlin["not exactly"] == [r"$2\ell$, $E$"]
    assert rows(text(made, "schemes/exact"))["order"] == ["exact"] * 5


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
