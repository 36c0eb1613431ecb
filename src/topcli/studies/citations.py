"""Bibliography: the BibTeX entries of ``references.bib``, and the works that schemes and tops cite.

A citation is a text such as ``after Cooper 1987; Yoshida, Phys. Lett. A 150 (1990) 262``. It names the works whose
field ``cited`` it contains.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

BIBLIOGRAPHY = Path(__file__).parent / "references.bib"
OWN = ("topcli", "sogo")
"""Keys of topcli and of the paper whose schemes it implements."""
_ENTRY = re.compile(r"^@(\w+)\{([^,\s]+),\n(.*?)^\}$", re.MULTILINE | re.DOTALL)
_FIELD = re.compile(r"^  (\w+) = \{(.*?)\},$", re.MULTILINE | re.DOTALL)
_ACCENTS = {'"': "\u0308", "'": "\u0301", "`": "\u0300"}


@dataclass(frozen=True)
class Publication:
    """A work of the bibliography: its key, kind and fields, and its BibTeX."""

    key: str
    kind: str
    fields: Mapping[str, str]
    bibtex: str

    @property
    def authors(self) -> tuple[str, ...]:
        """Names of the authors, family names first."""
        return tuple(map(plain_text, self.fields["author"].split(" and ")))

    @property
    def surnames(self) -> str:
        """Family names of all authors, separated by commas."""
        return ", ".join(name.partition(",")[0] for name in self.authors)

    @property
    def cited(self) -> str:
        """Words by which citations name the work; empty for topcli itself."""
        return plain_text(self.fields.get("cited", ""))

    @property
    def addresses(self) -> dict[str, str]:
        """Web addresses of the work by their names, such as ``doi:10.1007/BF02592182``; empty if none is known."""
        found = {}
        if doi := self.fields.get("doi"):
            found[f"doi:{doi}"] = f"https://doi.org/{doi}"
        if eprint := self.fields.get("eprint"):
            found[f"arXiv:{eprint}"] = f"https://arxiv.org/abs/{eprint}"
        if url := self.fields.get("url"):
            found[url] = url
        return found

    @property
    def text(self) -> str:
        """Reference on one line, for people."""
        parts = [self.surnames]
        if "year" in self.fields:
            parts[0] += f" ({self.fields['year']})"
        parts.append(plain_text(self.fields["title"]))
        if "journal" in self.fields:
            parts.append(plain_text(f"{self.fields['journal']} {self.fields['volume']}, {self.fields['pages']}"))
        if "publisher" in self.fields:
            edition = {"2": ", 2nd edition", "3": ", 3rd edition", "4": ", 4th edition"}
            parts.append(plain_text(self.fields["publisher"]) + edition.get(self.fields.get("edition", ""), ""))
        parts += self.addresses
        if "note" in self.fields:
            parts.append(plain_text(self.fields["note"]))
        return ". ".join(parts) + "."


def plain_text(latex: str) -> str:
    """Text of BibTeX without its braces, accents as letters."""
    from unicodedata import normalize

    text = latex.replace(r"{\o}", "ø").replace("--", "\N{EN DASH}")
    text = re.sub(r"\{\\([\"'`])(\w)\}", lambda match: normalize("NFC", match[2] + _ACCENTS[match[1]]), text)
    return " ".join(text.replace("{", "").replace("}", "").split())


@cache
def bibliography() -> dict[str, Publication]:
    """Return all works by their keys."""
    from topcli import __version__

    entries = {}
    for entry in _ENTRY.finditer(BIBLIOGRAPHY.read_text(encoding="utf-8")):
        kind, key, body = entry.groups()
        bibtex = re.sub(r"^  cited = .*\n", "", entry[0], flags=re.MULTILINE)
        if key == OWN[0]:
            body += f"  version = {{{__version__}}},\n"
            bibtex = f"@{kind}{{{key},\n{body}}}"
        entries[key] = Publication(key, kind, dict(_FIELD.findall(body)), bibtex)
    return entries


def works_in(citation: str) -> list[Publication]:
    """Return the works that a citation names, in its order."""
    named = [entry for entry in bibliography().values() if entry.cited and entry.cited in citation]
    return sorted(named, key=lambda entry: citation.index(entry.cited))


def own_works() -> list[Publication]:
    """Return topcli itself and the paper."""
    return [bibliography()[key] for key in OWN]


def works_of(name: str) -> list[Publication]:
    """Return the publications that a scheme, a composition or a top cites.

    Parameters
    ----------
    name : str
        Name of a scheme (with or without ``+composition``), of a composition, or of a top; case-insensitive.

    Returns
    -------
    list of Publication
        Publications in the order in which they are cited, without repetitions. For a publication that a plugin cites
        and that is not in the bibliography of topcli, the list contains an entry with the text of the citation as its
        note.

    Raises
    ------
    UnknownNameError
        If no scheme, composition or top has this name. The message suggests the nearest names.
    """
    citations = _citations(name.lower())
    works: dict[str, Publication] = {}
    for key, citation in citations:
        for entry in works_in(citation) or [_unlisted(key, citation)]:
            works.setdefault(entry.key, entry)
    return list(works.values())


def _unlisted(name: str, citation: str) -> Publication:
    """Publication of a citation that names no work of the bibliography."""
    key = re.sub(r"[^\w-]+", "-", name)
    note = re.sub(r"[{}\\]", "", citation)
    return Publication(key, "misc", {"note": note}, f"@misc{{{key},\n  note = {{{note}}},\n}}")


def _citations(name: str) -> Iterable[tuple[str, str]]:
    """Names and citations of the scheme with its composition, the composition or the top called ``name``."""
    from topcli.errors import UnknownNameError, nearest, quoted
    from topcli.schemes.compose import COMPOSITIONS, find_composition
    from topcli.schemes.own_tops import forms, top_names
    from topcli.schemes.registry import all_schemes

    if name in COMPOSITIONS:
        return [(name, COMPOSITIONS[name].citation)]
    if name in top_names():
        return [(form.form, form.citation) for form in forms(name)]
    base, plus, composition = name.partition("+")
    schemes = all_schemes()
    cited = [(scheme.name, scheme.citation) for scheme in schemes if scheme.name == base]
    if not cited:
        known = {scheme.name for scheme in schemes} | set(top_names()) | set(COMPOSITIONS)
        raise UnknownNameError(f"unknown scheme or top {quoted(name)}; {nearest(base if plus else name, known)}")
    return [*cited, (composition, find_composition(composition).citation)] if plus else cited
