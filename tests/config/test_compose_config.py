"""Compositions by name: in configs, overrides, the schema, the Python interface and on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import BaseModel, Field

from config_texts import BASE, CONFIGS, write
from json_schema import fits
from kick_turn import KICK_TURN
from topcli.config.load import load_experiment
from topcli.config.schema import config_schema
from topcli.contracts import Stepper, Top
from topcli.schemes import registry
from topcli.studies.entries import entry

HK = CONFIGS / "kowalevski_hk.yaml"


def test_both_spellings_mean_the_same(tmp_path: Path) -> None:
    path = write(tmp_path, BASE)
    first = load_experiment(path, ["scheme=hk+kahan-li8"])
    for text in ("hk+Kahan-Li8", "{name: hk, compose: kahan-li8}", "{name: HK, compose: Kahan-Li8}"):
        assert load_experiment(write(tmp_path, BASE.replace("scheme: hk", f"scheme: {text}"), "x.yaml")) == first
    assert load_experiment(path, ["scheme.compose=kahan-li8"]).digest == first.digest
    assert first.digest != load_experiment(path).digest
    assert first.resolved()["scheme"] == {"name": "hk+kahan-li8", "compensated": False, "project": 0}
    unnamed = {key: value for key, value in first.resolved().items() if key != "name"}
    assert load_experiment(unnamed).name == "kowalevski_hk+kahan_li8"


def test_options_are_the_bases() -> None:
    """A comparison keeps the options of the experiment's own scheme, whichever of the two is composed."""
    options = {"compensated": True, "project": 0}
    scene = load_experiment(HK, ["scheme={name: hk, compose: suzuki4, compensated: true}"])
    assert scene.resolved()["scheme"] == {"name": "hk+suzuki4", **options}
    assert fits(config_schema(), scene.resolved())
    assert entry(scene, "hk").options.model_dump() == options
    assert entry(scene, "HK+Kahan-Li6").options.model_dump() == options


@pytest.mark.parametrize("word", ["a+b", "a"])
def test_the_plus_and_the_key_are_taken(word: str) -> None:
    class Options(BaseModel):
        compose: str = Field(default="x", description="taken")

    with pytest.raises(ValueError, match="is reserved for what topcli does with the steps of a scheme"):

        @registry.scheme(
            word,
            top="kowalevski",
            title="t",
            order=1,
            explicit=True,
            self_adjoint=False,
            citation="c",
            equations="e",
            options=Options if word == "a" else BaseModel,
        )
        def _build(top: Top, options: BaseModel) -> Stepper:
            """Never registered."""
            return KICK_TURN
