"""``topcli stress`` and its kin at the command line: what is printed and stored, and how it leaves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from conftest import ROOT
from shown import cells_of, cells_under
from topcli.errors import RunError
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import MadeFigure, NothingMeasuredError, Request, make_figure
from topcli.schemes import registry
from topcli.schemes.registry import all_schemes
from topcli.studies.scheme_page import schemes_page
from topcli.studies.stress.cases import CASES
from topcli.studies.stress.study import stored_stress, stress, stress_data, stress_source, write_stress

SCHEME = '''
import topcli
from topcli.contracts import Stepper

def step(s, h, p):
    return (s[0] * s[0] + 2.0, s[1], s[2], s[3], s[4], s[5])

def make(name, **traits):
    @topcli.scheme(name, top="kowalevski", title="squares", order=1, explicit=True, self_adjoint=False,
                   citation="none", equations="none", **traits)
    def build(top, options):
        """Squares."""
        return Stepper(step, 6)

make("explodes")
make("explodes-and-says-so", limits={"delone": "It squares.", "far beyond": "It squares."})
'''
MODEST = '''
import topcli
from topcli.contracts import Stepper
from topcli.schemes.kowalevski.hk import hk_kowalevski

@topcli.scheme("modest", top="kowalevski", title="too modest", order=2, explicit=True, self_adjoint=True,
               citation="none", equations="none", limits={"delone": "It says that it cannot."})
def build(top, options):
    """HK that declares a limit it does not have."""
    return Stepper(hk_kowalevski, 6)
'''


pytestmark = pytest.mark.usefixtures("own_registry")


def test_table_and_json_agree(cli) -> None:
    asked = ("stress", "hk", "DG4", "--top", "kowalevski", "--case", "huge", "--case", "pole")
    said = cli(*asked)
    assert said.code == 0
    assert "broke at step 8" in said.out
    assert "declared limit" in said.out
    assert "3 held" in said.err
    document = json.loads(cli(*asked, "--json").out)
    assert (document["command"], document["schema_version"]) == ("stress", 1)
    assert {
        (one["scheme"], one["case"]): (one["outcome"], one["step"], one["verdict"]) for one in document["trials"]
    } == {
        ("dg4", "pole"): ("held", None, "ok"),
        ("dg4", "huge"): ("broke", 8, "limit"),
        ("hk", "pole"): ("held", None, "ok"),
        ("hk", "huge"): ("held", None, "ok"),
    }
    assert document["trials"][0]["counters"].keys()
    assert document["files"] == []
    assert not Path("results").exists()


@pytest.mark.slow
def test_grid_shows_several_schemes(cli) -> None:
    asked = ("stress", "--top", "euler", "--case", "spherical", "--case", "one-step", "--case", "backwards")
    said = cli(*asked, "--verbose")
    trials = cli(*asked, "--json").json()["trials"]
    assert (said.code, len(trials) > 40) == (0, True)
    header, *lines = said.out.splitlines()
    for line, one in zip(lines, trials, strict=True):
        outcome = one["outcome"] if one["step"] is None else f"{one['outcome']} at step {one['step']}"
        assert cells_under(header, line)[:4] == [one["scheme"], one["top"], one["case"], outcome]
    grid = cli("stress", "rk2", "rk4", "hk", "midpoint", "--top", "euler", "--case", "resonance", "--case", "huge",
               "--case", "denormal", "--case", "one-step", "--case", "backwards", "--case", "spherical")  # fmt: skip
    assert grid.code == 0
    assert "· held   o degraded   X broke" in grid.out
    (numbers,) = {line.strip() for line in grid.out.splitlines() if "1=" in line}
    at = {case: int(number) for number, case in (one.split("=") for one in numbers.split(", "))}
    first, *rows = grid.out.splitlines()[: grid.out.splitlines().index("")]
    marks = {cells_of(row)[0]: cells_under(first, row) for row in rows if cells_of(row)[0] in ("rk2", "rk4", "hk")}
    broken = {name: {case for case, number in at.items() if cells[number] == "X"} for name, cells in marks.items()}
    assert broken == {"rk2": {"resonance"}, "rk4": {"resonance"}, "hk": set()}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["dg5"], "did you mean 'dg4'?"),
        (["--case", "dleone"], "did you mean 'delone'?"),
        (["--top", "kovalevski"], "did you mean 'kowalevski'?"),
        (["bs", "--case", "delone"], "none of the schemes bs has one of the cases"),
        (["hk-exact", "--top", "kowalevski"], "it fits euler"),
        (["hk", "--set", "h=3"], "scheme.KEY=VALUE"),
        (["hybrid", "--set", "scheme.brunch=sign"], "did you mean 'branch'?"),
        (["hybrid", "--case", "pole", "--set", "scheme.branch=odd"], "nearest"),
        (["--case", "sleeping", "--top", "euler"], "no such case for euler"),
        (["hk+suzuki5"], "did you mean 'suzuki4'?"),
    ],
)
def test_wrong_usage_of_stress_is_refused(cli, arguments: list[str], message: str) -> None:
    said = cli("stress", *arguments)
    assert said.code == 2
    assert message in said.err
    assert len(said.err.strip().splitlines()) <= 2


def test_undeclared_break_exits_with_4(cli) -> None:
    Path("mine.py").write_text(SCHEME)
    said = cli("stress", "explodes", "explodes-and-says-so", "--case", "delone", "--scheme-file", "mine.py")
    assert said.code == 4
    assert "UNEXPLAINED" in said.out
    assert said.err.count("error:") == 1
    assert "error: explodes (kowalevski), case delone: breaks without a declared limit: blew up at step" in said.err
    assert cli("stress", "explodes-and-says-so", "--case", "delone", "--scheme-file", "mine.py").code == 0


def test_outdated_limit_exits_with_4(cli) -> None:
    Path("mine.py").write_text(MODEST)
    said = cli("stress", "modest", "--case", "delone", "--scheme-file", "mine.py")
    assert said.code == 4
    assert "holds in a case declared as its limit" in said.err


@pytest.mark.slow
def test_options_and_compositions(cli) -> None:
    """Options and compositions are those of the trial: its order and its error tell."""

    def tried(*arguments: str) -> tuple[int, str, dict[str, float]]:
        said = cli("stress", *arguments, "--json")
        (one,) = said.json()["trials"]
        return said.code, f"{one['outcome']}, {one['verdict']}", one["figures"]

    code, said, figures = tried("bohlin-b", "--case", "pole")
    assert (code, said, figures["order"]) == (0, "held, ok", pytest.approx(1.0, abs=0.02))
    code, said, figures = tried("bohlin-b", "--case", "pole", "--set", "scheme.chart=single")
    assert (code, said) == (4, "broke, unexplained")
    code, said, figures = tried("hk+suzuki4", "--case", "torus-e4")
    assert (code, said, figures["order"]) == (0, "held, ok", pytest.approx(4.0, abs=0.02))
    assert figures["error"] == pytest.approx(4.4e-10, rel=0.02)


def test_limits_are_shown(cli) -> None:
    said = cli("show", "dg4")
    assert said.code == 0
    assert "`singular-step`: The iteration starts from HK" in said.out
    shown = json.loads(cli("show", "midpoint", "--json").out)["schemes"]
    assert {one["top"] for one in shown} >= {"euler", "heavy", "kowalevski"}
    assert "singular-step" in next(one for one in shown if one["top"] == "heavy")["limits"]
    assert "limits: none known" in cli("show", "dop853").out
    listed = json.loads(cli("list", "schemes", "--json").out)["schemes"]
    assert next(one for one in listed if one["name"] == "bohlin-c")["limits"].keys() >= {"rest-on-axis"}
    cases = json.loads(cli("list", "cases", "--json").out)["cases"]
    assert len(cases) == len(CASES)


def test_the_page_of_the_schemes_is_up_to_date(cli) -> None:
    page = (ROOT / "docs" / "schemes.md").read_text(encoding="utf-8")
    assert page == schemes_page(), "make it again: topcli list schemes --markdown > docs/schemes.md"
    assert cli("list", "schemes", "--markdown").out == page
    for scheme in all_schemes():
        if scheme.origin == "topcli":
            assert f"## {scheme.name} (" in page
            assert scheme.citation in page
            assert all(text in page for text in scheme.limits.values())


# what is stored, and the picture


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> dict:
    return stress_data(stress(["hk", "rk4", "hybrid"], ["branch-point", "resonance", "denormal"]))


def test_the_study_is_stored_whole(study: dict, tmp_path: Path) -> None:
    assert stored_stress(tmp_path) is None
    path = write_stress(study, tmp_path, "abc")
    again = stored_stress(tmp_path)
    assert again is not None
    assert again["trials"] == study["trials"]
    assert again["source"] == "abc"
    assert [entry.name for entry in path.parent.iterdir()] == ["stress.json"]
    path.write_text(path.read_text()[:-100])
    with pytest.raises(RunError, match="run topcli stress again"):
        stored_stress(tmp_path)


@pytest.mark.slow
def test_the_stored_study_is_drawn_and_not_run_again(
    study: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from PIL import Image

    def never(**options: object) -> None:
        raise AssertionError("run again")

    def made(**options: bool) -> MadeFigure:
        return make_figure(FIGURES["stress"], Request(tmp_path, **options), tmp_path / "figures", ["png"])

    monkeypatch.setattr("topcli.studies.stress.study.stress", never)
    with pytest.raises(NothingMeasuredError, match=r"no stress study in .*; topcli plot stress makes one"):
        made(stored_only=True)
    write_stress(study, tmp_path, stress_source())
    assert made(stored_only=True).status == "drawn"
    assert made().status == "up to date"
    assert made(stored_only=True, force=True).status == "drawn"
    with pytest.raises(AssertionError, match="run again"):
        made(force=True)
    with Image.open(tmp_path / "figures" / "stress.png") as image:
        pixels = np.asarray(image.convert("L"), dtype=float)
    assert (pixels[:3] > 250).all()
    grey = [round(255.0 * value) for value in (0.91, 0.70, 0.21)]
    assert all((np.abs(pixels - value) < 8).mean() > 0.005 for value in grey)  # all three outcomes, apart in grey
    table = pq.read_table(tmp_path / "figures" / "stress.parquet")
    names = json.loads(table.schema.metadata[b"topcli.names"])
    outcomes = [names["outcome"][int(value)] for value in table.column("outcome").to_numpy()]
    assert outcomes == [one["outcome"] for one in study["trials"]]
    write_stress(study, tmp_path, "other code")
    with pytest.raises(NothingMeasuredError, match="only a stress study of other code"):
        made(stored_only=True)
    with pytest.raises(AssertionError, match="run again"):
        made()


def test_the_source_of_the_study_does_not_depend_on_the_order_of_imports() -> None:
    """Schemes are imported when a config first names them; the stored study stays up to date whichever came first."""
    before = stress_source()
    schemes = registry.registry.schemes
    entry = next(iter(schemes))
    schemes[entry] = schemes.pop(entry)
    assert stress_source() == before
