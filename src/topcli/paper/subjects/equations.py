"""Claims of section 1.1: the Euler-Poisson equations, their integrals, their matrix forms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import (
    Draws,
    Dual,
    Vector,
    commutator,
    flat,
    gradients,
    minus,
    plus,
    product,
    weighted,
)
from topcli.paper.claim import Claim
from topcli.paper.kinds.identity import IDENTITY, Difference, identity
from topcli.paper.kinds.integrability import NEIGHBOURS, SPECTRUM, carries_too_little, neighbours_part
from topcli.paper.kinds.rank import RANK, independent
from topcli.paper.scenes import Scene

INDEPENDENT = "rank of the gradients at random rational states"
RATES = "rational identity: the rate of change along the printed equations"


def components(draws: Draws) -> Sequence[Any]:
    """(Euler) and (Poisson) against (EulerPoisson)."""
    moments, g, w, c = draws.moments(), draws.vector(), draws.vector(), draws.vector()
    m_rate, c_rate = printed.euler_poisson(moments, g, w, c)
    return [*minus(printed.euler(moments, g, w, c), m_rate), *minus(printed.poisson(w, c), c_rate)]


def along_motion(
    quantity: Callable[[Vector, Vector, Vector, Vector], Any], moments: Vector, g: Vector, draws: Draws
) -> list[Any]:
    """Rate of change of ``quantity(moments, g, omega, gamma)`` along (EulerPoisson)."""
    w, c = draws.vector(), draws.vector()
    m_rate, c_rate = printed.euler_poisson(moments, g, w, c)
    w_dual = tuple(Dual(x, rate / moment) for x, rate, moment in zip(w, m_rate, moments, strict=True))
    c_dual = tuple(Dual(x, rate) for x, rate in zip(c, c_rate, strict=True))
    found = quantity(moments, g, (w_dual[0], w_dual[1], w_dual[2]), (c_dual[0], c_dual[1], c_dual[2]))
    return [found.rate]


def law(index: int) -> Difference:
    """Rate of change of one of the three quantities of (constant), for any top."""
    return lambda draws: along_motion(lambda *at: printed.laws(*at)[index], draws.moments(), draws.vector(), draws)


def euler_integral(draws: Draws) -> Sequence[Any]:
    """Rate of change of m² without gravity."""
    moments = draws.moments()

    def m_sq(moments: Vector, g: Vector, w: Vector, c: Vector) -> Any:
        m = weighted(moments, w)
        return m[0] * m[0] + m[1] * m[1] + m[2] * m[2]

    return along_motion(m_sq, moments, (0, 0, 0), draws)


def lagrange_integral(draws: Draws) -> Sequence[Any]:
    """Rate of change of omega_3 with A = B and gravity on the third axis."""
    A, C, z0 = draws.positive(), draws.positive(), draws.number()
    return along_motion(lambda moments, g, w, c: w[2], (A, A, C), (0, 0, z0), draws)


def kowalevski_integral(corrected: bool) -> Difference:
    """Rate of change of k² for A = B = 2C and gravity c0 on the first axis; ``corrected`` takes c0/C in k²."""

    def rate(draws: Draws) -> Sequence[Any]:
        C, c0 = draws.positive(), draws.number()
        factor = c0 / C if corrected else c0
        return along_motion(
            lambda moments, g, w, c: printed.k_squared(factor, w, c), (2 * C, 2 * C, C), (c0, 0, 0), draws
        )

    return rate


def _four(fourth: Callable[[Sequence[Any]], Any], moments: Vector, g: Vector, draws: Draws) -> list[tuple[Any, ...]]:
    """Gradients of the three quantities of (constant) and of a fourth one."""
    state = (*draws.vector(), *draws.vector())
    return gradients(
        lambda at: (*printed.laws(moments, g, (at[0], at[1], at[2]), (at[3], at[4], at[5])), fourth(at)), state
    )


def euler_integrals(draws: Draws) -> list[tuple[Any, ...]]:
    """Gradients of gamma², m·gamma, E and m² without gravity."""
    A, B, C = moments = draws.moments()
    return _four(
        lambda at: A * A * at[0] * at[0] + B * B * at[1] * at[1] + C * C * at[2] * at[2], moments, (0, 0, 0), draws
    )


def lagrange_integrals(draws: Draws) -> list[tuple[Any, ...]]:
    """Gradients of gamma², m·gamma, E and omega_3 for A = B and gravity on the third axis."""
    A, C, z0 = draws.positive(), draws.positive(), draws.number()
    return _four(lambda at: at[2], (A, A, C), (0, 0, z0), draws)


def kowalevski_integrals(draws: Draws) -> list[tuple[Any, ...]]:
    """Gradients of gamma², m·gamma, E and k² with c0/C, for A = B = 2C and gravity on the first axis."""
    C, c0 = draws.positive(), draws.number()
    return _four(
        lambda at: printed.k_squared(c0 / C, (at[0], at[1], at[2]), (at[3], at[4], at[5])),
        (2 * C, 2 * C, C),
        (c0, 0, 0),
        draws,
    )


def matrix_m(draws: Draws) -> Sequence[Any]:
    """[Omega, M] + [G, Gamma] against the matrix of m x omega + gamma x g."""
    moments, g, w, c = draws.moments(), draws.vector(), draws.vector(), draws.vector()
    right = [
        plus(x, y)
        for x, y in zip(
            commutator(printed.hat(w), printed.hat(weighted(moments, w))),
            commutator(printed.hat(g), printed.hat(c)),
            strict=True,
        )
    ]
    return minus(flat(printed.hat(printed.euler_poisson(moments, g, w, c)[0])), flat(tuple(right)))


def matrix_gamma(draws: Draws) -> Sequence[Any]:
    """[Omega, Gamma] against the matrix of gamma x omega."""
    moments, g, w, c = draws.moments(), draws.vector(), draws.vector(), draws.vector()
    left = printed.hat(printed.euler_poisson(moments, g, w, c)[1])
    return minus(flat(left), flat(commutator(printed.hat(w), printed.hat(c))))


def block(upper: Any, diagonal: Any) -> Any:
    """6x6 matrix of diagonal + epsilon upper, with epsilon² = 0."""
    return (*((*d, *u) for d, u in zip(diagonal, upper, strict=True)), *((0, 0, 0, *d) for d in diagonal))


def _with_epsilon(body: Any, soul: Any) -> Any:
    """Matrix body + epsilon soul with epsilon² = 0: a dual number has the same product."""
    return tuple(
        tuple(Dual(b, s) for b, s in zip(row, other, strict=True)) for row, other in zip(body, soul, strict=True)
    )


def audin(draws: Draws) -> Sequence[Any]:
    """(Audin): both coefficients of d/dt (Gamma + epsilon M) - [Omega + epsilon G, Gamma + epsilon M]."""
    moments, g, w, c = draws.moments(), draws.vector(), draws.vector(), draws.vector()
    m_rate, c_rate = printed.euler_poisson(moments, g, w, c)
    hat = printed.hat
    left = _with_epsilon(hat(c_rate), hat(m_rate))
    right = commutator(_with_epsilon(hat(w), hat(g)), _with_epsilon(hat(c), hat(weighted(moments, w))))
    found = [Dual(0) + a - b for a, b in zip(flat(left), flat(right), strict=True)]
    return [*(x.value for x in found), *(x.rate for x in found)]


def epsilon(draws: Draws) -> Sequence[Any]:
    """The square of the 2x2 matrix of epsilon, and Gamma + epsilon M with it against the 6x6 matrix L."""
    m, c, matrix = draws.vector(), draws.vector(), printed.EPSILON
    whole = block(printed.hat(m), printed.hat(c))
    found = [
        whole[3 * i + k][3 * j + l] - (int(i == j) * printed.hat(c)[k][l] + matrix[i][j] * printed.hat(m)[k][l])
        for i in range(2)
        for j in range(2)
        for k in range(3)
        for l in range(3)  # noqa: E741
    ]
    return [*flat(product(matrix, matrix)), *found]


def combined(draws: Draws) -> Sequence[Any]:
    """(Audin) in the matrices of the Lax-Moser-like form."""
    moments, g, w, c = draws.moments(), draws.vector(), draws.vector(), draws.vector()
    m_rate, c_rate = printed.euler_poisson(moments, g, w, c)
    hat = printed.hat
    big_l, big_m = block(hat(weighted(moments, w)), hat(c)), block(hat(g), hat(w))
    return minus(flat(block(hat(m_rate), hat(c_rate))), flat(commutator(big_m, big_l)))


def _identity(name: str, statement: str, source: str, difference: Difference, experiment: str) -> Claim:
    return Claim(name, statement, source, IDENTITY, experiment, partial(identity, difference))


CLAIMS = (
    _identity(
        "ep-components",
        "The equations in components are the vector equations.",
        "section 1.1, (Euler), (Poisson), (EulerPoisson)",
        components,
        "rational identity in moments, centre of gravity, omega, gamma",
    ),
    _identity("ep-gamma-sq", "Every top conserves γ².", "section 1.1, (constant) 1", law(0), RATES),
    _identity("ep-m-gamma", "Every top conserves m·γ.", "section 1.1, (constant) 2", law(1), RATES),
    _identity("ep-energy", "Every top conserves E = m·ω/2 + g·γ.", "section 1.1, (constant) 3", law(2), RATES),
    _identity("euler-fourth", "Without gravity m² is conserved.", "section 1.1, case (1)", euler_integral, RATES),
    _identity(
        "lagrange-fourth",
        "With A = B, x0 = y0 = 0, ω₃ is conserved.",
        "section 1.1, case (2)",
        lagrange_integral,
        RATES,
    ),
    Claim(
        "kowalevski-fourth",
        "With A = B = 2C, y0 = z0 = 0, k² = |ω² - c₀γ|² with c₀ = mg x0 is conserved.",
        "section 1.1, case (3)",
        IDENTITY,
        f"{RATES}, for random C; corrected to c₀/C",
        partial(identity, kowalevski_integral(False), kowalevski_integral(True)),
    ),
    Claim(
        "euler-integrable",
        "The Euler top has four independent integrals.",
        "section 1.1, case (1)",
        RANK,
        INDEPENDENT,
        partial(independent, euler_integrals, 4),
    ),
    Claim(
        "lagrange-integrable",
        "The Lagrange top has four independent integrals.",
        "section 1.1, case (2)",
        RANK,
        INDEPENDENT,
        partial(independent, lagrange_integrals, 4),
    ),
    Claim(
        "kowalevski-integrable",
        "The Kowalevski top has four independent integrals.",
        "section 1.1, case (3)",
        RANK,
        f"{INDEPENDENT}, k² with c₀/C",
        partial(independent, kowalevski_integrals, 4),
    ),
    _identity(
        "matrix-m",
        "dM/dt = [Ω, M] + [G, Γ] is the equation for m.",
        "section 1.1, matrix form",
        matrix_m,
        "rational identity of 3x3 matrices",
    ),
    _identity(
        "matrix-gamma",
        "dΓ/dt = [Ω, Γ] is the equation for γ.",
        "section 1.1, matrix form",
        matrix_gamma,
        "rational identity of 3x3 matrices",
    ),
    _identity(
        "audin",
        "Both together are d(Γ + εM)/dt = [Ω + εG, Γ + εM] with ε² = 0.",
        "section 1.1, (Audin)",
        audin,
        "rational identity of 3x3 matrices modulo ε²",
    ),
    _identity(
        "epsilon",
        "The 2x2 matrix (0 1; 0 0) has ε² = 0 and makes Γ + εM the 6x6 matrix L.",
        "section 1.1, after (Audin)",
        epsilon,
        "rational identity of matrices",
    ),
    _identity(
        "block-form",
        "Both equations together are dL/dt = [M, L] with 6x6 matrices.",
        "section 1.1, the Lax-Moser form",
        combined,
        "rational identity of 6x6 matrices",
    ),
    Claim(
        "block-no-lax-pair",
        "The 6x6 form should not be called a Lax-Moser pair.",
        "section 1.1, after the Lax-Moser form",
        SPECTRUM,
        "`topcli lax heavy`: rank of the gradients of the traces tr L^k and of the block traces of L^k",
        partial(carries_too_little, "heavy", "block"),
    ),
    Claim(
        "general-not-integrable",
        "The general Euler-Poisson equations are not integrable.",
        "section 1.1, last sentence",
        NEIGHBOURS,
        "`topcli run heavy_chaotic --set scheme=taylor --set N=10000`, and 1e-9 beside it",
        partial(neighbours_part, Scene("heavy_chaotic", ("scheme=taylor", "N=10000"))),
    ),
)
