"""The hard cases: ``CASES`` lists them, and ``suite.stress`` runs schemes through them."""

from __future__ import annotations

from topcli.errors import UnknownNameError, nearest, quoted
from topcli.studies.stress.case import Case
from topcli.studies.stress.kowalevski import KOWALEVSKI
from topcli.studies.stress.others import OTHERS

CASES: tuple[Case, ...] = (*KOWALEVSKI, *OTHERS)


def case_names() -> list[str]:
    """Names of the cases; one name may be shared by cases that ask the same question about several tops."""
    return list(dict.fromkeys(case.name for case in CASES))


def cases_named(name: str) -> list[Case]:
    """Cases called ``name``, matched without case. Raises UnknownNameError with the nearest names."""
    found = [case for case in CASES if case.name == name.lower()]
    if not found:
        raise UnknownNameError(f"unknown case {quoted(name)}; {nearest(name, case_names())}")
    return found
