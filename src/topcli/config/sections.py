"""Sections ``top`` and ``scheme``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from pydantic import BaseModel

from topcli.config.document import Document
from topcli.config.states import vectors_named
from topcli.config.text import KeyPath
from topcli.contracts import Scheme, Top
from topcli.schemes.own_tops import top_class, top_names
from topcli.schemes.registry import find_scheme, names_for
from topcli.tops import CUSTOM


def read_top(raw: object, named: Iterable[str], document: Document) -> tuple[type[Top] | None, Top | None]:
    """Return the class of the top, and the top with its parameters; None for each that cannot be read.

    The vectors and components that are ``named`` choose among the forms of a top.
    """
    kind, where, section = _named_section(raw, "top", "kind", top_names, document)
    if not kind:
        return None, None
    cls: type[Top] | None = None
    if kind.lower() == CUSTOM:
        from topcli.config.formulas import read_custom  # whose models other configs do not need

        cls = read_custom(section, document)
        section = cls.parameters_in(section) if cls else {}
    else:
        with document.at(*where):
            cls = top_class(kind, vectors_named(kind, named))
    return cls, top_with(cls, section, document) if cls else None


def top_with(cls: type[Top], parameters: Mapping[str, Any], document: Document, path: KeyPath = ("top",)) -> Top | None:
    """Return the top of class ``cls`` with these parameters; None, and a fault at ``path``, if they cannot be used."""
    before = len(document.faults)
    top = document.read(cls, parameters, *path, beside=("kind",))
    if top is not None and cls.kind == CUSTOM:
        from topcli.config.formulas import check_numbers

        check_numbers(top, document)
    return top if len(document.faults) == before else None


def read_scheme(raw: object, cls: type[Top], document: Document) -> tuple[Scheme, BaseModel] | None:
    """Return the scheme for tops of class ``cls``, composed if ``compose`` is given, and its options."""
    name, where, section = _named_section(raw, "scheme", "name", lambda: names_for(cls.form), document)
    if not name:
        return None
    before = len(document.faults)
    with document.at(*where):
        scheme = find_scheme(name, cls.form)
        if "compose" in section:
            with document.at("scheme", "compose"):
                scheme = find_scheme(f"{scheme.name}+{section['compose']}", cls.form)
        options = document.read(scheme.options, section, "scheme", beside=("name", "compose"))
        return (scheme, options) if options is not None and len(document.faults) == before else None
    return None


def _named_section(
    raw: object, section: str, key: str, names: Callable[[], list[str]], document: Document
) -> tuple[str, KeyPath, dict[str, Any]]:
    """Return the name, its path and the whole section, from a bare name or a section with ``key``; no name if wrong.

    ``names`` lists the known names and is called only for a message.
    """
    name = raw.get(key) if isinstance(raw, dict) else raw
    if isinstance(name, str) and name:
        return (name, (section, key), raw) if isinstance(raw, dict) else (name, (section,), {key: name})
    document.fault((section,), f"must be a name, or a section with {key!r}; known: {', '.join(names())}")
    return "", (section,), {}
