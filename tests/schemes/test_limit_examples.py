"""Example states that the texts of `limits` name: each can be run, and does what the text says."""

from __future__ import annotations

import re

import pytest

import topcli
from topcli.contracts import Outcome, Scheme
from topcli.errors import RunError
from topcli.schemes.registry import all_schemes

NUMBERS = r"\(([-\d., ]+)\)"
EXAMPLE = re.compile(rf"omega = {NUMBERS},?(?: with| and)? gamma = {NUMBERS}(?: with c0 = ([-\d.]+))?")


def examples() -> list[tuple[Scheme, str, list[float], list[float], float]]:
    """Scheme, name of the limit, omega, gamma and c0 of every state in a text."""
    return [
        (scheme, name, vector(omega), vector(gamma), float(c0 or 1.0))
        for scheme in all_schemes()
        for name, text in scheme.limits.items()
        for omega, gamma, c0 in EXAMPLE.findall(text)
    ]


def vector(numbers: str) -> list[float]:
    return [float(v) for v in numbers.split(",")]


def simulate(scheme: str, omega: list[float], gamma: list[float], c0: float) -> topcli.Trajectory:
    top = {"kind": "kowalevski", "c0": c0}
    return topcli.simulate(
        {"top": top, "initial": {"omega": omega, "gamma": gamma}, "scheme": scheme, "h": 0.01, "N": 10}
    )


def test_every_state_in_a_limit_is_found() -> None:
    """No text names a vector that the examples leave out."""
    vectors = sum(len(re.findall(r"= " + NUMBERS, text)) for one in all_schemes() for text in one.limits.values())
    assert vectors == 2 * len(examples()) > 0


@pytest.mark.parametrize(("scheme", "name", "omega", "gamma", "c0"), examples(), ids=lambda one: str(one)[:20])
def test_states_in_limits_can_be_run(
    scheme: Scheme, name: str, omega: list[float], gamma: list[float], c0: float
) -> None:
    """Legal for every other scheme; those of limits that say "refused" are refused."""
    assert simulate("hk", omega, gamma, c0).outcome is Outcome.COMPLETED
    if "refused" in scheme.limits[name]:
        with pytest.raises(RunError):
            simulate(scheme.name, omega, gamma, c0)
        assert simulate(scheme.name, [omega[0] + 1e-3, *omega[1:]], gamma, c0).outcome is Outcome.COMPLETED
