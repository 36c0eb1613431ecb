"""The HK step and the midpoint rule of tops that come from a user's file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from topcli.engine.collect import orbit
from topcli.errors import TopcliError, UsageError
from topcli.schemes.plugins import load_plugin_file
from topcli.schemes.registry import find_scheme, names_for
from topcli.tops import TOPS
from topcli.tops.declared import custom_class

TOP = """
import math
import topcli
from pydantic import Field
from topcli.contracts import Invariant


@topcli.top
class {name}(topcli.Top):
    kind = form = "{kind}"
    title, citation = "{kind}", "none"
    components = {components}
    vectors = {{"y": (0, {d})}}
    swing = "{swing}"
    step_constants = ("a", "b", "c")
    a: float = Field(default=2.0, description="a")
    b: float = Field(default=3.0, description="b")
    c: float = Field(default=0.7, description="c")

    def constants(self):
        return (self.a, self.b, self.c)

    def invariants(self):
        return ()

    @staticmethod
    def field(y, p):
        {field}
"""
CLEBSCH = """m, q, k = y[:3], y[3:], tuple(c * x for c, x in zip(p, y[3:]))  # the compiler refuses generators
        cross = lambda u, v: (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        return (*cross(q, k), *cross(q, m))"""
FIELDS = {
    "fluid": (6, CLEBSCH),
    "lorenz": (3, "return (p[0] * (y[1] - y[0]), y[0] * (p[1] - y[2]) - y[1], y[0] * y[1] - p[2] * y[2] + 1)"),
    "cubic": (2, "return (y[1], p[0] * y[0] - y[0] ** 3)"),
    "pendulum": (2, "return (y[1], -math.sin(y[0]))"),
}
START = (0.5, -0.3, 0.4, 0.2, -0.6, 0.35)


@pytest.fixture
def tops(own_registry: None, tmp_path: Path) -> None:
    """The tops of ``FIELDS``, each from a file of its own."""
    for kind, (d, field) in FIELDS.items():
        components = tuple(f"y{i + 1}" for i in range(d))
        text = TOP.format(name=kind.title(), kind=kind, components=components, swing=components[0], d=d, field=field)
        (tmp_path / f"{kind}.py").write_text(text)
        load_plugin_file(tmp_path / f"{kind}.py")


def end(name: str, kind: str, h: float, N: int, **options: bool) -> np.ndarray:
    scheme, top = find_scheme(name, kind), TOPS[kind].new()
    y0 = np.array(START[: len(top.components)])
    return orbit(top.new(), scheme.build(top, scheme.options(**options)), y0, h, N, every=N)[1][-1]


@pytest.mark.slow
@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize(
    ("name", "kind"),
    [("hk", "fluid"), ("hk", "lorenz"), ("midpoint", "fluid"), ("midpoint", "cubic"), ("midpoint", "pendulum")],
)
def test_tops_of_a_file_have_generated_schemes(tops: None, name: str, kind: str, compensated: bool) -> None:
    """Compiled, of order two, and undone by a step back; the integrator that it is compared with is another."""
    top, scheme = TOPS[kind].new(), find_scheme(name, kind)
    y0, p = np.array(START[: len(top.components)]), top.constants()
    exact = solve_ivp(lambda t, y: top.field(tuple(y), p), (0.0, 1.0), y0, "DOP853", rtol=1e-13, atol=1e-14)
    errors = [np.linalg.norm(end(name, kind, 1.0 / N, N, compensated=compensated) - exact.y[:, -1]) for N in (100, 200)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    there = orbit(top.new(), scheme.build(top, scheme.options()), y0, 0.05, 1)[1][-1]
    back = orbit(top.new(), scheme.build(top, scheme.options()), there, -0.05, 1)[1][-1]
    assert back == pytest.approx(y0, abs=1e-15)


@pytest.mark.slow
def test_the_midpoint_rule_keeps_quadratic_integrals(tops: None) -> None:
    """q², m·q and the energy of Clebsch's top over 2e4 steps; those of HK, the control, deviate."""

    def integrals(y: np.ndarray) -> np.ndarray:
        m, q = y[:3], y[3:]
        return np.array([q @ q, m @ q, m @ m + np.array([2.0, 3.0, 0.7]) @ q**2])

    start = integrals(np.array(START))
    kept, control = (np.abs(integrals(end(name, "fluid", 0.1, 20_000)) - start) for name in ("midpoint", "hk"))
    assert kept.max() < 1e-13
    assert control.min() > 1e-6


def test_a_declared_integral_that_is_none_is_named(own_registry: None, tmp_path: Path) -> None:
    """With a term of its rate of change; the top is not registered."""
    text = TOP.format(
        name="Drawn", kind="drawn", components=("x", "v"), swing="x", d=2, field="return (y[1], -p[0] * y[0])"
    )
    declared = "(Invariant('energy', 'E', 'E', 'energy', lambda y: y[:, 1] ** 2 + {} * y[:, 0] ** 2, abs),)"
    path = tmp_path / "drawn.py"
    for factor, broken in ((3.0, True), (2.0, False)):
        path.write_text(text.replace("return ()", f"return {declared.format(factor)}"))
        if broken:
            with pytest.raises(TopcliError, match=r"'energy' is not an integral of the field: .* contains 2\*x\*v"):
                load_plugin_file(path)
        else:
            load_plugin_file(path)
        assert ("drawn" in TOPS) is not broken


@pytest.mark.parametrize(
    ("kind", "offered", "name", "reason"),
    [
        ("cubic", {"midpoint"}, "hk", "scheme 'hk' needs a quadratic field, but y2' has degree 3"),
        ("pendulum", {"midpoint"}, "hk", "scheme 'hk' needs a quadratic field, but .* calls a function of the state"),
    ],
)
def test_others_are_not_offered_and_say_why(tops: None, kind: str, offered: set[str], name: str, reason: str) -> None:
    assert {"hk", "midpoint"} & set(names_for(kind)) == offered
    assert "rk4" in names_for(kind)
    with pytest.raises(UsageError, match=f"top '{kind}': {reason}"):
        find_scheme(name, kind)


@pytest.mark.parametrize(("factor", "counted"), [(0.999, 1.0), (1.001, 0.0), (-0.999, 1.0)])
def test_near_singular_solves_of_a_top_without_an_energy_are_counted(factor: float, counted: float) -> None:
    """HK of x' = x² is x' = x/(1 - h x), with the determinant 1 - h x."""
    top = custom_class({"components": ["x"], "field": {"x": "x**2"}})
    TOPS.declared[top.form] = top
    scheme, x = find_scheme("hk", top.form), 8.0 * (1.0 - factor * 2.0**-10)
    ending = orbit(top.new(), scheme.build(top.new(), scheme.options()), (x,), 0.125, 1).ending
    assert ending.counters == {"near_singular_solves": counted}
