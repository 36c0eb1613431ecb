"""Checks of what a top says about its body: its Euler-Poisson equations, its angular velocity and its vertical."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction

import numpy as np

from topcli.contracts import Array, EulerPoisson, Top
from topcli.errors import UsageError
from topcli.field.integrals import rates_along, slopes
from topcli.field.polynomial import Polynomial, exact_top, required_field

_ROUNDING = 1e-12
"""Relative difference of coefficients that rounded parameters may leave."""
MOVED = 1e-6
"""Change of a vertical that differences may leave, relative to the vertical and to its rate of change."""
_EPS = 1e-6
"""Part of it that rounding errors of the differences may be, relative to the vertical times the field."""
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
    """Component of the field that differs from the equations, and both rates; empty if none does."""
    d, sign = len(top.components), equations.omega_sign
    if not all(isinstance(value, int | float | Fraction) for value in top.constants()):
        return ""  # numbers of another precision; the same formulas have passed in doubles
    if d not in (3, 6):
        return f"its state has {d} components; expected omega (3), or omega and gamma (6)"
    signs = (sign,) * 3 + (1,) * 3
    y = [Polynomial.variable(i) * signs[i] if i < d else Polynomial.of(0) for i in range(6)]
    rates = [
        Polynomial.of(rate) * sign for rate, sign in zip(exact_top(top).euler_poisson().rates(y), signs, strict=True)
    ]
    for name, rate, expected in zip(top.components, required_field(top, needed_by), rates, strict=False):
        sizes = (rate.magnitudes() + expected.magnitudes()).terms
        if any(abs(c) > Fraction(_ROUNDING) * sizes[monomial] for monomial, c in (rate - expected).terms.items()):
            texts = rate.text(top.components), expected.text(top.components)
            return f"{name}' is {texts[0]} by the field and {texts[1]} by the equations"
    return ""


def checked_rotation(top: Top, needed_by: str) -> None:
    """Check that ``top`` gives its angular velocity, and that its ``vertical`` is fixed in space.

    In the body's frame, the rate of change of the vertical must be vertical x angular velocity. This is tested at
    several states by differences. ``needed_by`` has the same meaning as in ``checked_equations``.

    Raises
    ------
    UsageError
        If the top gives no angular velocity, or if its vertical moves.
    """
    if type(top).angular_velocity is None:
        raise UsageError(
            f"top {top.kind!r}: {needed_by} needs its angular velocity, which it does not declare; if it turns like a "
            "body, define angular_velocity, three numbers in the body's frame"
        )
    d = len(top.components)
    states = np.cos(np.arange(1.0, _PROBES * d + 1.0)).reshape(_PROBES, d)  # in general position
    names = ("angular_velocity", "vertical")[: 1 + (type(top).vertical is not None)]
    values = [_vectors(top, name, states) for name in names]
    for name, value in zip(names, values, strict=True):
        if np.isnan(value).all():
            raise UsageError(f"top {top.kind!r}: {name} has no value at any state that was tried")
    if len(values) == 1:
        return
    omega, here = values
    rates = [rates_along(top, lambda y, i=i: _vectors(top, "vertical", y)[:, i], states)[0] for i in range(3)]
    with np.errstate(all="ignore"):
        turns, speed = np.cross(here, omega), np.linalg.norm(slopes(top, states), axis=1)
        for y, rate, turn, vertical, size in zip(states, np.transpose(rates), turns, here, speed, strict=True):
            largest = np.abs(turn).max() + np.abs(rate).max() + np.abs(vertical).max() * (1.0 + size * _EPS)
            # beyond the range of a double there is nothing to compare
            if np.abs(rate - turn).max() > MOVED * largest and np.isfinite(rate).all():
                texts = [", ".join(f"{value:.6g}" for value in vector) for vector in (rate, turn, y)]
                raise UsageError(
                    f"top {top.kind!r}: its vertical is not fixed in space: it changes by ({texts[0]}), and "
                    f"vertical x angular_velocity is ({texts[1]}), at ({texts[2]})"
                )


def _vectors(top: Top, name: str, states: Array) -> Array:
    """Values (m, 3) of a vector of the body at ``states`` (m, d); nan where it has none."""
    function, p = getattr(type(top), name), top.constants()
    vectors = np.full((len(states), 3), np.nan)
    for row, y in zip(vectors, states.tolist(), strict=True):
        with suppress(ArithmeticError, ValueError):  # outside the domain of a root or a logarithm, perhaps
            value = function(tuple(y), p)
            if not isinstance(value, tuple) or len(value) != 3:
                raise UsageError(f"top {top.kind!r}: {name} must return a tuple of three numbers, not {value!r}")
            row[:] = value
    return vectors


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
