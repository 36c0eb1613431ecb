"""Digests of source code, which tell results of one code from those of another."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import topcli

ROOMS = ("contracts", "arithmetic", "field", "tops", "schemes", "engine", "analysis")
"""Packages of topcli, and a module, whose code makes the numbers of a run."""
NO_NUMBERS = frozenset(f"topcli.{name}" for name in ("schemes.display", "tops.own"))
"""Modules there that do not."""
_ROOT = Path(topcli.__file__).parent
_IMPORT = re.compile(r"^ *(?:from (topcli[\w.]*) import (\([^)]*\)|.*)|import (topcli[\w.]*))", re.MULTILINE)


def digest_of_texts(texts: Iterable[str]) -> str:
    """SHA-256 of texts in their order, 64 hexadecimal digits; empty for no texts."""
    parts = [hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest() for text in texts]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest() if parts else ""


@cache
def package_digest() -> str:
    """Digest of all files of topcli; any edit changes it."""
    files = sorted(path for path in _ROOT.rglob("*") if path.is_file() and path.suffix != ".pyc")
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _imported(text: str) -> list[str]:
    """Names of modules of topcli that a source may import, also inside its functions."""
    names = []
    for module, items, whole in _IMPORT.findall(text):
        names += [module or whole, *(f"{module}.{item}" for item in re.findall(r"\w+", items))]
    return names


@cache
def _module(name: str) -> str:
    """Text of a module of the ``ROOMS`` with that of its files in other languages; empty for any other name."""
    room, path = name.split(".")[1:2], _ROOT.parent / name.replace(".", "/")
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    if not room or room[0] not in ROOMS or name in NO_NUMBERS or not path.is_file():
        return ""
    beside = sorted(path.parent.glob("catalogue/*.yaml" if name == "topcli.tops.declared" else f"{path.stem}.ll"))
    return "\0".join(file.read_text(encoding="utf-8") for file in (path, *beside))


@cache
def source_digest(modules: tuple[str, ...], plugins: tuple[str, ...] = ()) -> str:
    """Digest of modules of the ``ROOMS``, of the texts of ``plugins``, and of all that both import in the rooms."""
    texts: dict[str, str] = {}
    waiting = [*modules, *(name for text in plugins for name in _imported(text))]
    while waiting:
        name = waiting.pop()
        if name not in texts:
            texts[name] = _module(name)
            waiting += _imported(texts[name])
    return digest_of_texts([*plugins, *(f"{name}\0{texts[name]}" for name in sorted(texts) if texts[name])])
