"""The reference of compared errors: the same for runs and ensembles, and named alike by every output."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import topcli
from reading_html import read_html
from topcli.errors import UsageError

FREE = {"top": {"kind": "euler", "A": 3.0, "B": 2.0, "C": 1.0}, "initial": {"omega": [0.3, 0.4, 1.5]}}
RUN = {**FREE, "name": "free", "scheme": "hk", "h": 0.1, "N": 300}
ENSEMBLE = {**RUN, "ensemble": {"states": [{"omega": [0.3, 0.4, 1.5]}]}}
NAMES = {"taylor": "Taylor series in double-double arithmetic", "exact": "closed form (scheme exact)"}


@pytest.mark.parametrize("kind", NAMES)
def test_an_ensemble_of_one_has_the_errors_of_the_run(kind: str) -> None:
    """The scheme ``exact`` differs from the series, and not from itself, so that it shows which reference was used."""
    run = topcli.compare("hk", "exact", config=RUN, reference=kind, progress=False)
    many = topcli.compare("hk", "exact", config=ENSEMBLE, reference=kind, progress=False)
    assert run.figures["reference"]["kind"] == many.figures["reference"]["kind"] == kind
    assert run.figures["reference"]["method"] == many.figures["reference"]["method"] == NAMES[kind]
    for one, other in zip(run.figures["schemes"], many.figures["schemes"], strict=True):
        assert other["measures"]["error.max"]["median"] == one["max_error"]
        assert other["measures"]["error.end"]["median"] == one["end_error"]
    itself = run.figures["schemes"][1]["max_error"]
    assert (itself <= 2.0**-53) == (kind == "exact")  # row 0 is the initial state itself
    assert itself < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMES)
@pytest.mark.parametrize("config", [RUN, ENSEMBLE], ids=["run", "ensemble"])
def test_every_output_names_the_reference_that_was_used(
    cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, config: dict[str, Any], kind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("free.json").write_text(json.dumps({key: one for key, one in config.items() if key != "name"}))
    Path("free.yaml").write_text(Path("free.json").read_text())
    command = ("compare", "hk", "--config", "free.yaml", "--reference", kind)
    wanted = f"Errors are norms of the difference of states from the {NAMES[kind]}."
    said = cli(*command, "--save", "saved.json")
    assert said.code == 0
    assert said.out.splitlines()[-1] == wanted
    stored = json.loads(Path("saved.json").read_text())["reference"]
    assert (stored["kind"], stored["method"]) == (kind, NAMES[kind])
    assert cli(*command, "--json").json()["reference"] == stored
    assert cli("report", "saved.json", "--out", "page.html").code == 0
    topcli.compare("hk", config=config, reference=kind, progress=False).save("python.html")
    for page in ("page.html", "python.html"):
        text = Path(page).read_text()
        assert wanted in [one.text for one in read_html(text).with_class("caption")]
        assert NAMES["exact" if kind == "taylor" else "taylor"] not in text


def test_a_closed_form_that_a_top_does_not_have_is_refused(cli: Callable[..., Any]) -> None:
    random = "ensemble={random: {count: 2, gamma: sphere}}"
    for more in ((), ("--set", random)):
        said = cli("compare", "hk", "--config", "heavy_hk", "--set", "N=10", *more, "--reference", "exact")
        assert (said.code, said.out) == (2, "")
        assert "the top heavy has no scheme exact to compare with; use the reference taylor" in said.err
    with pytest.raises(UsageError, match="unknown reference 'theta'; use taylor or exact"):
        topcli.compare("hk", config=ENSEMBLE, reference="theta")


def test_a_top_that_the_series_cannot_follow_has_no_errors_in_an_ensemble(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its closed form is not used instead; the rest is measured."""
    monkeypatch.setattr("topcli.studies.compare_ensemble.reference_obstacle", lambda top: "other equations")
    found = topcli.compare("hk", config=ENSEMBLE, progress=False).figures
    assert found["reference"] is None
    measures = found["schemes"][0]["measures"]
    assert not [name for name in measures if name.startswith("error")]
    assert measures["deviation.m_sq"]["count"] == 1
