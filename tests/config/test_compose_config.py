"""Compositions by name: in configs, overrides, the schema, the Python interface and on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict, Field

import topcli
from config_texts import BASE, CONFIGS, write
from json_schema import fits
from kick_turn import KICK_TURN
from topcli.config.load import load_experiment
from topcli.config.schema import config_schema
from topcli.contracts import Stepper, Top
from topcli.schemes import registry
from topcli.studies.entries import under_scheme

HK = CONFIGS / "kowalevski_hk.yaml"


class PaceOptions(BaseModel):
    """An option that is seen in the trajectory."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pace: Literal["plain", "double"] = Field(default="plain", description="how fast")


@pytest.fixture
def with_options(own_registry: None) -> None:
    """A self-adjoint scheme with an option."""

    @registry.scheme(
        "kick-turn",
        top="kowalevski",
        title="Kick and turn",
        order=2,
        explicit=True,
        self_adjoint=True,
        conserves=("gamma_sq",),
        citation="none",
        equations="none",
        options=PaceOptions,
    )
    def _build(top: Top, options: PaceOptions) -> Stepper:
        """A turn between kicks."""
        step = KICK_TURN.step

        def double(s, h, p):
            return step(s, 2.0 * h, p)

        enter, leave = KICK_TURN.enter, KICK_TURN.leave
        return Stepper(step if options.pace == "plain" else double, 7, enter, leave, KICK_TURN.counters)


def test_both_spellings_mean_the_same(tmp_path: Path) -> None:
    base = load_experiment(write(tmp_path, BASE))
    found = [
        load_experiment(write(tmp_path, BASE.replace("scheme: hk", f"scheme: {text}")))
        for text in ("hk+kahan-li8", "{name: hk, compose: kahan-li8}", "{name: HK, compose: Kahan-Li8}")
    ]
    found.append(load_experiment(write(tmp_path, BASE), ["scheme=hk+Kahan-Li8"]))
    found.append(load_experiment(write(tmp_path, BASE), ["scheme.compose=kahan-li8"]))
    assert all(one == found[0] for one in found)
    assert {one.digest for one in found} == {found[0].digest}
    assert found[0].digest != base.digest
    assert found[0].resolved()["scheme"] == {"name": "hk+kahan-li8", "compensated": False, "project": 0}
    again = load_experiment(write(tmp_path, found[0].to_yaml(), "again.yaml"))
    assert again == found[0]
    assert load_experiment(again.resolved()).digest == found[0].digest
    unnamed = {key: value for key, value in found[0].resolved().items() if key != "name"}
    assert load_experiment(unnamed).name == "kowalevski_hk+kahan_li8"


@pytest.mark.slow
@pytest.mark.usefixtures("with_options")
def test_options_are_the_bases() -> None:
    scene = load_experiment(HK, ["scheme={name: kick-turn, compose: suzuki4, pace: double}", "N=10"])
    assert scene.resolved()["scheme"] == {"name": "kick-turn+suzuki4", "pace": "double", "project": 0}
    assert fits(config_schema(), scene.resolved())
    plain, double = (
        topcli.simulate(HK, scheme="kick-turn+suzuki4", N=n, h=h).states[-1] for n, h in ((10, 2e-3), (10, 1e-3))
    )
    assert np.array_equal(topcli.simulate(scene.resolved()).states[-1], plain)
    assert not np.array_equal(plain, double)
    # a comparison keeps the options of the experiment's own scheme, whichever of the two is composed
    assert under_scheme(scene, "kick-turn").options.model_dump() == {"pace": "double", "project": 0}
    assert under_scheme(scene, "Kick-Turn+Kahan-Li6").options.model_dump() == {"pace": "double", "project": 0}
    plain = under_scheme(load_experiment(HK), "kick-turn+suzuki4")
    assert plain.options.model_dump() == {"pace": "plain", "project": 0}


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
