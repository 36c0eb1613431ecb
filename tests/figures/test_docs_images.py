"""The pictures of the documentation show what the current code draws."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

from conftest import ROOT
from topcli.schemes.registry import all_schemes
from topcli.studies.stress.trials import chosen

pytestmark = pytest.mark.slow

IMAGES = ROOT / "docs" / "images"


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("draw_images", ROOT / "docs" / "draw_images.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


images = load()
STORED: dict[str, dict] = json.loads((IMAGES / "data.json").read_text(encoding="utf-8"))


def test_every_picture_is_drawn_by_the_target_and_shown_on_a_page() -> None:
    pictures = {path.stem for path in IMAGES.glob("*.png")}
    assert pictures == set(images.PICTURES)
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    text = "".join(path.read_text(encoding="utf-8") for path in pages)
    assert {name for name in pictures if f"images/{name}.png)" in text} == pictures
    assert set(STORED) == pictures - set(images.TIMES)


@pytest.mark.parametrize("name", [name for name in STORED if name != "stress"])
def test_the_data_behind_a_picture_are_those_of_the_code(name: str, tmp_path: Path) -> None:
    data = images.draw(name, tmp_path).with_suffix(".parquet")
    drawn = images.summary(data)
    assert list(drawn) == list(STORED[name])
    for column, row in drawn.items():
        assert row == pytest.approx(STORED[name][column], rel=1e-5), f"{column}: run make docs-images"


def test_the_picture_of_hard_cases_shows_the_declared_limits() -> None:
    """Each scheme that there is, and the cases that it declares to break."""
    schemes, cases = chosen((), (), None)
    names = {(case.form, case.name) for case in cases}
    declared = {
        f"{scheme.name} ({scheme.top})": sorted(case for case in scheme.limits if (scheme.top, case) in names)
        for scheme in schemes
    }
    assert len(schemes) == len(all_schemes())
    assert {name: sorted(broke) for name, broke in STORED["stress"].items()} == declared, "run make docs-images"


def test_the_target_draws_a_picture_and_keeps_what_is_known_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(images, "IMAGES", tmp_path)
    monkeypatch.setattr(images, "SUMMARY", tmp_path / "data.json")
    known = {name: rows for name, rows in STORED.items() if name != "fig1"}
    (tmp_path / "data.json").write_text(json.dumps(known), encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["draw_images.py", "fig1", "--results", str(tmp_path / "results")])
    images.main()
    assert (tmp_path / "data.json").read_text(encoding="utf-8") == (IMAGES / "data.json").read_text(encoding="utf-8")
    assert (tmp_path / "fig1.png").read_bytes()[:4] == b"\x89PNG"
    assert capsys.readouterr().out.strip() == str(tmp_path / "fig1.png")


def test_a_summary_says_when_data_differ(tmp_path: Path) -> None:
    import numpy as np

    from topcli.store.series import write_parquet

    t = np.linspace(0.0, 1.0, 11)
    write_parquet(tmp_path / "a.parquet", {"t": t, "y": np.append(t[1:] ** 2, np.nan)}, {})
    assert images.summary(tmp_path / "a.parquet") == {
        "t": [11, 1.0, pytest.approx(np.sqrt(0.35), rel=1e-4)],
        "y": [10, 1.0, pytest.approx(np.sqrt(2.5333 / 10), rel=1e-4)],
    }
