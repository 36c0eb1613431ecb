"""Moments of inertia with which the discrete Moser-Veselov step of a free body has order 4, 6, 8 or 10.

Hairer and Vilmart (2006) replace each inverse moment by 1/I_i (1 + s) + d. With s and d power series in h² whose
coefficients are polynomials in the constants of the motion C = m²/2 and H, the step becomes the exact motion; cut off
after h^(n - 2) it has order n. With a = h² C, b = h² H, and the elementary symmetric functions e1, e2, e3 of the
inverse moments::

    s = e2 a/6 - e1 b/3 + ...,    d = e2 b/6 - e3 a/3 + ...

The coefficients were derived from the condition that the Cayley vector of the step equals that of the motion, order by
order, in rational arithmetic, for enough bodies and states to determine all polynomials and to check them; the tests
repeat the check. The functions take floats or fractions. Coefficients that an order does not use cost nothing: the
compiler omits them and moves the others out of the loop.
"""

from __future__ import annotations

from collections.abc import Callable

from topcli.contracts import Floats

ORDERS = (4, 6, 8, 10)
Series = Callable[[Floats, float, float], float]


def scale_coefficients(e1: float, e2: float, e3: float) -> Floats:
    """Coefficients in s of a, b, a², ab, b², ..., up to the terms of degree four."""
    s11, s22, s33 = e1 * e1, e2 * e2, e3 * e3
    return (
        e2 / 6,
        -e1 / 3,
        -e1 * e3 / 10 + s22 / 30,
        -e1 * e2 / 30 + 2 * e3 / 15,
        s11 / 30 - e2 / 60,
        -11 * (e1 * e2 * e3) / 420 + 17 * (s22 * e2) / 2520 + 5 * s33 / 126,
        11 * (s11 * e3) / 210 - e1 * s22 / 70 - e2 * e3 / 84,
        s11 * e2 / 420 - 53 * (e1 * e3) / 630 + 41 * s22 / 2520,
        -s11 * e1 / 630 + e1 * e2 / 630 + e3 / 35,
        s11 * s33 / 120 - 19 * (e1 * s22 * e3) / 2520 + 31 * (s22 * s22) / 22680 + 97 * (e2 * s33) / 15120,
        17 * (s11 * e2 * e3) / 1260 - 11 * (e1 * s22 * e2) / 3240 - 47 * (e1 * s33) / 945 + 47 * (s22 * e3) / 7560,
        -17 * (s11 * e1 * e3) / 1260 + 13 * (s11 * s22) / 3780 + e1 * e2 * e3 / 252 + s22 * e2 / 2520 + 53 * s33 / 1260,
        -s11 * e1 * e2 / 11340 + 23 * (s11 * e3) / 945 - 11 * (e1 * s22) / 1890 - 23 * (e2 * e3) / 1260,
        s11 * s11 / 22680 - s11 * e2 / 15120 - 3 * (e1 * e3) / 280 + 17 * s22 / 5040,
    )


def shift_coefficients(e1: float, e2: float, e3: float) -> Floats:
    """Coefficients in d of a, b, a², ab, b², ..., up to the terms of degree four."""
    s11, s22, s33 = e1 * e1, e2 * e2, e3 * e3
    return (
        -e3 / 3,
        e2 / 6,
        -e2 * e3 / 60,
        2 * (e1 * e3) / 15 - s22 / 60,
        -e1 * e2 / 60 - e3 / 10,
        e1 * s33 / 35 - 19 * (s22 * e3) / 2520,
        -e1 * e2 * e3 / 1260 + s22 * e2 / 1260 - 22 * s33 / 315,
        -8 * (s11 * e3) / 315 + 13 * (e1 * s22) / 2520 + 11 * (e2 * e3) / 252,
        s11 * e2 / 1260 + e1 * e3 / 42 - 13 * s22 / 1260,
        3 * (e1 * e2 * s33) / 560 - 61 * (s22 * e2 * e3) / 45360 - 61 * (s33 * e3) / 4536,
        -2 * (s11 * s33) / 105 + 37 * (e1 * s22 * e3) / 7560 - s22 * s22 / 45360 + 19 * (e2 * s33) / 1260,
        19 * (s11 * e2 * e3) / 7560 - e1 * s22 * e2 / 1512 + 89 * (e1 * s33) / 1890 - 19 * (s22 * e3) / 1080,
        8 * (s11 * e1 * e3) / 2835 - s11 * s22 / 1512 - 23 * (e1 * e2 * e3) / 1890 + 97 * (s22 * e2) / 22680 - s33 / 35,
        -s11 * e1 * e2 / 45360 - s11 * e3 / 360 - e1 * s22 / 7560 + 17 * (e2 * e3) / 1680,
    )


def series4(c: Floats, a: float, b: float) -> float:
    """Terms of degree one in a and b."""
    return c[0] * a + c[1] * b


def series6(c: Floats, a: float, b: float) -> float:
    """Terms of degrees one and two."""
    return series4(c, a, b) + (c[2] * (a * a) + (c[3] * (a * b) + c[4] * (b * b)))


def series8(c: Floats, a: float, b: float) -> float:
    """Terms of degrees one to three."""
    aa, bb = a * a, b * b
    return series6(c, a, b) + ((c[5] * a + c[6] * b) * aa + (c[7] * a + c[8] * b) * bb)


def series10(c: Floats, a: float, b: float) -> float:
    """Terms of degrees one to four."""
    aa, ab, bb = a * a, a * b, b * b
    return series8(c, a, b) + ((c[9] * aa + c[10] * ab) * aa + (c[11] * aa + (c[12] * ab + c[13] * bb)) * bb)


SERIES: dict[int, Series] = {4: series4, 6: series6, 8: series8, 10: series10}


def modified_inverse_moments(series: Series, i: Floats, a: float, b: float) -> tuple[float, float]:
    """Return 1 + s and d for the inverse moments ``i``."""
    i1, i2, i3 = i
    e1, e2, e3 = i1 + (i2 + i3), i2 * i3 + (i3 * i1 + i1 * i2), i1 * (i2 * i3)
    return 1 + series(scale_coefficients(e1, e2, e3), a, b), series(shift_coefficients(e1, e2, e3), a, b)
