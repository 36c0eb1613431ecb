"""A top's description as Euler-Poisson equations is compared with its field before anything trusts it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import pytest

from declared import BODIES, Heavy
from topcli.contracts import EulerPoisson, Top
from topcli.errors import UsageError
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS
from topcli.tops.bodies import checked_equations, checked_rotation
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

TURNING = ("volterra", "lagrange-gyrostat", "kowalevski-gyrostat", "hess-appelrot", "clebsch", "kirchhoff", "suslov")
"""Tops of the catalogue that turn like bodies; the Goryachev-Chaplygin top is one of ``BODIES``."""
TRUE = [
    *(TOPS[form].new() for form in BODIES),
    Kowalevski(c0=-3e5, A=0.7),
    Kowalevski(c0=0.0),
    Lagrange(A=1e-3, C=7e2, mu=-1e-9),
    Heavy(A=1.1, B=1e4, C=0.3, x0=1e-12, y0=-2e8, z0=0.0),
    Euler(A=1e-300, B=1.0, C=1e300),
]


@pytest.mark.parametrize("top", TRUE, ids=repr)
def test_descriptions_of_the_tops_are_their_fields(top: Top) -> None:
    assert checked_equations(top, "a test") == top.euler_poisson()


@pytest.mark.parametrize("top", [*TRUE, *(TOPS[form].new() for form in TURNING)], ids=repr)
def test_verticals_are_fixed_in_space(top: Top) -> None:
    checked_rotation(top, "a test")


@pytest.mark.parametrize("factor", [-1.0, 1.0 - 1e-4, 1.0 + 1e-4])
@pytest.mark.parametrize("form", ["kowalevski", "volterra", "clebsch"])
def test_a_vertical_that_moves_is_noticed(form: str, factor: float) -> None:
    base = TOPS[form]
    velocity: Any = base.angular_velocity

    class Turned(base):
        angular_velocity: ClassVar = staticmethod(lambda y, p: tuple(factor * w for w in velocity(y, p)))

    with pytest.raises(UsageError, match="its vertical is not fixed in space: it changes by "):
        checked_rotation(Turned(), "a test")


def test_a_top_without_an_angular_velocity_is_refused() -> None:
    with pytest.raises(UsageError, match="top 'so4': a test needs its angular velocity, which it does not declare"):
        checked_rotation(TOPS["so4"].new(), "a test")


@pytest.mark.parametrize("name", ["angular_velocity", "vertical"])
def test_a_vector_that_always_fails_is_refused(name: str) -> None:
    failing = type("Failing", (Kowalevski,), {name: staticmethod(lambda y, p: (1.0 / (0.0 * p[0]), y[1], y[2]))})
    with pytest.raises(UsageError, match=f"{name} has no value at any state that was tried"):
        checked_rotation(failing(), "a test")


def gyrostat_field(y, p):
    """The heavy top with a rotor along its third axis, of angular momentum p[6]."""
    f1, f2, f3, g1, g2, g3 = Heavy.field(y, (p[0], p[1], p[2], p[3], p[4], p[5]))
    return (f1 - p[6] * y[1] / p[0], f2 + p[6] * y[0] / p[1], f3, g1, g2, g3)


class Gyrostat(Heavy):
    """Described as if it had no rotor."""

    kind: ClassVar[str] = "gyrostat"
    form: ClassVar[str] = "gyrostat"
    field: ClassVar = staticmethod(gyrostat_field)
    rotor: float = 0.7

    def constants(self) -> tuple[float, ...]:
        return (*super().constants(), self.rotor)


class HonestGyrostat(Gyrostat):
    def euler_poisson(self) -> EulerPoisson:
        raise NotImplementedError


def described(change: Callable[[EulerPoisson], EulerPoisson]) -> Any:
    class Described(Heavy):
        def euler_poisson(self) -> EulerPoisson:
            return change(super().euler_poisson())

    return Described


@pytest.mark.parametrize(
    ("change", "component"),
    [
        (lambda e: EulerPoisson((2.0 + 1e-9, 1.5, 1.0), e.gravity), "omega1"),
        (lambda e: EulerPoisson(e.moments, (1.0, 0.5, 0.8 + 1e-9)), "omega1"),
        (lambda e: EulerPoisson(e.moments, (1.0 + 1e-9, 0.5, 0.8)), "omega2"),
        (lambda e: EulerPoisson(e.moments, e.gravity, omega_sign=-1.0), "omega1"),
    ],
)
def test_the_component_that_differs_is_named(change, component: str) -> None:
    with pytest.raises(UsageError, match=f"a test needs, is not its field: {component}' is ") as caught:
        checked_equations(described(change)(), "a test")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("size", [1e-30, 1e-9, 1.0, 1e9])
def test_no_term_hides_behind_a_larger_one(size: float) -> None:
    """Gravity wrong by a relative 1e-9, however small or large beside the other terms."""
    weak = Heavy(x0=0.0, y0=0.0, z0=size)
    wrong = described(lambda e: EulerPoisson(e.moments, (0.0, 0.0, e.gravity[2] * (1.0 + 1e-9))))
    checked_equations(weak, "a test")
    with pytest.raises(UsageError, match="omega1' is "):
        checked_equations(wrong(**weak.model_dump()), "a test")


def test_a_top_of_another_shape_is_refused() -> None:
    class Two(Kowalevski):
        components: ClassVar[tuple[str, ...]] = ("q", "p")

    with pytest.raises(UsageError, match="its state has 2 components"):
        checked_equations(Two(), "a test")


@pytest.mark.parametrize("scheme", ["dmv", "splitting"])
@pytest.mark.parametrize("top", [Gyrostat(), HonestGyrostat()], ids=["wrong", "none"])
def test_nothing_trusts_a_wrong_description(scheme: str, top: Top) -> None:
    build, options = find_scheme(scheme, "heavy").build, find_scheme(scheme, "heavy").options()
    with pytest.raises(UsageError, match=f"gyrostat.*scheme '{scheme}'"):
        build(top, options)
    build(Heavy(), options)
