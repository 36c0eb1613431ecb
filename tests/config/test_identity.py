"""Each key of a resolved config, changed in turn, gives another digest, and a run another name."""

from __future__ import annotations

import pytest

from topcli.config.load import load
from topcli.config.models import changed_name, folder_name_fault

RUN = """
top.c0=1.0000000000000002 top.A=3 initial.omega1=2.0000000000000004 initial.gamma=[0,0,1] scheme=rk4 scheme=hk+suzuki4
scheme.compensated=true scheme.project=1 h=0.0010000000000000002 N=50001 output.every=2 output.columns=[t]
output.quantities={a:omega1} output.attitude=quaternion section={component:gamma2} section={component:gamma2,value:1}
precision=40 precision=50
"""
ENSEMBLE = """
ensemble.random.seed=8 ensemble.random.count=5 ensemble.random.omega.near=0.25 ensemble.store=final output.every=2
initial.omega1=1
"""


@pytest.mark.parametrize("keys", [RUN, ENSEMBLE], ids=["run", "ensemble"])
def test_every_key_enters_the_digest_but_name_and_format(keys: str) -> None:
    many = "ensemble={random: {count: 4, seed: 3, gamma: sphere, omega: {near: 0.3}}, store: trajectories}"
    base = [many] if keys is ENSEMBLE else []
    first = load(SCENE, base).digest
    digests = [load(SCENE, [*base, override.replace(":", ": ")]).digest for override in keys.split()]
    assert len({first, *digests}) == len(digests) + 1
    assert load(SCENE, [*base, "name=other", "output.format=csv"]).digest == first


# names of runs: that of the config, with the first digits of the digest if an override changes what is computed

SCENE = "kowalevski_hk"


@pytest.mark.parametrize("override", ["output.format=csv", "h=0.001", "N=50000", "T=50", "scheme={name: HK}"])
def test_an_override_that_changes_nothing_keeps_the_name(override: str) -> None:
    assert load(SCENE, [override], rename=True).name == SCENE


@pytest.mark.parametrize(
    ("scene", "override"), [(SCENE, "output.columns=[t]"), (SCENE, "T=5"), ("euler_ensemble", "h=1")]
)
def test_an_override_that_changes_the_run_changes_its_name(scene: str, override: str) -> None:
    experiment = load(scene, [override], rename=True)
    assert experiment.digest == load(scene, [override]).digest
    assert experiment.name == experiment.resolved()["name"] == f"{scene}-{experiment.digest[:6]}"


def test_names_that_cannot_be_folders_are_refused() -> None:
    for name in ("console", "a.b", "é (2)", "x+y", "n" * 100):
        assert not folder_name_fault(name)
        assert not folder_name_fault(changed_name(name, "0123456789abcdef"))
    for name in ("figures", "x.", "x ", " x", "..", "-x", "a\tb", "a:b", "a/b", "", "n" * 101):
        assert folder_name_fault(name)
