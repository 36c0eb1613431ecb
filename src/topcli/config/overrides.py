"""Overrides of a config such as ``h=0.01``: the option ``--set`` and the argument ``overrides``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from topcli.config.document import Document, describe, key_text, plain_data
from topcli.config.text import parse_yaml
from topcli.errors import ConfigError, shortened

BARE = {"top": "kind", "scheme": "name"}
"""Sections that may be given as a bare name, each with the key whose value the name is."""
PARTNER = {"T": "N", "N": "T"}
"""Keys of which a config has one, each with the one whose place it takes."""
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def override_label(text: str) -> str:
    """Name of an override in messages, and the place of the key that it sets."""
    return f"--set {shortened(text)}"


def parse_override(text: str, label: str = "") -> tuple[tuple[str, ...], Any]:
    """Return the path and the value of ``key=value``: a dotted path, and a value in YAML.

    ``label`` names the text in messages, by default as an override.

    >>> parse_override("initial.gamma=[auto, 0, 1e-3]")
    (('initial', 'gamma'), ['auto', 0, 0.001])

    Raises ConfigError naming the text.
    """
    key, _, value = text.partition("=")
    path = tuple(part.strip() for part in key.split("."))
    label = label or override_label(text)
    if not value.strip() or not all(_KEY.fullmatch(part) for part in path):
        raise ConfigError(f"{label}: expected key=value, such as h=0.01 or top.c0=2")
    return path, parse_yaml(value, label)[0]


def apply_overrides(document: Document, overrides: Sequence[str]) -> None:
    """Set the overridden keys in ``document``; whole sections before keys inside them, in whichever order given.

    T takes the place of N, and N that of T. A bare name of a top or a scheme becomes a section if a key inside it is
    set. Raises ConfigError for a malformed override, and for a key inside a value that is not a section.
    """
    parsed = [(*parse_override(text), override_label(text)) for text in overrides]
    drop_partner(document.data, {path[0]: value for path, value, _ in parsed if len(path) == 1})
    for path, value, label in sorted(parsed, key=lambda item: len(item[0])):
        set_key(document, path, value, label)


def set_key(document: Document, path: tuple[str, ...], value: Any, place: str) -> None:
    """Set the key ``path``, with ``place`` for messages. Raises ConfigError for a key inside what is no section."""
    section = document.data
    for depth, key in enumerate(path[:-1]):
        inner: Any = section.get(key)
        if key in BARE and isinstance(inner, str):
            inner = {BARE[key]: inner}
        elif inner is not None and not isinstance(inner, dict):
            whole = key_text(path[: depth + 1])
            raise ConfigError(f"{place}: {whole} is {describe(inner)}, not a section; set {whole} as a whole")
        section[key] = section = dict(inner or {})
    if isinstance(section.get(path[-1]), dict | list):  # whose keys have places
        document.places = {key: where for key, where in document.places.items() if key[: len(path)] != path}
    section[path[-1]] = plain_data(value, Document({}, {path: place}), path)
    document.places[path] = place


def drop_partner(data: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Remove N from a config if ``changes`` set T, and T if they set N; nothing if they set both or neither."""
    for key, other in PARTNER.items():
        if key in changes and other not in changes:
            data.pop(other, None)
