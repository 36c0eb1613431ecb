"""Tops that a config declares: the same numbers as a class in Python, what is written back, and what is refused."""

from __future__ import annotations

import ast
import builtins
import keyword
from fractions import Fraction
from inspect import get_annotations
from pathlib import Path

import numpy as np
import pytest

import topcli
from cases import changes_of
from custom_tops import SECTION, VOLTERRA, Volterra, config, section
from topcli.config.load import load, load_experiment, packaged_scenes
from topcli.config.sweep import load_sweep
from topcli.engine.loops import interpreted, state_after
from topcli.errors import ConfigError, TopcliError
from topcli.field.polynomial import field_of
from topcli.tops.declared import Custom

FAULTS = changes_of("custom.txt")


def test_a_number_is_a_formula() -> None:
    still = section(field={"w1": 0, "w2": "k*w1 ", "w3": -0.5}, invariants={"w1": "w1"}, components=["w1", "w2", "w3"])
    still["invariants"] = {"first": "w1"}
    top = load_experiment(config(top=still, scheme="rk4")).top
    assert top.field((1.0, 2.0, 3.0), top.constants()) == (0.0, 0.3, -0.5)
    assert top.section()["field"] == {"w1": "0", "w2": "k*w1", "w3": "-0.5"}


@pytest.mark.usefixtures("own_registry")
@pytest.mark.parametrize("scheme", ["hk", "rk4", "dop853", "midpoint", {"name": "hk", "compensated": True}])
def test_the_bits_of_the_same_top_in_python(scheme) -> None:
    topcli.top(Volterra)
    ours = topcli.simulate(config(scheme=scheme))
    theirs = topcli.simulate(config(scheme=scheme, top="volterra-in-python"))
    assert ours.states.tobytes() == theirs.states.tobytes()
    assert ours["momentum"] == pytest.approx(theirs["momentum"], rel=1e-15)
    assert field_of(ours.top) == field_of(theirs.top)


def test_an_edit_of_a_formula_is_another_experiment() -> None:
    field, energy = {**SECTION["field"], "w1": "((B - C)*w2*w3 - k*w2 + 0)/A"}, SECTION["invariants"]["energy"]
    edits = [
        {},
        {"field": field},
        {"invariants": {"energy": energy}},
        {"parameters": {**SECTION["parameters"], "k": 0.31}},
    ]
    experiments = [load_experiment(config(top=section(**edit))) for edit in edits]
    assert len({experiment.digest for experiment in experiments}) == len(edits)
    forms = [experiment.top.form for experiment in experiments]
    assert forms[0] == forms[3]
    assert len(set(forms)) == 3


def test_a_field_of_other_functions() -> None:
    """The pendulum: q' = p, p' = -sin q."""
    pendulum = {
        "kind": "custom",
        "components": ["q", "p"],
        "field": {"q": "p", "p": "-sin(q)"},
        "invariants": {"energy": "p**2/2 - cos(q)"},
    }
    start = {"q": 0.5, "p": 0.0}
    trajectory = topcli.simulate(config(top=pendulum, initial=start, scheme="rk4", N=1000))
    energy = trajectory["p"] ** 2 / 2 - np.cos(trajectory["q"])
    assert trajectory["energy"] == pytest.approx(energy, rel=1e-15)
    assert np.ptp(energy) < 1e-10
    with pytest.raises(TopcliError, match="'hk' does not fit"):
        load(config(top=pendulum, initial=start))
    with pytest.raises(ConfigError, match=r"top.invariants.energy: 'energy' is not an integral of the field: its rate"):
        load(config(top=pendulum | {"invariants": {"energy": "p**2/2 + cos(q)"}}, initial=start, scheme="rk4"))
    precise = topcli.simulate(config(top=pendulum, initial=start, scheme="rk4", N=3, precision=40))
    assert precise["p"] == pytest.approx(trajectory["p"][:4], rel=1e-14)


def test_numbers_of_the_formulas_in_other_precisions() -> None:
    """Fractions: k = 1/3 and 0.1 are exact, and so is the momentum w1 + w2 of w1' = -w2' = 0.1 k w1."""
    top = {
        "kind": "custom",
        "components": ["w1", "w2"],
        "parameters": {"k": 1.0},
        "field": {"w1": "0.1*k*w1", "w2": "-0.1*k*w1"},
        "invariants": {"sum": "0.3*w1 + 3/10*w2"},
    }
    given = config(top=top, initial={"w1": 1, "w2": 2}, scheme="hk", N=1, h=0.1, precision="rational")
    given["top"]["parameters"]["k"] = "1/3"
    experiment = load(given)
    assert experiment.resolved()["top"]["parameters"] == {"k": "1/3"}
    trajectory = topcli.simulate(given)
    kappa = Fraction(1, 10) * Fraction(1, 10) / 3 / 2
    assert trajectory["w1"][1] == float((1 + kappa) / (1 - kappa))
    assert "equal at all 2 rows" in trajectory.invariant_rows()[0].reason


LEVEL = """\
top:
  kind: custom
  components: [w1, w2, w3, g1, g2, g3]
  parameters: {x: 1.0}
  field:
    w1: 3*w2*w3/4
    w2: (-3*w3*w1 + g3*x)/4
    w3: -g2*x
    g1: g2*w3 - g3*w2
    g2: g3*w1 - g1*w3
    g3: g1*w2 - g2*w1
  invariants:
    m_gamma: 4*w1*g1 + 4*w2*g2 + w3*g3
    chaplygin: {value: w3*(w1**2 + w2**2) - x*w1*g3, on: {m_gamma: 0}}
initial: {w1: 1, w2: 0, w3: 0, g1: 0, g2: 0, g3: 1}
scheme: hk
h: 0.01
N: 10
"""


