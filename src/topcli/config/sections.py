"""Sections ``top`` and ``scheme``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from pydantic import BaseModel

from topcli.config.document import Document
from topcli.config.states import vectors_named
from topcli.config.text import KeyPath
from topcli.contracts import Scheme, Top
from topcli.schemes.registry import find_scheme, names_for
from topcli.tops import CUSTOM, top_class, top_names


def read_top(raw: object, names: Iterable[str], document: Document) -> Top:
    """Return the top with its parameters. The vectors and components in ``names`` choose among the forms of a top."""
    kind, where, section = _named_section(raw, "top", "kind", top_names, document)
    if kind.lower() == CUSTOM:
        from topcli.config.formulas import read_custom  # whose models other configs do not need

        cls = read_custom(section, document)
        return top_with(cls, cls.parameters_in(section), document)
    with document.at(*where):
        cls = top_class(kind, vectors_named(kind, names))
    return top_with(cls, section, document)


def top_with(cls: type[Top], parameters: Mapping[str, Any], document: Document, path: KeyPath = ("top",)) -> Top:
    """Return the top of class ``cls`` with these parameters, whose place is ``path``."""
    top = document.read(cls, parameters, *path, beside=("kind",))
    if cls.kind == CUSTOM:
        from topcli.config.formulas import check_numbers

        check_numbers(top, document)
    return top


def read_scheme(raw: object, cls: type[Top], document: Document) -> tuple[Scheme, BaseModel]:
    """Return the scheme for tops of class ``cls``, composed if ``compose`` is given, and its options."""
    name, where, section = _named_section(raw, "scheme", "name", lambda: names_for(cls.form), document)
    with document.at(*where):
        scheme = find_scheme(name, cls.form)
    if "compose" in section:
        with document.at("scheme", "compose"):
            scheme = find_scheme(f"{scheme.name}+{section['compose']}", cls.form)
    return scheme, document.read(scheme.options, section, "scheme", beside=("name", "compose"))


def _named_section(
    raw: object, section: str, key: str, names: Callable[[], list[str]], document: Document
) -> tuple[str, KeyPath, dict[str, Any]]:
    """Return the name, its path and the whole section, from a bare name or a section with ``key``.

    ``names`` lists the known names and is called only for a message.
    """
    name = raw.get(key) if isinstance(raw, dict) else raw
    if isinstance(name, str) and name:
        return (name, (section, key), raw) if isinstance(raw, dict) else (name, (section,), {key: name})
    document.fault((section,), f"must be a name, or a section with {key!r}; known: {', '.join(names())}")
