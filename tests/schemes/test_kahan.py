"""The HK step of tops that come from a user's file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from topcli.contracts import Stepper
from topcli.engine.run import Run
from topcli.errors import TopcliError, UsageError
from topcli.schemes.any_top.kahan import build_quadratic
from topcli.schemes.layout import CompensatedOption
from topcli.schemes.registry import find_scheme, load_scheme_file, names_for
from topcli.tops import TOPS

TOP = """
from pydantic import Field
from topcli.contracts import Top
from topcli.tops import TOPS


class {name}(Top):
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


TOPS["{kind}"] = {name}
"""
CLEBSCH = """m, q, k = y[:3], y[3:], [c * x for c, x in zip(p, y[3:])]
        cross = lambda u, v: (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        return (*cross(q, k), *cross(q, m))"""
FIELDS = {
    "clebsch": (6, CLEBSCH),
    "lorenz": (3, "return (p[0] * (y[1] - y[0]), y[0] * (p[1] - y[2]) - y[1], y[0] * y[1] - p[2] * y[2] + 1)"),
    "cubic": (2, "return (y[1], p[0] * y[0] - y[0] ** 3)"),
    "pendulum": (2, "import math\n        return (y[1], -math.sin(y[0]))"),
}
START = (0.5, -0.3, 0.4, 0.2, -0.6, 0.35)


@pytest.fixture
def tops(own_registry: None, tmp_path: Path) -> None:
    """The tops of ``FIELDS``, each from a file of its own."""
    for kind, (d, field) in FIELDS.items():
        components = tuple(f"y{i + 1}" for i in range(d))
        text = TOP.format(name=kind.title(), kind=kind, components=components, swing=components[0], d=d, field=field)
        (tmp_path / f"{kind}.py").write_text(text)
        load_scheme_file(tmp_path / f"{kind}.py")


def end(kind: str, h: float, N: int, **options: bool) -> np.ndarray:
    scheme, top = find_scheme("hk", kind), TOPS[kind].new()
    y0 = np.array(START[: len(top.components)])
    return Run(top, scheme.build(top, scheme.options(**options)), y0, h, N, every=N).collect()[1][-1]


@pytest.mark.slow
@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize("kind", ["clebsch", "lorenz"])
def test_quadratic_tops_of_a_file_have_hk(tops: None, kind: str, compensated: bool) -> None:
    """Compiled, of order two, and undone by a step back; the integrator that it is compared with is another."""
    assert "hk" in names_for(kind)
    top = TOPS[kind].new()
    y0 = np.array(START[: len(top.components)])
    exact = solve_ivp(
        lambda t, y: top.field(tuple(y), top.constants()), (0.0, 1.0), y0, "DOP853", rtol=1e-13, atol=1e-14
    )
    errors = [np.linalg.norm(end(kind, 1.0 / N, N, compensated=compensated) - exact.y[:, -1]) for N in (100, 200)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    method = build_quadratic(top, CompensatedOption())
    assert isinstance(method, Stepper)
    p = method.parameters(top)
    there = method.step((*y0, 0.0), 0.05, p)
    assert method.step(there, -0.05, p)[: len(y0)] == pytest.approx(y0, abs=1e-15)


def test_a_declared_integral_that_is_none_is_named(own_registry: None, tmp_path: Path) -> None:
    """With a term of its rate of change; the top is not registered."""
    text = TOP.format(
        name="Drawn", kind="drawn", components=("x", "v"), swing="x", d=2, field="return (y[1], -p[0] * y[0])"
    )
    declared = "(Invariant('energy', 'E', 'E', 'energy', lambda y: y[:, 1] ** 2 + {} * y[:, 0] ** 2, abs),)"
    text = text.replace("import Top\n", "import Invariant, Top\n")
    path = tmp_path / "drawn.py"
    for factor, broken in ((3.0, True), (2.0, False)):
        path.write_text(text.replace("return ()", f"return {declared.format(factor)}"))
        load_scheme_file.cache_clear()
        if broken:
            with pytest.raises(TopcliError, match=r"'energy' is no integral of the field: .* contains 2\*x\*v"):
                load_scheme_file(path)
        else:
            load_scheme_file(path)
        assert ("drawn" in TOPS) is not broken


@pytest.mark.parametrize(
    ("kind", "reason"),
    [("cubic", "y2' has degree 3"), ("pendulum", "calls a function of the state that is no polynomial")],
)
def test_others_are_not_offered_and_say_why(tops: None, kind: str, reason: str) -> None:
    assert "hk" not in names_for(kind)
    assert "rk4" in names_for(kind)
    with pytest.raises(UsageError, match=f"top '{kind}': scheme 'hk' needs a quadratic field, but .*{reason}"):
        build_quadratic(TOPS[kind].new(), CompensatedOption())
