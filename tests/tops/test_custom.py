"""Tops that a config declares: the same numbers as a class in Python, what is written back, and what is refused."""

from __future__ import annotations

import ast
import builtins
import keyword
import pickle
import re
import subprocess
import sys
from fractions import Fraction
from functools import cache
from inspect import get_annotations
from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.mathtext import MathTextParser

import topcli
from custom_tops import SECTION, VOLTERRA, Y0, Volterra, config, section
from json_schema import fits
from topcli.config.load import load, load_experiment
from topcli.config.schema import config_schema
from topcli.config.sweep import load_sweep
from topcli.config.text import parse_yaml
from topcli.contracts import Outcome
from topcli.engine.loops import interpreted, state_after
from topcli.errors import ConfigError, TopcliError
from topcli.field.polynomial import field_of
from topcli.figures.labels import component_symbol
from topcli.runs.plans import trajectory_of
from topcli.schemes.own_tops import top_names
from topcli.schemes.registry import all_schemes, names_for, schemes_of
from topcli.sweeps.compute import compute
from topcli.tops import TOPS
from topcli.tops.declared import Custom

schema_of_configs = cache(config_schema)
OMEGA = "angular_velocity: [w1, w2, w3]\n"


def test_the_section_comes_back_as_it_was_written() -> None:
    experiment = load_experiment(config())
    assert experiment.resolved()["top"] == SECTION
    assert experiment.resolved()["initial"] == {"w1": 0.9, "w2": -0.4, "w3": 1.2}
    again = load(parse_yaml(experiment.to_yaml(), "")[0] | {"name": "again"})
    assert again.digest == experiment.digest
    assert type(again.top) is type(experiment.top)
    copied = pickle.loads(pickle.dumps(experiment.top))
    assert copied == experiment.top
    assert type(copied) is type(experiment.top)


def test_parameters_are_keys_of_the_section_too() -> None:
    first = load_experiment(config(), ["top.k=0.5"])
    second = load_experiment(config(), ["top.parameters.k=0.5"])
    assert first.resolved() == second.resolved()
    assert first.top.constants() == (3.0, 2.0, 1.0, 0.5)
    assert type(first.top) is type(load_experiment(config()).top)


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
    digests = set()
    edits = [
        {},
        {"field": SECTION["field"] | {"w1": "((B - C)*w2*w3 - k*w2 + 0)/A"}},
        {"invariants": {"energy": SECTION["invariants"]["energy"]}},
        {"parameters": SECTION["parameters"] | {"k": 0.31}},
    ]
    for edit in edits:
        experiment = load_experiment(config(top=section(**edit)))
        digests.add(experiment.digest)
    assert len(digests) == len(edits)
    forms = [load_experiment(config(top=section(**edit))).top.form for edit in edits]
    assert forms[0] == forms[3]
    assert len(set(forms)) == 3
    assert all(re.fullmatch("custom-[0-9a-f]{8}", form) for form in forms)


def test_declared_tops_are_not_listed() -> None:
    form = load_experiment(config()).top.form
    assert form not in list(TOPS)
    assert form in TOPS
    assert top_names()[-1] == "custom"
    assert {"hk", "midpoint", "rk2", "rk4", "dop853"} <= set(names_for(form))
    assert [scheme.name for scheme in schemes_of(form)] == names_for(form)
    assert form not in {scheme.top for scheme in all_schemes()}


