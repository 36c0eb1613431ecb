"""``--set key=value``: one key of a config set from the command line, before the config is validated."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from topcli.config.document import Document, describe, key_text
from topcli.config.yaml_text import parse_yaml
from topcli.errors import ConfigError, quoted, shortened

_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_POSITION = re.compile(r"^(:\d+)*: ")
BARE = {"top": "kind", "scheme": "name"}
"""Sections that may be given as a bare name, each with the key whose value the name is."""
PARTNER = {"T": "N", "N": "T"}
"""Keys of which a config has one, each with the one whose place it takes."""
_EXPERIMENTS = ((), ("base",))
"""Places of a config in a document: as a whole, or in the section ``base`` of a sweep."""


def parse_override(text: str, label: str = "") -> tuple[tuple[str, ...], Any]:
    """Return the path and the value of ``key=value``: a dotted path, and a value in YAML.

    ``label`` names the text in messages, by default as an override.

    >>> parse_override("initial.gamma=[auto, 0, 1e-3]")
    (('initial', 'gamma'), ['auto', 0, 0.001])

    Raises ConfigError naming the text.
    """
    key, equals, value = text.partition("=")
    path = tuple(part.strip() for part in key.split("."))
    label = label or override_label(text)
    if not equals:
        raise ConfigError(f"{label}: expected key=value, such as h=0.01")
    if not all(_KEY.fullmatch(part) for part in path):
        raise ConfigError(f"{label}: {quoted(key)} is not a key; expected key=value with a key such as h or top.c0")
    if not value.strip():
        raise ConfigError(f"{label}: no value is given; expected key=value, such as h=0.01")
    try:
        data, _ = parse_yaml(value, "")
    except ConfigError as error:
        raise ConfigError(f"{label}: {_POSITION.sub('', str(error))}") from None
    return path, data


def override_label(text: str) -> str:
    """Name of an override in messages."""
    shown = shortened(text)
    return f"--set {shown}" if shown.isprintable() else f"--set {shown!r}"


def apply_overrides(document: Document, overrides: Sequence[str]) -> None:
    """Set the overridden keys in ``document``; whole sections before keys inside them, in whichever order given.

    T takes the place of N, and N that of T. A bare name of a top or a scheme becomes a section if a key inside it is
    set.
    Raises ConfigError for a malformed or repeated override, and for a key inside a value that is not a section.
    """
    parsed: dict[tuple[str, ...], tuple[str, Any]] = {}
    for text in overrides:
        path, value = parse_override(text)
        if path in parsed:
            earlier = override_label(parsed[path][0])
            raise ConfigError(f"{override_label(text)}: {key_text(path)} is already set by {earlier}; set it once")
        parsed[path] = (text, value)
    drop_partner(document.data, {path[0]: value for path, (_, value) in parsed.items() if len(path) == 1})
    for path in sorted(parsed, key=len):
        text, value = parsed[path]
        _set(document, path, value, override_label(text))


def _set(document: Document, path: tuple[str, ...], value: Any, label: str) -> None:
    section = document.data
    for depth, key in enumerate(path[:-1]):
        inner: Any = section.get(key)
        if inner is None:
            inner = {}
        elif path[:depth] in _EXPERIMENTS and key in BARE and isinstance(inner, str):
            inner = {BARE[key]: inner}
        elif not isinstance(inner, dict):
            whole = key_text(path[: depth + 1])
            raise ConfigError(f"{label}: {whole} is {describe(inner)}, not a section; set {whole} as a whole")
        section[key] = inner
        section = inner
    section[path[-1]] = value
    for known in [known for known in document.places if known[: len(path)] == path]:
        del document.places[known]
    document.places[path] = label


def drop_partner(data: dict[str, Any], changes: Mapping[str, Any]) -> None:
    """Remove N from a config if ``changes`` set T, and T if they set N; nothing if they set both or neither."""
    for key, other in PARTNER.items():
        if key in changes and other not in changes:
            data.pop(other, None)
