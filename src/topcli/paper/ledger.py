"""All claims in the order of the paper, then findings beyond it, and their selection by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from topcli.errors import UnknownNameError, nearest, quoted
from topcli.paper.claim import Claim
from topcli.paper.subjects import (
    equations,
    euler,
    figures,
    findings,
    heavy,
    hybrid,
    kowalevski,
    lagrange,
    methods,
)

SUBJECTS: Mapping[str, tuple[Claim, ...]] = {
    "Equations of motion (section 1.1)": equations.CLAIMS,
    "Discrete Euler top (section 1.2)": euler.CLAIMS,
    "HK scheme of heavy tops (sections 2.1, 2.2)": heavy.CLAIMS,
    "BS scheme of the Lagrange top (section 2.3)": lagrange.CLAIMS,
    "Kowalevski top (section 3.1)": kowalevski.CLAIMS,
    "Methods A, B, C and Bohlin's method (section 3.2.2)": methods.CLAIMS,
    "Figures 1 to 3 (sections 3.2.1, 3.2.2)": figures.CLAIMS,
    "Hybrid scheme and summary (sections 3.2.3, 4)": hybrid.CLAIMS,
    "Findings beyond the paper": findings.CLAIMS,
}
LEDGER: tuple[Claim, ...] = tuple(claim for claims in SUBJECTS.values() for claim in claims)


def claim_names() -> list[str]:
    """Names of all claims."""
    return [claim.id for claim in LEDGER]


def chosen(ids: Sequence[str] = (), fast: bool = False) -> list[Claim]:
    """Return the claims to decide, in the order of the ledger; all if none is named.

    With ``fast`` those that are slow are left out unless they are named. Raises UnknownNameError with the nearest
    names.
    """
    known = {claim.id: claim for claim in LEDGER}
    wanted = {name.lower() for name in ids}
    for name in ids:
        if name.lower() not in known:
            raise UnknownNameError(f"unknown claim {quoted(name)}; {_hint(name, known)}")
    return [claim for claim in LEDGER if (claim.id in wanted if wanted else not (fast and claim.slow))]


def _hint(name: str, known: Mapping[str, Claim]) -> str:
    """Nearest names; without any, where they are listed."""
    hint = nearest(name, known)
    return hint if hint.startswith("did you mean") else "topcli claims --fast lists the claims"
