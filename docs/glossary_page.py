"""Glossary of the reference, from the names that reports and tables use."""

from __future__ import annotations

from collections.abc import Iterable

from descriptor_pages import Page, grouped, indexed, table

from topcli.errors import capitalized
from topcli.glossary import QUANTITIES, WORDS, Term
from topcli.sweeps.measures import MEASURES


def quantity_rows(terms: Iterable[Term]) -> list[tuple[str, ...]]:
    """Cells of each quantity: name, symbol, unit, meaning, and its use as a measure of sweeps."""
    return [
        (
            f"`{term.name}`",
            "$" + term.symbol.replace("|", r"\vert ") + "$" if term.symbol else "",
            term.unit,
            term.meaning,
            "yes" if term.name in MEASURES else "",
        )
        for term in terms
    ]


def words() -> Page:
    """Words in alphabetical order, as definitions."""
    terms = sorted(WORDS.values(), key=lambda term: term.name.lower())
    found = indexed(*(term.name for term in terms if term.name.lower() not in grouped()))
    for term in terms:
        found += [f"**{term.name}**", f": {capitalized(term.meaning)}.", ""]
    return found


def quantities() -> Page:
    """Table of the quantities."""
    header = ("name", "symbol", "unit", "meaning", "measure")
    return table(header, quantity_rows(QUANTITIES.values()))
