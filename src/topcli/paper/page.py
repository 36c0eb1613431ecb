"""Page of the documentation on the claims of the paper, made from the ledger of claims."""

from __future__ import annotations

from topcli.paper.claim import FAILS, MISPRINT, number_text
from topcli.paper.decide import Claims, Decided
from topcli.paper.ledger import Claim, Excluded, ledger
from topcli.table import Column, Table

HEAD = """# The paper's claims, measured

This page lists every checkable statement (*claim*) of Sogo's *Discrete Spinning Tops*. Each is tested by an
experiment, whose result is compared with a bound. `topcli claims` repeats the experiments, and exits with 4 if a
verdict differs from the one recorded in the repository. `topcli claims ID` shows one claim in detail, and `topcli
claims --json` prints all data. In Python, `topcli.claims()` returns the claims as a table. Names such as `euler_hk` in
the experiments are [scenes](glossary.md).

- The experiment for a claim about a figure uses the initial state, duration and step of the figure. The experiments for
  a general law use random parameters, states and steps.
- Each bound is known before the measurement. The bound follows from round-off, from the order of a scheme, from a
  conservation law or from the width of a line in a printed figure.
- Exact laws are tested in rational numbers, without any tolerance, or with 50 digits. The experiment *rational
  identity* evaluates both sides of an equation of the paper at random rational points. A *rational test* shows whether
  a step is explicit. The test takes the second difference of an equation with respect to its unknowns; this difference
  is 0 if the equation is linear in them.
- The verdict *holds* means that the measured value is within the bound. *holds within* a bound means the same for an
  approximate statement ("very small"). *misprint* means that the printed formula is wrong and the corrected one holds;
  the table then gives the values measured for both formulas.
- Statements that no experiment can test are [listed with the reason](#statements-that-are-not-tested).
- Each kind of check is also applied to [a deliberate error](#kinds-of-checks), to show that the check can fail.

Symbols and labels are those of the paper:

- **State**: ω is the angular velocity, m the angular momentum, and γ the unit vector along the vertical; A, B, C are
  the principal moments of inertia. The centre of gravity is (x0, y0, z0), and g is this vector times the weight.
  Vectors are given in the frame of the body; only those of (L1) and (L2) are given in the frame of space, where a is
  the direction of the top's axis and p that of the vertical. In complex formulas of the Kowalevski top, ω = ω₁ + iω₂
  and γ = γ₁ + iγ₂. Ω, M, Γ and G are the antisymmetric matrices of ω, m, γ and g. A prime marks a value after the step,
  h is the step size, and N is the number of steps. The *general top* has any moments of inertia and any centre of
  gravity.
- **Conserved quantities**: E is the energy, 2ℓ = m·γ is the angular momentum about the vertical, and k² is Kowalevski's
  integral.
- **Schemes**: *HK* is the Hirota-Kimura scheme and *BS* the Bobenko-Suris scheme. *Bohlin's method* advances ω of the
  Kowalevski top, and method (A), (B) or (C) advances its γ. *Bohlin A* combines Bohlin's method with (A). The
  *hybrid* combines HK with a modified BS step. [Schemes](schemes.md) describes all these schemes.
- **Equations** have the paper's labels. (K1) and (K2) are the equations of motion of the Kowalevski top for ω and γ.
  (L1) and (L2) are the BS scheme of the Lagrange top.
- **Figures** of the paper show the Kowalevski top: Figure 1 shows γ and ω under HK, Figure 2 shows them under Bohlin A,
  Figure 3 shows E and 2ℓ under Bohlin A, and Figure 4 shows γ and ω under the hybrid.
- A [*swing*](glossary.md) is one fall and rise of the top. The *levels between swings* are the values of a quantity at
  the start, halfway between successive swings, and at the end.
- The *deviation* of a quantity is its difference from its first value in the run. Its *range* is its maximum minus its
  minimum.
"""
LEFT_OUT = """## Statements that are not tested

No experiment tests these statements of the paper.
"""
CONTROLS = """## Kinds of checks

Each kind of check measures a quantity and compares it with a bound. To show that the check can fail, it is also applied
to a control, which is a deliberate error: a case in which the tested property is known to be false. The value measured
for the control must violate the bound.
"""


def _cell(text: str) -> str:
    """Text that does not end a cell of a table."""
    return text.replace("|", r"\|").replace("*", r"\*").replace("_", r"\_")


def _entry(entry: Claim | Excluded) -> str:
    return f"**{entry.id}**: {_cell(entry.statement)} ({_cell(entry.source)})"


def _statement(row: Decided) -> str:
    """Entry of a claim and its experiment, with the code in it as it is."""
    parts = row.claim.experiment_text.split("`")
    return f"{_entry(row.claim)}<br>{''.join(f'`{x}`' if i % 2 else _cell(x) for i, x in enumerate(parts))}"


def _measured(row: Decided) -> str:
    measured = row.measurement
    if measured is None:
        return row.reason
    corrected = "" if measured.corrected is None else f"; corrected: {number_text(measured.corrected)}"
    return row.figure_text + corrected + (f" ({measured.note})" if measured.note else "")


ROWS = Table(
    list,
    (
        Column("statement and experiment", _statement),
        Column("verdict", lambda row: row.verdict, _cell),
        Column("quantity", lambda row: row.check.measures, _cell),
        Column("measured", _measured, _cell),
        Column("bound", lambda row: row.bound_text, _cell),
    ),
)
LEFT_OUT_ROWS = Table(list, (Column("statement", _entry), Column("reason", lambda entry: entry.reason, _cell)))
CONTROL_ROWS = Table(
    list,
    (
        Column("kind of check", lambda row: row.check.name),
        Column("quantity", lambda row: row.check.measures, _cell),
        Column("control", lambda row: row.check.defect, _cell),
        Column("measured for the control", lambda row: row.figure_text),
        Column("bound", lambda row: row.bound_text),
    ),
)


def claims_page(decided: Claims) -> str:
    """Content of the page: counts, what does not hold, all entries by section, what is left out, controls."""
    rows = {row.claim.id: row for row in decided.rows}
    wrong = [row for row in decided.rows if row.category in (FAILS, MISPRINT)]
    lines = [HEAD, f"{decided.summary}.", ""]
    for title, about, claims in (
        ("What does not hold", "", [row.claim for row in wrong]),
        *((section.title, section.about, section.claims) for section in ledger().sections),
    ):
        if shown := [rows[claim.id] for claim in claims if claim.id in rows]:
            lines += [f"## {title}", "", *([about] if about else []), *ROWS.cells(shown).markdown(), ""]
    lines += [LEFT_OUT, *LEFT_OUT_ROWS.cells(ledger().excluded).markdown(), ""]
    lines += [CONTROLS, *CONTROL_ROWS.cells(decided.controls).markdown()]
    return "\n".join(lines).rstrip() + "\n"
