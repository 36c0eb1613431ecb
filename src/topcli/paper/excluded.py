"""Statements of the paper that the ledger leaves out, each with the reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Excluded:
    """A statement that no experiment decides: its ``source`` in the paper and the ``reason``."""

    name: str
    statement: str
    source: str
    reason: str


EXCLUDED = (
    Excluded(
        "only-three-cases",
        "A fourth integral makes a top completely integrable, and only three cases are.",
        "section 1.1, before case (1)",
        "theorems about all tops; that the three cases have four integrals is decided",
    ),
    Excluded(
        "hk-euler-lax-pair",
        "The HK scheme of the Euler top has a discrete Lax-Moser pair, related to the 2x2 Nahm system.",
        "section 1.2, after the HK scheme",
        "the formulas are in another paper (SogoE); a pair would make the map isospectral, and its two integrals are "
        "decided by hk-euler-corrected-m-sq and hk-euler-corrected-energy",
    ),
    Excluded(
        "equations-simpler",
        "In the inertial frame the equations of the Lagrange top are simpler.",
        "section 2.3, first paragraph",
        "a judgement",
    ),
    Excluded(
        "lagrange-formulas",
        "The formulas of the exact solutions and the other proofs for the Lagrange top.",
        "section 2.3, last sentence",
        "they are in another paper (SogoL); that such solutions exist is decided by lagrange-elliptic and "
        "bs-lagrange-elliptic",
    ),
    Excluded(
        "kowalevski-history",
        "Kowalevski, Jacobi, Neumann and Cartan chose the opposite sign of the potential energy.",
        "section 3.1, after (Kxi)",
        "history; that the sign is a convention is decided by kowalevski-sign",
    ),
    Excluded(
        "yoshida-values",
        "Yoshida used the same initial values, got almost the same figure, and perhaps used a symplectic scheme.",
        "section 3.2.1",
        "about another paper; fig1-motion compares Figure 1 with the motion instead",
    ),
    Excluded(
        "approximation-of-b",
        "Bohlin's method with (B) is merely an approximation: it is not integrable by itself.",
        "section 4, second paragraph",
        "as printed, most orbits of a large step end at z = ∞ (27 of 32 within 2000 steps of 0.4), where neighbours "
        "cannot be compared; HK, the hybrid, (A) and (C) are decided",
    ),
    Excluded(
        "success",
        "The methods are examined for accuracy and efficiency, and the numerical tests are successful.",
        "abstract; section 4, first paragraph",
        "a summary of the figures, which are decided one by one",
    ),
    Excluded(
        "haine-horozov",
        "The top is equivalent to the integrable Clebsch (or Neumann) system, but not by real variables; a resolution "
        "would give the integrable discrete Kowalevski top.",
        "section 4, second paragraph",
        "the paper gives no formulas of that equivalence, and the last part is a prediction",
    ),
)
