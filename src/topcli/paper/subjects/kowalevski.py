"""Claims of section 3.1: the equations of the Kowalevski top and its integrals."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import I_UNIT, Draws, Dual, Gauss, gradients, minus
from topcli.paper.claim import Claim
from topcli.paper.kinds.identity import IDENTITY, Difference, identity
from topcli.paper.kinds.rank import RANK, independent


def special_case(draws: Draws) -> Sequence[Any]:
    """(K1), (K2) against (EulerPoisson) with A = B = 2, C = 1, g = (c0, 0, 0)."""
    c0, w, c = draws.number(), draws.vector(), draws.vector()
    m_rate, c_rate = printed.euler_poisson((2, 2, 1), (c0, 0, 0), w, c)
    w_found, c_found = printed.kowalevski(c0, w, c)
    return [*minus((2 * w_found[0], 2 * w_found[1], w_found[2]), m_rate), *minus(c_found, c_rate)]


def any_moment(draws: Draws) -> Sequence[Any]:
    """The equations with A = B = 2C for any C against those with C = 1 and c0/C."""
    C, x0, w, c = draws.positive(), draws.number(), draws.vector(), draws.vector()
    moments = (2 * C, 2 * C, C)
    m_rate, _ = printed.euler_poisson(moments, (x0, 0, 0), w, c)
    rates = tuple(a / b for a, b in zip(m_rate, moments, strict=True))
    return minus(rates, printed.kowalevski(x0 / C, w, c)[0])


def _complex(draws: Draws) -> tuple[Any, Any, Any, Any, Any]:
    """c0, the state, and the rates of omega and gamma by components, as complex numbers."""
    c0, w, c = draws.number(), draws.vector(), draws.vector()
    w_rate, c_rate = printed.kowalevski(c0, w, c)
    return c0, w, c, w_rate, c_rate


def complex_omega(draws: Draws) -> Sequence[Any]:
    """Complex equations for omega and its conjugate against the components."""
    c0, w, c, rate, _ = _complex(draws)
    found = printed.complex_omega(c0, Gauss(w[0], w[1]), w[2], c[2])
    return minus(found, (Gauss(rate[0], rate[1]), Gauss(rate[0], -rate[1])))


def complex_gamma(draws: Draws) -> Sequence[Any]:
    """Complex equations for gamma, its conjugate and gamma_3 against the components."""
    _, w, c, _, rate = _complex(draws)
    found = printed.complex_gamma(Gauss(w[0], w[1]), w[2], Gauss(c[0], c[1]), c[2])
    return minus(found, (Gauss(rate[0], rate[1]), Gauss(rate[0], -rate[1]), Gauss(rate[2])))


def xi_parts(draws: Draws) -> Sequence[Any]:
    """First line of (Kxi): the rates of omega² and c0 gamma."""
    c0, w, c, w_rate, c_rate = _complex(draws)
    omega, gamma = Gauss(w[0], w[1]), Gauss(c[0], c[1])
    return (
        2 * omega * Gauss(w_rate[0], w_rate[1]) - (-I_UNIT * w[2] * omega * omega + I_UNIT * c0 * c[2] * omega),
        c0 * Gauss(c_rate[0], c_rate[1]) - (-I_UNIT * c0 * w[2] * gamma + I_UNIT * c0 * c[2] * omega),
    )


def xi_turns(draws: Draws) -> Sequence[Any]:
    """Second line of (Kxi): xi turns with the angular velocity -omega_3."""
    c0, w, c, w_rate, c_rate = _complex(draws)
    omega, gamma = Gauss(w[0], w[1]), Gauss(c[0], c[1])
    rate = 2 * omega * Gauss(w_rate[0], w_rate[1]) - c0 * Gauss(c_rate[0], c_rate[1])
    return [rate - -I_UNIT * w[2] * (omega * omega - c0 * gamma)]


def law(index: int) -> Difference:
    """Rate of change of one of the four listed quantities along (K1), (K2)."""

    def rate(draws: Draws) -> Sequence[Any]:
        c0, w, c, w_rate, c_rate = _complex(draws)
        w_dual, c_dual = (
            tuple(Dual(x, r) for x, r in zip(values, rates, strict=True))
            for values, rates in ((w, w_rate), (c, c_rate))
        )
        found = printed.kowalevski_laws(c0, (w_dual[0], w_dual[1], w_dual[2]), (c_dual[0], c_dual[1], c_dual[2]))
        return [found[index].rate]

    return rate


def same_laws(draws: Draws) -> Sequence[Any]:
    """2l and E as listed against m·gamma and E of (constant)."""
    c0, w, c = draws.number(), draws.vector(), draws.vector()
    return minus(printed.kowalevski_laws(c0, w, c)[:3], printed.laws((2, 2, 1), (c0, 0, 0), w, c))


def opposite_gravity(draws: Draws) -> Sequence[Any]:
    """The equations for -c0 against those for c0 after a half turn about the third axis."""
    c0, w, c = draws.number(), draws.vector(), draws.vector()
    w_rate, c_rate = printed.kowalevski(-c0, w, c)
    turned = printed.kowalevski(c0, (-w[0], -w[1], w[2]), (-c[0], -c[1], c[2]))
    half_turn = ((-1, -1, 1), (-1, -1, 1))
    found = [
        x
        for rate, sign in zip(turned, half_turn, strict=True)
        for x in (a * b for a, b in zip(rate, sign, strict=True))
    ]
    return minus(found, (*w_rate, *c_rate))


def integrals(draws: Draws) -> list[tuple[Any, ...]]:
    """Gradients of the four listed quantities at a point."""
    c0 = draws.number()
    return gradients(
        lambda at: printed.kowalevski_laws(c0, (at[0], at[1], at[2]), (at[3], at[4], at[5])),
        (*draws.vector(), *draws.vector()),
    )


def _claim(name: str, statement: str, where: str, difference: Difference) -> Claim:
    return Claim(
        f"kowalevski-{name}",
        statement,
        f"section 3.1, {where}",
        IDENTITY,
        "rational identity of the printed equations",
        partial(identity, difference),
    )


CLAIMS = (
    _claim("equations", "(K1), (K2) are the equations of the Kowalevski top.", "(K1), (K2)", special_case),
    _claim("scaling", "A = B = 2, C = 1 is no loss of generality.", "first sentence", any_moment),
    _claim("complex-omega", "The complex equations for ω and its conjugate are (K1).", "before (Kxi)", complex_omega),
    _claim(
        "complex-gamma", "The complex equations for γ, its conjugate and γ₃ are (K2).", "before (Kxi)", complex_gamma
    ),
    _claim("xi-parts", "The rates of ω² and c₀γ are those printed.", "(Kxi), first line", xi_parts),
    _claim("xi", "ξ = ω² - c₀γ satisfies dξ/dt = -iω₃ξ.", "(Kxi), second line", xi_turns),
    _claim("gamma-sq", "γ² is conserved.", "list of conservation laws, 1", law(0)),
    _claim("two-l", "2ℓ = 2(ω₁γ₁ + ω₂γ₂) + ω₃γ₃ is conserved.", "list of conservation laws, 2", law(1)),
    _claim("energy", "E = ω₁² + ω₂² + ω₃²/2 + c₀γ₁ is conserved.", "list of conservation laws, 3", law(2)),
    _claim("k-sq", "k² = |ω² - c₀γ|² is conserved.", "list of conservation laws, 4", law(3)),
    _claim("laws", "The first three are γ², m·γ and E of every top.", "list of conservation laws", same_laws),
    _claim("sign", "The opposite sign of the potential energy only reverses c₀.", "after (Kxi)", opposite_gravity),
    Claim(
        "kowalevski-independent",
        "The four conserved quantities are independent.",
        "section 3.1, last sentence",
        RANK,
        "rank of the gradients at random rational states",
        partial(independent, integrals, 4),
    ),
)
