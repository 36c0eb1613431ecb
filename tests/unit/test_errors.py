"""Texts that messages are made of."""

from __future__ import annotations

import pytest

from topcli.errors import counted


@pytest.mark.parametrize(
    ("count", "noun", "text"),
    [
        (0, "row", "0 rows"),
        (1, "row", "1 row"),
        (2, "finished row", "2 finished rows"),
        (1, "copy", "1 copy"),
        (3, "trajectory", "3 trajectories"),
    ],
)
def test_a_count_has_the_number_of_its_noun(count: int, noun: str, text: str) -> None:
    assert counted(count, noun) == text
