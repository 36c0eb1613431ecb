"""Keys that a sweep may vary, for the tops and schemes that its file names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from topcli.config.problems import unknown_key
from topcli.contracts import Top
from topcli.errors import UsageError
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS, forms

PLAIN = ("scheme", "h", "N", "T", "top", "output.every")
_ENTRIES = ("include", "exclude")


def known_keys(data: dict[str, Any], base: dict[str, Any]) -> list[str]:
    """Return the keys that rows of the sweep file ``data`` may set; unknown tops and schemes add none."""
    keys = [*PLAIN]
    classes = _tops(list(_given(data, base, "top")))
    for cls in classes:
        keys += [f"top.{name}" for name in cls.model_fields]
        keys += [f"initial.{name}" for name in (*cls.vectors, *cls.components)]
    keys += ["initial.normalize", "scheme.compose"]
    for raw in _given(data, base, "scheme"):
        name = raw.get("name") if isinstance(raw, dict) else raw
        if not isinstance(name, str):
            continue
        for cls in classes:
            try:
                keys += [f"scheme.{option}" for option in find_scheme(name, cls.form).options.model_fields]
            except UsageError:
                continue
    if data.get("random") is not None:
        keys += ["sample", "seed"]
    return list(dict.fromkeys(keys))


def _given(data: dict[str, Any], base: dict[str, Any], key: str) -> Iterator[Any]:
    """Yield every value of ``key`` in the base and in the sections that vary it, valid or not."""
    if key in base:
        yield base[key]
    zipped = data.get("zip")
    for section in (data.get("grid"), *(zipped if isinstance(zipped, list) else [zipped])):
        if isinstance(section, dict) and isinstance(section.get(key), list):
            yield from section[key]
    for name in _ENTRIES:
        entries = data.get(name)
        for entry in entries if isinstance(entries, list) else [entries]:
            if isinstance(entry, dict) and key in entry:
                yield entry[key]


def _tops(given: Iterable[Any]) -> list[type[Top]]:
    """Classes of the tops that are named; all tops if none is known."""
    found: list[type[Top]] = []
    for raw in given:
        kind = raw.get("kind") if isinstance(raw, dict) else raw
        try:
            found += forms(kind) if isinstance(kind, str) else []
        except UsageError:
            continue
    return list(dict.fromkeys(found)) or list(TOPS.values())


def unknown_axis(key: str, known: Sequence[str]) -> str:
    """Message about a key that no row of the sweep can set."""
    fixed = {
        "name": "cannot be varied: the rows are named after the sweep",
        "ensemble": "cannot be varied: a row is one trajectory; vary initial states, or draw them by random",
        "output.format": "cannot be varied: it does not change what a row computes",
        "output.columns": "cannot be varied: it does not change what a row computes",
        "sample": "needs the section random, which says what is drawn",
        "seed": "needs the section random, which says what is drawn",
    }
    return fixed.get(key) or unknown_key(key, known)
