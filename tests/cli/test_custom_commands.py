"""A top declared in fifteen lines of YAML under every command that takes a config."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from custom_tops import VOLTERRA, Y0
from topcli.store.series import read_series

pytestmark = pytest.mark.slow

SWEEP = """\
base: v.yaml
grid: {top.k: [0.0, 0.5], scheme: [hk, rk4], h: [0.01, 0.02]}
measure: [max_error, max_deviation.energy, max.w3, swings]
"""


@pytest.fixture
def config(in_tmp: Path) -> Path:
    path = in_tmp / "v.yaml"
    path.write_text(VOLTERRA)
    assert len(VOLTERRA.splitlines()) == 15
    return path


def exact(t: float, k: float = 0.3) -> np.ndarray:
    """State at t by an integration of equations written here."""

    def rates(_, w):
        return [(w[1] * w[2] - k * w[1]) / 3.0, (-2.0 * w[2] * w[0] + k * w[0]) / 2.0, w[0] * w[1]]

    return solve_ivp(rates, (0.0, t), Y0, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


def test_runs_and_comparisons_agree_with_an_independent_integration(cli, config: Path) -> None:
    schemes = ["hk", "midpoint", "rk4"]
    found = cli("compare", *schemes, "--config", "v.yaml", "--json").json()["tables"]
    assert [scheme["scheme"] for scheme in found[0]["rows"]] == schemes
    for scheme in found[0]["rows"]:
        name = scheme["scheme"]
        assert cli("run", "v.yaml", "--set", f"scheme={name}", "--set", f"name={name}").code == 0
        series = read_series(Path("results") / scheme["scheme"] / "series.parquet")
        last = np.array([series[name][-1] for name in ("w1", "w2", "w3")])
        error = np.linalg.norm(last - exact(4.0))
        assert scheme["final_error"] == pytest.approx(error, rel=1e-3)
    assert next(row["verdict"] for row in found[3]["rows"] if row["scheme"] == "midpoint") == "exact"


def test_sweeps_tables_pictures_and_pages(cli, config: Path) -> None:
    Path("s.yaml").write_text(SWEEP)
    assert cli("sweep", "s.yaml").code == 0
    assert (
        "0.02"
        in cli(
            "table", "results/s", "--rows", "h", "--columns", "scheme", "--value", "max_error", "--where", "top.k=0.5"
        ).out
    )
    assert (
        cli("plot", "sweep", "results/s", "--x", "h", "--y", "max_error", "--by", "scheme", "--where", "top.k=0.5").code
        == 0
    )
    row = cli("show", "results/s", "--row", "3", "--json").json()["config"]
    Path("row.yaml").write_text(json.dumps(row))
    assert cli("run", "row.yaml").code == 0
    assert cli("run", "v.yaml").code == 0
    assert cli("report", "results/v", "results/s", "--out", "page.html").code == 0
    page = Path("page.html").read_text()
    assert "custom top of w1, w2, w3" in page
    assert "((B - C)*w2*w3 - k*w2)/A" in page


def test_a_series_of_another_program(cli, config: Path) -> None:
    t = np.linspace(0.0, 4.0, 41)
    rows = np.array([[time, *exact(time)] if time else [0.0, *Y0] for time in t])
    np.savetxt("other.csv", rows, delimiter=",", header="t,w1,w2,w3", comments="")
    found = cli("analyse", "other.csv", "--config", "v.yaml", "--json")
    assert found.code == 0
    figures = {row["figure"]: row["value"] for row in found.json()["tables"][0]["rows"]}
    assert figures["max error"] < 1e-11


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("run my_rotor.yaml --set scheme=exact", "my_rotor"),
        ("run my_rotor.yaml --name brief -v", ""),
        ("compare rk4 --config my_rotor.yaml --reference exact", "my_rotor"),
        ("stress rk4 --config my_rotor.yaml", "my_rotor"),
        ("show my_rotor.yaml --motion", ""),
        ("sweep s.yaml --set grid.scheme=[exact]", ""),
    ],
)
def test_messages_call_a_top_by_the_name_of_its_config(cli, config: Path, command: str, name: str) -> None:
    config.rename("my_rotor.yaml")
    Path("s.yaml").write_text(SWEEP.replace("v.yaml", "my_rotor.yaml"))
    said = cli(*command.split())
    assert not re.search("custom-[0-9a-f]{8}", said.out + said.err)
    assert name in (said.out + said.err).replace("--config my_rotor.yaml", "")
