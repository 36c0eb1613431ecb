"""Claims of section 1.1: the Euler-Poisson equations, their integrals, their matrix forms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from topcli.studies.claims import printed
from topcli.studies.claims.algebra import Draws, Dual, Vector, commutator, flat, gradients, minus, plus, weighted
from topcli.studies.claims.claim import Claim
from topcli.studies.claims.kinds.identity import IDENTITY, Difference, identity
from topcli.studies.claims.kinds.integrability import NEIGHBOURS, SPECTRUM, carries_too_little, neighbours_part
from topcli.studies.claims.kinds.rank import RANK, independent
from topcli.studies.claims.scenes import Scene

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


def kowalevski_integral(draws: Draws) -> Sequence[Any]:
    """Rate of change of k² for A = B = 2C = 2 and gravity c0 on the first axis."""
    c0 = draws.number()
    return along_motion(lambda moments, g, w, c: printed.k_squared(c0, w, c), (2, 2, 1), (c0, 0, 0), draws)


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
    _identity(
        "kowalevski-fourth",
        "With A = B = 2C, y0 = z0 = 0, k² = |ω² - c₀γ|² is conserved.",
        "section 1.1, case (3)",
        kowalevski_integral,
        RATES,
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
        "block-form",
        "Both equations together are dL/dt = [M, L] with 6x6 matrices.",
        "section 1.1, (Audin) and the Lax-Moser form",
        combined,
        "rational identity of 6x6 matrices",
    ),
    Claim(
        "block-no-lax-pair",
        "The 6x6 form should not be called a Lax-Moser pair.",
        "section 1.1, after the Lax-Moser form",
        SPECTRUM,
        "`topcli lax heavy`: rank of the gradients of tr L^k",
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