def test_without_energy_no_motion_is_left() -> None:
    """The field w' = w grows by e^20."""
    grows = {"kind": "custom", "components": ["x"], "field": {"x": "x"}}
    trajectory = topcli.simulate(config(top=grows, initial={"x": 1.0}, scheme="rk4", N=2000))
    assert trajectory.outcome is Outcome.COMPLETED
    assert trajectory["x"][-1] == pytest.approx(np.exp(20.0), rel=1e-8)
    assert trajectory.invariant_rows() == []
    judged = {**grows, "parameters": {"e": 1e-3}, "field": {"x": "e*x"}}
    assert topcli.simulate(config(top=judged, initial={"x": 1.0})).outcome is Outcome.COMPLETED


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
    path.write_text(LEVEL.replace(", on: {m_gamma: 0}", ""))
    with pytest.raises(ConfigError, match=r"level.yaml:14: top.invariants.chaplygin: 'chaplygin' is not an integral"):
        load(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("k*w2)/A", "kk*w2)/A", "6: top.field.w1: column 18: unknown name 'kk'; did you mean 'k'?"),
        ("w3: (A", "w4: (A", "5: top.field: gives no rate of change of w3"),
        ("w3: (A", "w4: (A", "8: top.field.w4: is not a component; known: w1, w2, w3"),
        ("(C*w3 + k)", "(C*w3 - k)", "11: top.invariants.momentum: 'momentum' is not an integral of the field"),
        (", w3: 1.2", "", "12: initial.w3: missing"),
        ("w3: 1.2", "w3: [1.2, 3]", "12: initial.w3: must be a list of 1 numbers (w3), not 2"),
        ("w3: 1.2", "w3: one", "12: initial.w3: w3 must be a number, not the text 'one'"),
        ("w3: 1.2", "w3: .inf", "12: initial.w3: must be a finite number"),
        ("[w1, w2, w3]", "[w1, w2, w 3]", "3: top.components: a name has letters, digits and _"),
        ("[w1, w2, w3]", "[w1, w2, A]", "4: top.parameters.A: 'A' names a component already"),
        ("[w1, w2, w3]", "[w1, w2, w2]", "3: top.components: 'w2' names a component already"),
        ("[w1, w2, w3]", "[w1, w2, t]", "3: top.components: 't' is taken; choose another name for the component"),
        ("[w1, w2, w3]", "[]", "3: top.components: missing; give it, or body for a rigid body"),
        ("[w1, w2, w3]", "w1", "3: top.components: must be a list, not the text 'w1'"),
        ("A: 3.0", "A: 3.0, copy: 1", "4: top.parameters.copy: 'copy' is taken"),
        ("A: 3.0", "A: 3.0, model_k: 1", "4: top.parameters.model_k: 'model_k' is taken"),
        ("A: 3.0", "A: three", "4: top.parameters.A: must be a number, not the text 'three'"),
        ("A: 3.0", "A: 0", "1: top: the field divides by zero with A = 0"),
        ("energy: (A", "w1: (A", "10: top.invariants.w1: 'w1' names a component already"),
        ("invariants:", "invariant:", "9: top.invariant: unknown key; did you mean 'invariants'?"),
        ("kind: custom", "kind: costum", "2: top.kind: unknown top 'costum'; did you mean 'custom'?"),
        ("(A - B)*w1*w2/C", "[1, 2]", "8: top.field.w3: must be a formula such as 2*w1, not a list"),
        ("(A - B)*w1*w2/C", "{value: w1}", "8: top.field.w3: must be a formula such as 2*w1, not a section"),
        ("(A - B)*w1*w2/C", "true", "8: top.field.w3: must be a formula such as 2*w1, not true"),
        ("(A - B)*w1*w2/C", "", "8: top.field.w3: must be a formula such as 2*w1, not an empty value"),
        ("(A*w1)**2", "{value: w1, on: {zz: 0}} # ", "11: top.invariants.momentum: 'momentum' holds on 'zz'"),
        (
            "(A*w1)**2",
            "{value: w1, om: {zz: 0}} # ",
            "11: top.invariants.momentum.om: unknown key; known: if, on, value",
        ),
        ("(A*w1)**2", "{on: {zz: 0}} # ", "11: top.invariants.momentum.value: missing; give the formula"),
        ("(A*w1)**2", "{value: w9} # ", "11: top.invariants.momentum.value: column 1: unknown name 'w9'"),
        ("scheme: hk", "scheme: {name: hk, compensatd: true}", "13: scheme.compensatd: unknown key"),
        ("h: 0.01", "h: 0.01\noutput: {attitude: quaternion}", "15: output.attitude: top 'custom'"),
        (
            "  invariants:",
            f"  {OMEGA}  vertical: [A*w1, B*w2, C*w3]\n  invariants:",
            "10: top.vertical: top 'custom': its",
        ),
        (
            "  invariants:",
            "  vertical: [w1, w2, w3]\n  invariants:",
            "9: top.vertical: top 'custom': the vertical needs",
        ),
        (
            "  invariants:",
            "  angular_velocity: [w1, w2]\n  invariants:",
            "9: top.angular_velocity: List should have at least 3 items",
        ),
        (
            "  invariants:",
            "  angular_velocity: [w1, w2, w]\n  invariants:",
            "9: top.angular_velocity[2]: column 1: unknown",
        ),
    ],
)
def test_what_is_refused_names_its_line(tmp_path, old: str, new: str, message: str) -> None:
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
        list(load_scenes("custom"))


def load_scenes(top: str):
    from topcli.config.load import scenes

    return scenes(top)


