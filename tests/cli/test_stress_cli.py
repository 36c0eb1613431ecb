"""``topcli stress`` and its kin at the command line: what is printed and stored, and how it leaves."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from shown import cells_of
from topcli.store.files import write_study
from topcli.studies.stress.study import FILE
from topcli.studies.stress.trials import stress, stress_data

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
from topcli.schemes.registry import find_scheme

@topcli.scheme("modest", top="kowalevski", title="too modest", order=2, explicit=True, self_adjoint=True,
               citation="none", equations="none", limits={"delone": "It says that it cannot."})
def build(top, options):
    """HK that declares a limit it does not have."""
    hk = find_scheme("hk", "kowalevski")
    return hk.build(top, hk.options())
'''


pytestmark = pytest.mark.usefixtures("own_registry")


def test_trials_are_printed_counted_and_given_as_json(cli) -> None:
    asked = ("stress", "hk", "Hybrid-Sym", "--top", "kowalevski", "--case", "huge", "--case", "pole")
    said = cli(*asked)
    assert said.code == 0
    rows = [cells_of(line)[:4] for line in said.out.splitlines()]
    assert ["hybrid-sym", "kowalevski", "huge", "broke at step 1, declared limit"] in rows
    answer = "4 trials: 3 held, 1 broke; 1 at declared limits; none contradicts what the schemes declare"
    assert said.out.splitlines()[0] == answer
    document = cli(*asked, "--json").json()
    keys = ("scheme", "case", "outcome", "step", "verdict")
    assert [tuple(one[key] for key in keys) for one in document["trials"]] == [
        ("hk", "huge", "held", None, "ok"),
        ("hk", "pole", "held", None, "ok"),
        ("hybrid-sym", "huge", "broke", 1, "limit"),
        ("hybrid-sym", "pole", "held", None, "ok"),
    ]
    assert (document["outcomes"], document["files"]) == ({"held": 3, "broke": 1}, [])
    assert not Path("results").exists()


def test_undeclared_break_exits_with_4(cli) -> None:
    Path("mine.py").write_text(SCHEME)
    said = cli("stress", "explodes", "explodes-and-says-so", "--case", "delone", "--plugin", "mine.py")
    assert said.code == 4
    assert "UNDECLARED" in said.out
    assert said.err.count("error:") == 1
    assert "error: explodes (kowalevski), case delone: breaks without a declared limit: blew up at step" in said.err
    assert cli("stress", "explodes-and-says-so", "--case", "delone", "--plugin", "mine.py").code == 0


def test_outdated_limit_exits_with_4(cli) -> None:
    Path("mine.py").write_text(MODEST)
    said = cli("stress", "modest", "--case", "delone", "--plugin", "mine.py")
    assert said.code == 4
    assert "holds in a case declared as its limit" in said.err


@pytest.mark.slow
def test_options_and_compositions(cli) -> None:
    """Options and compositions are those of the trial: its order and its error tell."""

    def tried(*arguments: str) -> tuple[int, str, dict[str, float]]:
        said = cli("stress", *arguments, "--json")
        (one,) = said.json()["trials"]
        return said.code, f"{one['outcome']}, {one['verdict']}", one["figures"]

    code, said, figures = tried("bohlin-a", "--case", "real-axis")
    assert (code, said, figures["order"]) == (0, "held, ok", pytest.approx(1.0, abs=0.02))
    code, said, figures = tried("bohlin-a", "--case", "real-axis", "--set", "scheme.branch=sign")
    assert (code, said) == (4, "broke, unexplained")
    code, said, figures = tried("hk+suzuki4", "--case", "torus-e4")
    assert (code, said, figures["order"]) == (0, "held, ok", pytest.approx(4.0, abs=0.02))
    assert figures["error"] == pytest.approx(4.4e-10, rel=0.02)


# what is stored


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> dict:
    return stress_data(stress(["hk", "rk4", "hybrid"], ["branch-point", "resonance", "denormal"]))


def test_the_study_is_stored_whole(study: dict, tmp_path: Path) -> None:
    path = write_study(tmp_path / FILE, study)
    assert json.loads(path.read_text(encoding="utf-8"))["trials"] == study["trials"]
    assert [entry.name for entry in path.parent.iterdir()] == ["stress.json"]
