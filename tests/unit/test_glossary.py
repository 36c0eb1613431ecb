"""One name for each quantity: what commands, reports and sweeps call it is in the glossary."""

from __future__ import annotations

from dataclasses import fields

import topcli
from topcli.analysis.tally import InvariantRow
from topcli.glossary import FAMILY, QUANTITIES, WORDS
from topcli.sweeps.measures import all_measures

OF_THE_ROW = {"name", "symbol", "model", "verdict", "statement", "reason"}
"""Fields of a report's row that are no quantities, or explain one."""


def test_every_measure_of_topcli_has_the_name_unit_and_meaning_of_the_glossary() -> None:
    own = [measure for measure in all_measures() if measure.origin == "topcli"]
    assert len(own) > 15
    for measure in own:
        term = QUANTITIES[measure.name.removesuffix(FAMILY)]
        assert (measure.name, measure.unit, measure.summary) == (term.name, term.unit, term.meaning)


def test_every_number_of_an_invariants_row_is_in_the_glossary() -> None:
    assert {field.name for field in fields(InvariantRow)} - OF_THE_ROW <= QUANTITIES.keys()


def test_columns_of_a_comparison_are_in_the_glossary() -> None:
    frame = topcli.compare("hk", config="kowalevski_generic_hk", h=0.1, N=20).table
    settings = {"scheme", "h", "N", "outcome", "message"}
    names = {name.partition(".")[0] for name in frame.columns} - settings
    assert {"max_error", "final_error", "drift", "max_deviation", "first_swing_spacing"} <= names
    assert names - OF_THE_ROW <= QUANTITIES.keys()


def test_labels_and_meanings_are_complete_and_no_two_quantities_share_one() -> None:
    terms = list(QUANTITIES.values())
    assert all(term.label and term.meaning and term.unit for term in terms)
    assert len({term.label for term in terms}) == len({term.meaning for term in terms}) == len(terms)
    assert not any(term.meaning.endswith(".") for term in (*terms, *WORDS.values()))