def test_states_of_an_array_and_of_a_box() -> None:
    ensemble = topcli.simulate(config(), states=[Y0, (1.0, 0.0, 0.0)])
    assert ensemble[0].states.tobytes() == topcli.simulate(config()).states.tobytes()
    drawn = load(config(ensemble={"random": {"count": 200, "seed": 3, "w1": {"near": 0.1}}}))
    assert drawn.ensemble
    states = drawn.ensemble.states
    assert states[:, 1:].tolist() == [list(Y0[1:])] * 200
    assert abs(states[:, 0] - 0.9).max() <= 0.1
    assert np.histogram(states[:, 0], 4, (0.8, 1.0))[0].min() > 25  # a quarter is 50, with a deviation of 6
    gridded = load(config(ensemble={"grid": {"top.k": [0.1, 0.2], "w3": [0.0, 1.0, 2.0]}}))
    assert [gridded.trajectory(i).y0 for i in (0, 5)] == [(0.9, -0.4, 0.0), (0.9, -0.4, 2.0)]
    assert gridded.trajectory(5).top.constants()[3] == 0.2
    assert load(gridded.resolved()).digest == gridded.digest


@pytest.mark.parametrize(
    ("changes", "accepted"),
    [
        ({}, True),
        ({"scheme": {"name": "hk", "compensated": True}}, True),
        ({"ensemble": {"random": {"count": 3, "w1": {"near": 0.1}}}}, True),
        ({"ensemble": {"rndom": {}}}, False),
        ({"top": section(field=0)}, False),
        ({"top": section(invariants={"m": {"value": "w1", "on": {"m": 0}}})}, True),
        ({"top": section(parameters={"A": "3"})}, False),
        ({"top": SECTION | {"k": 0.5}}, True),
        ({"top": SECTION | {"k": "x"}}, False),
    ],
)
def test_the_schema_of_configs_knows_custom_tops(changes, accepted: bool) -> None:
    assert fits(schema_of_configs(), {"name": "x", **config(**changes)}) is accepted


def test_labels_of_components() -> None:
    names = {"w1": "$w_{1}$", "omega3": r"$\omega_{3}$", "theta": r"$\theta$", "q": "$q$", "x12": "$x_{12}$"}
    names |= {"vel1": r"$\mathrm{vel}_{1}$", "p_x": r"$\mathrm{p\_x}$"}
    assert {name: component_symbol(name) for name in names} == names
    for label in names.values():
        MathTextParser("path").parse(label)


@pytest.mark.slow
def test_twelve_components() -> None:
    """A chain whose sum of squares is conserved by every triple of terms x(i) x(i+1) x(i+2) with factors 1, 2, -3."""
    d = 12
    names = [f"x{i}" for i in range(d)]
    field = {
        f"x{i}": f"x{(i + 1) % d}*x{(i + 2) % d} + 2*x{(i - 1) % d}*x{(i + 1) % d} - 3*x{(i - 2) % d}*x{(i - 1) % d}"
        for i in range(d)
    }
    top = {"kind": "custom", "components": names, "field": field}
    top["invariants"] = {"energy": " + ".join(f"{name}**2" for name in names)}
    start = {name: 0.1 * (i % 5) - 0.1 for i, name in enumerate(names)}
    given = config(top=top, initial=start, N=100)
    trajectory = topcli.simulate(given)
    assert trajectory.states.shape == (101, d)
    reference = topcli.simulate({**given, "scheme": "dop853"})
    assert trajectory.states[-1] == pytest.approx(reference.states[-1], abs=2e-5)
    assert np.ptp(trajectory["energy"]) < 1e-4


def test_the_schema_of_configs_knows_quantities() -> None:
    observed = {"quantities": {"x": "w1", "y": 2}}
    assert fits(schema_of_configs(), {"name": "x", **config(output={**observed, "columns": ["t", "x"]})})
    assert not fits(schema_of_configs(), {"name": "x", **config(output={"quantities": [1]})})


WORKER = """
import pickle, sys
from topcli.sweeps.compute import compute
pieces, measures = pickle.load(sys.stdin.buffer)
pickle.dump([compute(*piece, measures) for piece in pieces], sys.stdout.buffer)
"""


