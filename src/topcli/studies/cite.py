"""``topcli cite``: BibTeX of the works that a scheme, a composition or a top is based on.

The field ``used`` of an entry of ``references.bib`` names the schemes, compositions and tops.
"""

from __future__ import annotations

import re
from pathlib import Path

BIBLIOGRAPHY = Path(__file__).with_name("references.bib")
ALWAYS = ("topcli", "sogo")
"""Keys of topcli and of the paper whose schemes it implements."""
_ENTRY = re.compile(r"^@\w+\{(\S+),\n.*?^\}$", re.MULTILINE | re.DOTALL)
_USED = re.compile(r"^  used = \{(.*)\},\n", re.MULTILINE)


def bibliography() -> dict[str, tuple[str, frozenset[str]]]:
    """BibTeX of each work, and the names that use it, by its key."""
    from topcli import __version__

    text = BIBLIOGRAPHY.read_text(encoding="utf-8").replace("{VERSION}", f"{{{__version__}}}")
    works = {}
    for entry in _ENTRY.finditer(text):
        used = ",".join(_USED.findall(entry[0])).replace(" ", "").split(",")
        works[entry[1]] = _USED.sub("", entry[0]), frozenset(used)
    return works


def works_of(name: str) -> dict[str, str]:
    """Return the BibTeX of the works that a scheme, a composition or a top is based on, by their keys.

    Parameters
    ----------
    name : str
        Name of a scheme, with or without ``+composition``, of a composition, or of a top; case-insensitive.

    Returns
    -------
    dict of str to str
        In the order of the bibliography; for the scheme or top of a plugin, an entry with its citation as the note.

    Raises
    ------
    UnknownNameError
        If no scheme, composition or top has this name. The message suggests the nearest names.
    """
    from topcli.errors import UnknownNameError, nearest, quoted
    from topcli.schemes.compose import COMPOSITIONS
    from topcli.schemes.registry import all_schemes
    from topcli.tops import TOPS

    citations = {composition: each.citation for composition, each in COMPOSITIONS.items()}
    citations |= {top.kind: top.citation for top in TOPS.values()}
    citations |= {scheme.name: scheme.citation for scheme in all_schemes()}
    works: dict[str, str] = {}
    name = name.lower()
    for part in [TOPS[name].kind] if name in TOPS else name.split("+"):
        if part not in citations:
            raise UnknownNameError(f"unknown scheme or top {quoted(part)}; {nearest(part, citations)}")
        note = re.sub(r"[{}\\]", "", citations[part])
        listed = {key: bibtex for key, (bibtex, used) in bibliography().items() if part in used}
        works |= listed or {part: f"@misc{{{part},\n  note = {{{note}}},\n}}"}
    return works
