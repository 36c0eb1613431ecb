"""Tops that ``@topcli.top`` registers: what the declaration must be, and what the top then has."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import topcli
from cases import changes_of
from scheme_files import loaded_file
from topcli.contracts import Stepper
from topcli.errors import UsageError
from topcli.plugins import load_plugin_file
from topcli.schemes.registry import SchemeMisfitError, find_scheme, names_for
from topcli.tops import TOPS, top_origin

ROTOR = """import topcli


@topcli.top
class Rotor(topcli.Top):
    kind = "rotor"
    components = ("w1", "w2", "w3")
    A: float = 3.0
    B: float = 2.0
    C: float = 1.0

    def field(y, p):
        A, B, C = p
        w1, w2, w3 = y
        return ((B - C) * w2 * w3 / A, (C - A) * w3 * w1 / B, (A - B) * w1 * w2 / C)

    integrals = {
        "energy": lambda y, p: p[0] * y[0] ** 2 + p[1] * y[1] ** 2 + p[2] * y[2] ** 2,
    }
    symbols = {}
    holds_on = {}
"""
FAULTS = changes_of("own_tops.txt")


def loaded(folder: Path, text: str) -> None:
    """Load a file with this text."""
    path = folder / "rotor.py"
    path.write_text(text)
    load_plugin_file(path)


@pytest.mark.usefixtures("own_registry")
@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_a_wrong_declaration_is_named_by_file_and_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert ROTOR.count(old) == 1
    with pytest.raises(UsageError) as raised:
        loaded(tmp_path, ROTOR.replace(old, new))
    (said,) = raised.value.lines
    assert message in said
    assert not message[0].isdigit() or said.startswith(f"{tmp_path}/rotor.py:{message}")
    assert "rotor" not in TOPS


@pytest.mark.usefixtures("own_registry")
def test_the_declaration_itself_is_right(tmp_path: Path) -> None:
    loaded(tmp_path, ROTOR)
    assert {"hk", "midpoint", "rk4"} <= set(names_for("rotor"))
    assert top_origin(TOPS["rotor"]) == str(tmp_path / "rotor.py")


class Declared(topcli.Top):
    """Rotation about two axes."""

    kind = "turning"
    components = ("a", "b")
    rate: float = 2.0

    @staticmethod
    def field(y, p):
        return (p[0] * y[1], -p[0] * y[0])


@pytest.mark.usefixtures("own_registry")
def test_a_top_of_a_script_has_the_schemes_for_every_top() -> None:
    assert topcli.top(Declared) is Declared
    assert top_origin(Declared) == __file__
    assert "hk" in names_for("turning")
    run = topcli.simulate(top="turning", initial={"a": 1.0, "b": 0.0}, scheme="hk", h=0.1, N=1)
    # (1 - i h)/(1 + i h) at h rate / 2 = 0.1, the midpoint rule of a linear field
    assert run.to_pandas()[["a", "b"]].iloc[-1].tolist() == pytest.approx([0.99 / 1.01, -0.2 / 1.01], rel=1e-15)


@pytest.mark.usefixtures("own_registry")
def test_an_own_scheme_replaces_that_for_every_top() -> None:
    """For an own top alone, and once."""
    topcli.top(Declared)

    def own(form: str) -> None:
        @topcli.scheme("rk4", top=form, order=1, explicit=True, self_adjoint=True)
        def build(top, options):
            """mine."""
            return Stepper(lambda y, h, p: y, 2)

    own("turning")
    assert find_scheme("rk4", "turning").title == "mine"
    for form in ("turning", "heavy"):
        with pytest.raises(ValueError, match=f"scheme 'rk4' for top '{form}' is already registered by"):
            own(form)


@pytest.mark.parametrize(
    ("new", "words"),
    [
        ("* w1 * w2 / w3", "scheme 'hk' needs a quadratic field, but this one divides by the state"),
        ("* w1 ** 0.5", "scheme 'hk' needs a quadratic field, but this one takes the power 1/2 of the state"),
        ("* w1 * w2 * w3", "w3' has degree 3"),
    ],
)
def test_a_scheme_that_needs_a_polynomial_names_the_field_that_is_none(tmp_path: Path, new: str, words: str) -> None:
    path = tmp_path / "rotor.py"
    text = re.sub(r"integrals = \{.*?\n    \}", "integrals = {}", ROTOR, flags=re.DOTALL)
    path.write_text(text.replace("* w1 * w2 / C", new))
    with loaded_file(path):
        with pytest.raises(SchemeMisfitError) as raised:
            find_scheme("hk", "rotor")
        assert {"rk2", "rk4", "dop853"} <= set(names_for("rotor"))
    assert f"{words} ({path}:12)" in str(raised.value)