def test_a_process_that_never_read_the_config_computes_its_rows() -> None:
    study = {"name": "s", "base": config(N=50, output={"quantities": {"x": "k*w1"}})}
    study |= {"grid": {"top.k": [0.1, 0.2], "scheme": ["hk", "rk4"]}}
    groups, measures = list(load_sweep(study).groups()), ("max.x", "max_deviation.energy")
    data = pickle.dumps(([(group.experiment.resolved(), group.states) for group in groups], measures))
    there = subprocess.run([sys.executable, "-c", WORKER], input=data, capture_output=True, check=True)
    here = [compute(group.experiment, group.states, measures) for group in groups]
    assert pickle.loads(there.stdout) == here
    assert [row[0] for rows in here for row in rows] == ["completed"] * 4


texts = st.sampled_from(["w1", "k*w1", "w1**", "sin(w1)", "1/0", "1/w1", "", "w1**3", "q", "w1*w1*k", "0", "((w1"])
pieces = (
    texts
    | st.none()
    | st.booleans()
    | st.floats()
    | st.integers(-3, 3)
    | st.lists(texts, max_size=2)
    | st.dictionaries(
        st.sampled_from(["w1", "w2", "value", "on", "energy", "k", "kind", ""]), texts | st.floats(), max_size=3
    )
)


@settings(max_examples=300, deadline=None)
@given(
    st.dictionaries(st.sampled_from(["components", "parameters", "field", "invariants", "k", "x"]), pieces, max_size=4)
)
def test_no_section_ends_in_an_internal_error(changes) -> None:
    """Each part replaced by something else, of a top that is right."""
    right = {"kind": "custom", "components": ["w1", "w2"], "parameters": {"k": 1.0}}
    right |= {"field": {"w1": "k*w2", "w2": "-k*w1"}, "invariants": {"energy": "w1**2 + w2**2"}}
    whole = config(top=right | changes, initial={"w1": 1.0, "w2": 0.0}, scheme="rk4", N=3)
    try:
        experiment = load(whole)
    except TopcliError:
        return
    assert load(experiment.resolved()).digest == experiment.digest


@pytest.mark.parametrize("scheme", ["hk", "rk4"])
def test_roots_of_parameters_in_other_precisions(scheme: str) -> None:
    """x' = sqrt(2) x to 38 digits, by a generated step and by one that calls the field; not in rational numbers."""
    top = {"kind": "custom", "components": ["x"], "field": {"x": "sqrt(2)*x"}}
    whole = config(top=top, initial={"x": 1}, scheme=scheme, N=1, h=0.5, precision=40)
    experiment = load(whole)
    x = trajectory_of(experiment).rows.recorded[1, 0]
    with mpmath.workdps(45):
        z = mpmath.sqrt(2) / 2
        expected = (1 + z / 2) / (1 - z / 2) if scheme == "hk" else 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24
        assert abs(mpmath.mpf(str(x)) - expected) < mpmath.mpf(10) ** -36
    with pytest.raises(TopcliError, match=r"math.sqrt, which rational numbers do not have"):
        topcli.simulate({**whole, "precision": "rational"})


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
ROLES = {
    "parameter": ("{{'{name}': 0.3}}", "[u, v]", "u: v, v: -{name}*u"),
    "component": ("{{k: 0.3}}", "['{name}', v]", "'{name}': v, v: -k*{name}"),
}
OWN = """\
top:
  kind: custom
  parameters: {0}
  components: {1}
  field: {{{2}}}
initial: {{'{3}': 1.0, v: 0.2}}
scheme: hk
h: 0.1
N: 5
"""


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("role", ROLES)
def test_any_name_works_or_is_refused_with_its_line(role: str, tmp_path: Path) -> None:
    """Words of Python, and names that topcli, pydantic or generated code use themselves."""
    path, refused, steps = tmp_path / "own.yaml", set(), set()
    line = {"parameter": 3, "component": 4}[role]
    for name in sorted(NAMES):
        parts = [part.format(name=name) for part in ROLES[role]]
        first = name if role == "component" and name != "from" else "u"  # initial: {from: RUN} is read before the top
        path.write_text(OWN.format(*parts, first))
        try:
            experiment = load_experiment(path)
        except ConfigError as error:
            refused.add(name)
            message = str(error)
        else:
            assert load_experiment(experiment.resolved()).digest == experiment.digest
            p = np.array(pickle.loads(pickle.dumps(experiment.top)).constants())
            y = state_after(interpreted(experiment.method(), 2, len(p)), np.array(experiment.y0), p, experiment.h)
            assert y is not None
            steps.add(tuple(y))
            continue
        assert message.startswith(f"{path}:{line}: top.{role}s"), name
        assert name in message.partition(": ")[2]
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
