"""Config and sweep files: search by path or name, reading, and overrides such as ``h=0.01``."""

from __future__ import annotations

import difflib
import itertools
import os
import re
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from topcli.config.document import Document, KeyPath, describe, key_text, plain
from topcli.config.text import parse_toml, parse_yaml
from topcli.errors import ConfigError, UnknownNameError, nearest, quoted, shortened

MAX_CONFIG_BYTES = 1_000_000
SUFFIXES = (".yaml", ".yml", ".toml")


def scene_folder() -> Path:
    """Folder of the scenes: inside the package if a wheel installed it, otherwise ``configs`` of the checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "scenes"
    return inside if inside.is_dir() else package.parents[1] / "configs"


def scene_files() -> dict[str, Path]:
    """Files of the packaged scenes by name; a scene is a config that needs no path."""
    folder = scene_folder()
    if not folder.is_dir():
        return {}
    return {path.stem: path for path in sorted(folder.iterdir()) if path.suffix in SUFFIXES}


def first_sentence(path: Path) -> str:
    """Return the first sentence of the comment at the top of a config; empty if there is none."""
    lines = itertools.takewhile(lambda line: line.startswith("#"), path.read_text(encoding="utf-8").splitlines())
    words = " ".join(line.removeprefix("#").strip() for line in lines)
    return words.split(". ")[0].removesuffix(".")


def sweep_files() -> dict[str, Path]:
    """Files of the packaged sweeps by name."""
    folder = scene_folder() / "sweeps"
    return {path.stem: path for path in sorted(folder.iterdir())} if folder.is_dir() else {}


def find_config(source: Path | str, sweep: bool = False) -> Path:
    """Return the file of ``source``: itself if it is named like a config, otherwise the scene or ``sweep`` called so.

    Scenes are matched without case, and with - for _. Raises UnknownNameError with the nearest scenes.
    """
    path, text = Path(source), os.fspath(source)
    if not text or path.suffix or os.sep in text or "/" in text:
        return path  # reading it reports what is wrong with it
    packaged, kind = (sweep_files(), "sweep") if sweep else (scene_files(), "scene")
    wanted = text.lower().replace("-", "_")
    for name, file in packaged.items():
        if name.lower().replace("-", "_") == wanted:
            return file
    files = [text + suffix for suffix in SUFFIXES if os.path.isfile(text + suffix)]
    near = f"did you mean the file {files[0]}?" if files else nearest(wanted, packaged, f"topcli list {kind}s")
    raise UnknownNameError(f"no packaged {kind} is called {quoted(text)} (files end in .yaml, .yml or .toml); {near}")


def is_config(name: str) -> bool:
    """True if ``name`` is that of an existing config file or of a packaged scene."""
    try:
        return os.path.isfile(find_config(name))
    except UnknownNameError:
        return False


def read_text(path: Path) -> str:
    """Return the text of a config file, with line ends as ``\\n`` and without a byte-order mark.

    Raises ConfigError for a missing file (with the nearest names beside it), a folder, a special, unreadable
    or too large file, and for bytes that are not UTF-8 text.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise ConfigError(f"{path}: is a folder; give a config file (.yaml, .yml or .toml)")
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError(f"{path}: is not a regular file; give a config file (.yaml, .yml or .toml)")
        if status.st_size > MAX_CONFIG_BYTES:
            raise ConfigError(f"{path}: {status.st_size} bytes; a config is at most {MAX_CONFIG_BYTES}")
        content = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file{_files_nearby(path)}") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise ConfigError(f"{path}: cannot be read: {reason}") from None
    if b"\0" in content:
        raise ConfigError(f"{path}: is a binary file; a config is UTF-8 text")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            f"{path}:{line}: is not UTF-8 text (byte 0x{content[error.start]:02x}); a config is UTF-8 text"
        ) from None
    return text.replace("\r\n", "\n")


def _files_nearby(path: Path) -> str:
    """End of a message about a missing file: the configs in its folder; empty if there are none."""
    try:
        names = sorted(entry for entry in os.listdir(path.parent) if entry.endswith(SUFFIXES))
    except (OSError, ValueError):
        return f"; nor is there a folder {path.parent}"
    # by their stems, because the common ending makes any two names look alike
    stems = {Path(name).stem: name for name in names}
    close = [stems[stem] for stem in difflib.get_close_matches(path.stem, stems, n=2)]
    if close:
        return f"; did you mean {' or '.join(map(quoted, close))}?"
    return (
        f"; configs there: {', '.join(map(shortened, names[:5]))}{', ...' if len(names) > 5 else ''}" if names else ""
    )


def read_document(path: Path) -> Document:
    """Read a YAML or TOML config file.

    Raises ConfigError with ``file:line:column`` for wrong syntax, and as ``read_text`` does.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        inside = path / "config.yaml"
        known = (
            f"; that of this run is {inside}" if os.path.isfile(inside) else "; its name ends in .yaml, .yml or .toml"
        )
        raise ConfigError(f"{path}: not a config{known}")
    text = read_text(path)
    if suffix == ".toml":
        data, lines = parse_toml(text, str(path))
    else:
        data, lines = parse_yaml(text, str(path))
    if data is None or data == {}:
        raise ConfigError(f"{path}: is empty; `topcli init` writes a config to start from")
    if not isinstance(data, dict):
        raise ConfigError(f"{path}:1: a config is a list of `key: value` lines, not {describe(data)}")
    places: dict[KeyPath, str] = {key: f"{path}:{line}" for key, line in lines.items()}
    places.setdefault((), f"{path}:{min(lines.values(), default=1)}")
    document = Document(data, places)
    if suffix == ".toml":  # which has dates, and no bounds
        document.data = plain(data, document)
    return document


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