def test_an_invariant_may_hold_on_a_level(tmp_path) -> None:
    path = tmp_path / "level.yaml"
    path.write_text(LEVEL)
    experiment = load(path)
    assert experiment.top.invariants()[1].on == {"m_gamma": 0.0}
    assert experiment.resolved()["top"]["invariants"]["chaplygin"]["on"] == {"m_gamma": 0.0}
    for level in ("", ", on: {m_gamma: 0.1}"):
        path.write_text(LEVEL.replace(", on: {m_gamma: 0}", level))
        with pytest.raises(ConfigError, match=r"level.yaml:14: top.invariants.chaplygin: 'chaplygin' is not an integ"):
            load(path)


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_what_is_refused_names_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "v.yaml"
    assert VOLTERRA.count(old) == 1
    path.write_text(VOLTERRA.replace(old, new))
    with pytest.raises(TopcliError) as error:
        load(path)
    assert f"v.yaml:{message}" in str(error.value)


def test_the_name_alone_is_no_custom_top() -> None:
    with pytest.raises(ConfigError, match=r"top\.components: missing; give it, or body"):
        load(config(top="custom"))
    with pytest.raises(TopcliError, match="a custom top is declared in a config"):
        list(packaged_scenes("custom"))


def damped(law: str, **sections: object) -> dict[str, object]:
    """A rotation at the rate a, whose radius falls unless k is zero; ``sections`` are those of a config or a base."""
    rates = {"x": "a*y", "y": f"-a*x - {law}*y"}
    top = {"kind": "custom", "components": ["x", "y"], "parameters": {"a": 1.0, "k": 0.0}, "field": rates}
    top["invariants"] = {"radius": "x**2 + y**2"}
    return {"top": top, "initial": {"x": 1.0, "y": 0.0}, "scheme": "rk4", "h": 0.1, "N": 10, **sections}


@pytest.mark.parametrize("law", ["k", "abs(k)", "sqrt(k)", "(k + abs(k))", "sin(k)"])
def test_integrals_are_checked_for_every_set_of_parameters(law: str) -> None:
    """Of grids and draws too, however many sets came before that conserve them."""
    fault = r"'radius' is not an integral of the field"
    grid = {"top.a": [1.0 + 0.01 * i for i in range(70)], "top.k": [0.0]}
    measure = ["max_deviation.radius"]
    load({"name": "x", **damped(law, ensemble={"grid": grid})})
    assert len(list(load_sweep({"base": damped(law), "grid": grid, "measure": measure}).groups())) == 70
    with pytest.raises(ConfigError, match=fault):
        load({"name": "x", **damped(law, ensemble={"grid": {"top.k": [0.0, 0.1]}})})
    late = load_sweep({"base": damped(law), "grid": {**grid, "top.k": [0.0, 0.1]}, "measure": measure})
    with pytest.raises(ConfigError, match=fault):
        list(late.groups())
    draws = {"seed": 1, "count": 5, "top.k": {"from": 0.1, "to": 0.2}}
    drawn = load_sweep({"base": damped(law), "random": draws, "measure": measure})
    with pytest.raises(ConfigError, match=fault):
        list(drawn.groups())


NAMES = {*keyword.kwlist, *keyword.softkwlist, *dir(builtins), *dir(Custom), *dir(ast.Name)}
NAMES |= {name for base in Custom.__mro__ for name in get_annotations(base)}
NAMES |= {*"ypcsthnxE", "cls", "self", "math", "fma", "work", "out", "params", "value", "pi", "normalize"}


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("role", ["parameter", "component"])
def test_any_name_works_or_is_refused(role: str) -> None:
    """Words of Python, and names that topcli, pydantic or generated code use themselves."""
    refused, steps = set(), set()
    for name in sorted(NAMES):
        k, u = (name, "u") if role == "parameter" else ("k", name)
        top = {"kind": "custom", "parameters": {k: 0.3}, "components": [u, "v"], "field": {u: "v", "v": f"-{k}*{u}"}}
        whole = {"name": "own", "top": top, "initial": {u: 1.0, "v": 0.2}, "scheme": "hk", "h": 0.1, "N": 5}
        try:
            experiment = load_experiment(whole)
        except ConfigError as error:
            refused.add(name)
            message = str(error)
        else:
            p = np.array(experiment.top.constants())
            y = state_after(interpreted(experiment.method(), 2, len(p)), np.array(experiment.y0), p, experiment.h)
            assert y is not None
            steps.add(tuple(y))
            continue
        assert name in message
        assert "\n" not in message
    assert len(steps) == 1
    assert refused >= set(keyword.kwlist)
    assert not refused & {"self", "y", "p", "c", "s", "math", "fma", "work", "print", "type", "match", "E", "pi"}


def test_refused_parameters_do_not_spoil_the_same_top_with_others() -> None:
    field = {"x": "y/mass", "y": "-x/mass"}
    oscillator = {"kind": "custom", "components": ["x", "y"], "field": field}
    given = {"initial": {"x": 1.0, "y": 0.5}, "scheme": "hk", "h": 0.1, "N": 10}
    with pytest.raises(ConfigError, match="the field divides by zero with mass = 0"):
        load_experiment({**given, "top": {**oscillator, "parameters": {"mass": 0.0}}})
    assert load_experiment({**given, "top": {**oscillator, "parameters": {"mass": 2.0}}}).scheme.name == "hk"
