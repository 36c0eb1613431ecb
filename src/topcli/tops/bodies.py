"""Checks of what a top says about its body: its Euler-Poisson equations, its angular velocity and its vertical."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, cast

import numpy as np

from topcli.contracts import EulerPoisson, Top
from topcli.errors import UsageError
from topcli.field.polynomial import Polynomial, exact_top, required_field

_ROUNDING = 1e-12
"""Relative difference of coefficients that rounded parameters may leave."""
MOVED = 1e-6
"""Relative change of a vertical that finite differences may leave."""
_EPS = 2.0**-50
"""Rounding error of a vertical, which finite differences divide by their step."""
_PROBES = 4
"""States at which a vertical is tried."""


def checked_equations(top: Top, needed_by: str) -> EulerPoisson:
    """Return ``top.euler_poisson()`` after comparing its polynomials with those of ``top.field``.

    Parameters
    ----------
    top : Top
        Any top, also one from a user's file.
    needed_by : str
        User of the equations, for the error message, such as "scheme 'dmv'".

    Raises
    ------
    UsageError
        If the top gives no Euler-Poisson equations, or if they differ from its field. The message names the component
        that differs.
    """
    try:
        equations = top.euler_poisson()
    except NotImplementedError:
        other = "use a scheme that needs the field alone, such as rk4, or " if needed_by.startswith("scheme") else ""
        raise UsageError(
            f"top {top.kind!r}: {needed_by} needs its Euler-Poisson equations, which it does not define; "
            f"{other}define euler_poisson()"
        ) from None
    if fault := _difference(top, equations, needed_by):
        raise UsageError(f"top {top.kind!r}: euler_poisson(), which {needed_by} needs, is not its field: {fault}")
    return equations


def _difference(top: Top, equations: EulerPoisson, needed_by: str) -> str:
    """Component of the field that differs from the equations, and by what term; empty if none does."""
    d = len(top.components)
    if not all(isinstance(value, int | float | Fraction) for value in top.constants()):
        return ""  # numbers of another precision; the same formulas have passed in doubles
    if d not in (3, 6):
        return f"its state has {d} components; expected omega (3), or omega and gamma (6)"
    field, exact, sign = required_field(top, needed_by), exact_top(top).euler_poisson(), equations.omega_sign
    omega = [sign * Polynomial.variable(i) for i in range(3)]
    gamma = [Polynomial.variable(i) if d == 6 else Polynomial.of(0) for i in range(3, 6)]
    moments, gravity = (tuple(map(Polynomial.of, values)) for values in (exact.moments, exact.gravity))
    rates = EulerPoisson(cast(Any, moments), cast(Any, gravity)).rates((*omega, *gamma))
    for i, name in enumerate(top.components):
        expected = rates[i] * (sign if i < 3 else 1)
        for monomial in sorted({*expected.terms, *field[i].terms}):
            a, b = field[i].terms.get(monomial, 0), expected.terms.get(monomial, 0)
            if abs(a - b) > Fraction(_ROUNDING) * max(abs(a), abs(b)):
                factors = "*".join(top.components[k] for k in monomial) or "1"
                return (
                    f"{name}' is {float(a):.10g}*{factors} by the field and {float(b):.10g}*{factors} by the equations"
                )
    return ""


def checked_rotation(top: Top, needed_by: str) -> None:
    """Check that ``top`` gives its angular velocity, and that its ``vertical`` is fixed in space.

    In the body's frame, the rate of change of the vertical must be vertical x angular velocity. This is tested at
    several states by finite differences. ``needed_by`` has the same meaning as in ``checked_equations``.

    Raises
    ------
    UsageError
        If the top gives no angular velocity, or if its vertical moves.
    """
    velocity, vertical = type(top).angular_velocity, type(top).vertical
    if velocity is None:
        raise UsageError(
            f"top {top.kind!r}: {needed_by} needs its angular velocity, which it does not declare; if it turns like a "
            "body, define angular_velocity, three numbers in the body's frame"
        )
    p, d = top.constants(), len(top.components)
    errors: list[Exception] = []
    for probe in range(_PROBES):
        y = np.cos(np.arange(1.0, d + 1.0) + d * probe)  # in general position
        try:
            rates = np.array(top.field(tuple(y.tolist()), p), dtype=float)
            if not (step := 1e-4 / max(1.0, float(np.abs(rates).max()))):
                continue  # beyond the range of a double there is nothing to compare
            values = [velocity(tuple(y.tolist()), p)]
            values += [vertical(tuple((y + k * step * rates).tolist()), p) for k in (-1, 0, 1) if vertical]
        except (ArithmeticError, ValueError) as error:  # outside the domain of a root or a logarithm, perhaps
            errors.append(error)
            continue
        for name, value in zip(("angular_velocity", "vertical"), values, strict=False):
            if not isinstance(value, tuple) or len(value) != 3:
                raise UsageError(f"top {top.kind!r}: {name} must return a tuple of three numbers, not {value!r}")
        if vertical is None:
            return
        with np.errstate(all="ignore"):
            omega, before, here, after = np.array(values, dtype=float)
            rate, turn = (after - before) / (2.0 * step), np.cross(here, omega)
            size = np.abs(here).max() * (MOVED * (1.0 + np.abs(omega).max()) + _EPS / step) + MOVED * np.abs(rate).max()
            if np.abs(rate - turn).max() > size:
                texts = [", ".join(f"{value:.6g}" for value in vector) for vector in (rate, turn, y)]
                raise UsageError(
                    f"top {top.kind!r}: its vertical is not fixed in space: it changes by ({texts[0]}), and "
                    f"vertical x angular_velocity is ({texts[1]}), at ({texts[2]})"
                )
    if len(errors) == _PROBES:
        reason = f"{type(errors[-1]).__name__}: {errors[-1]}"
        raise UsageError(
            f"top {top.kind!r}: angular_velocity or vertical fails at every state that was tried: {reason}"
        )


def moment_warnings(top: Top) -> list[str]:
    """A warning about moments of inertia that violate the triangle inequality: each is at most the sum of the others.

    Such moments do not prevent a run.
    """
    try:
        moments = checked_equations(top, "the check of the moments").moments
    except UsageError:
        return []
    (small, _), (middle, _), (large, axis) = sorted(zip(moments, "ABC", strict=True))
    if large <= (small + middle) * (1.0 + _ROUNDING):  # decimals such as 0.3, 0.1, 0.2 are rounded
        return []
    listed = ", ".join(f"{moment:g}" for moment in moments)
    return [
        f"the moments ({listed}) violate the triangle inequality: {axis} = {large:g} > {small:g} + {middle:g}; "
        "no rigid body has such moments, but the equations are integrated"
    ]
