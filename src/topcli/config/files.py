"""Config files: found or refused, read as text, parsed as what their name says they are."""

from __future__ import annotations

import difflib
import os
import stat
from pathlib import Path

from topcli.config.document import Document, KeyPath, describe, plain
from topcli.config.toml_text import parse_toml
from topcli.config.yaml_text import parse_yaml
from topcli.errors import ConfigError, quoted, shortened

MAX_BYTES = 1_000_000
SUFFIXES = (".yaml", ".yml", ".toml")


def read_text(path: Path) -> str:
    """The text of a config file, with line ends as ``\\n`` and without a byte-order mark.

    Raises ConfigError for a missing file (with the nearest names beside it), a folder, a special, unreadable
    or too large file, and for bytes that are not UTF-8 text.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise ConfigError(f"{path}: is a folder; give a config file (.yaml, .yml or .toml)")
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError(f"{path}: is not a regular file; give a config file (.yaml, .yml or .toml)")
        if status.st_size > MAX_BYTES:
            raise ConfigError(f"{path}: {status.st_size} bytes; a config is at most {MAX_BYTES}")
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
    """Half a sentence on the configs that lie where ``path`` was sought; empty when there are none."""
    try:
        names = sorted(entry for entry in os.listdir(path.parent) if entry.endswith(SUFFIXES))
    except (OSError, ValueError):
        return f"; nor is there a folder {path.parent}"
    # by their stems, because the common ending makes any two names look alike
    stems = {Path(name).stem: name for name in names}
    close = [stems[stem] for stem in difflib.get_close_matches(path.stem, stems, n=2)]
    if close:
        return f"; did you mean {' or '.join(map(quoted, close))}?"
    return f"; there are {', '.join(map(shortened, names[:5]))}{', ...' if len(names) > 5 else ''}" if names else ""


def read_document(path: Path) -> Document:
    """Read a YAML or TOML config file.

    Raises ConfigError with ``file:line:column`` for wrong syntax, and as ``read_text`` does.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ConfigError(f"{path}: not a config; the name of a config ends in .yaml, .yml or .toml")
    text = read_text(path)
    parse = parse_toml if suffix == ".toml" else parse_yaml
    data, lines = parse(text, str(path))
    if data is None or data == {}:
        raise ConfigError(f"{path}: is empty; `topcli init` writes a config to start from")
    places: dict[KeyPath, str] = {key: f"{path}:{line}" for key, line in lines.items()}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}:1: a config is a list of `key: value` lines, not {describe(data)}")
    places.setdefault((), f"{path}:{min(lines.values(), default=1)}")
    document = Document(data, places)
    document.data = plain(data, document)
    return document
