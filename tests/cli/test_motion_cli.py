"""``topcli show --motion``: the text and the JSON show the numbers of ``topcli.motion``; what it refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable

import pytest

import topcli
from conftest import ROOT, Said

SCENE = "kowalevski_generic_hk"


@pytest.mark.slow
def test_every_cell_is_the_value_of_the_field(cli: Callable[..., Said]) -> None:
    text = cli("show", SCENE, "--motion").out
    data = cli("show", SCENE, "--motion", "--json").json()
    found = topcli.motion(SCENE)
    assert data["motion"] == json.loads(json.dumps(found.as_dict()))
    assert data["config"]["name"] == SCENE
    rows = {line.split()[0]: line.split() for line in text.partition("\n\n")[0].splitlines()[2:]}
    for name, value in data["motion"]["quantities"].items():
        assert float(rows[name][1]) == pytest.approx(value, rel=1e-9)
    listed = [line.split() for line in text.splitlines() if line.endswith(" separatrix")]
    assert [(cells[0], float(cells[1]), float(cells[2])) for cells in listed] == [
        (one["along"], pytest.approx(one["value"], rel=1e-9), pytest.approx(one["distance"], rel=1e-5))
        for one in data["motion"]["neighbours"]
    ]
    assert len({float(cells[1]) for cells in listed}) == 3
    assert text.startswith(f"{SCENE}: {found.title}\n")


@pytest.mark.slow
@pytest.mark.parametrize("option", [(), ("--motion",)])
def test_only_the_option_imports_the_closed_forms(option: tuple[str, ...]) -> None:
    code = (
        "import atexit, sys\n"
        f"sys.argv = ['topcli', 'show', {SCENE!r}, *{option!r}]\n"
        "atexit.register(lambda: print('\\n'.join(sys.modules)))\n"
        "from topcli.__main__ import main\nmain()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {"mpmath", "topcli.analysis.motion.of_top"} & set(done.stdout.split())
    assert len(loaded) == (2 if option else 0)
    assert not {"matplotlib", "pandas"} & set(done.stdout.split())


def test_infinite_periods_are_shown(cli: Callable[..., Said]) -> None:
    arguments = ("show", "euler_tennis_racket", "--motion", "--set", "top.A=6", "--set", "top.B=4", "--set", "top.C=3")
    arguments += ("--set", "initial.omega=[0.5, 0.25, 1]")
    text = cli(*arguments).out
    assert any(line.split()[:2] == ["period", "∞"] for line in text.splitlines())
    assert cli(*arguments, "--json").json()["motion"]["quantities"]["period"] is None


def test_a_heavy_top_says_that_it_has_no_closed_form(cli: Callable[..., Said]) -> None:
    text = cli("show", "heavy_chaotic", "--motion").out
    assert text.splitlines()[0] == "heavy_chaotic: no closed form is known for a top with these parameters"
    assert [line.split()[0] for line in text.splitlines()[2:]] == ["gamma_sq", "m_gamma", "energy"]


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("kowalevski_ensemble", "this is an ensemble of 1000 trajectories, and a single one is needed here"),
        (str(ROOT / "configs" / "sweeps" / "heavy_drift.yaml"), "this is a sweep, and an experiment is needed here"),
        (".", "--motion: needs a single experiment, not a sweep"),
    ],
)
def test_ensembles_and_sweeps_are_refused(cli: Callable[..., Said], source: str, message: str) -> None:
    done = cli("show", source, "--motion")
    assert (done.code, done.out) == (2, "")
    assert message in done.err
    assert len(done.err.splitlines()) <= 2
