"""Identity of a result: the digest of what was computed, and the digest of the code that computed it.

What a run computes and records is its resolved config without the name and the format of the series: top and
parameters, initial state or ensemble, scheme and options, h, N, recorded rows and columns. A name says where a run is
stored, and every format holds the same bits. The code is the text of the files that the top and the scheme import,
directly or not, in the packages of topcli that make numbers, and of a user's own files. A comment in one of these files
makes it other code; a change elsewhere, as in the command line or the figures, does not.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import topcli
from topcli.contracts import Scheme, Top
from topcli.plugins import own_sources

if TYPE_CHECKING:
    from topcli.config.models import Experiment

ROOMS = ("contracts", "arithmetic", "field", "tops", "schemes", "engine", "analysis")
"""Packages of topcli, and a module, whose code makes the numbers of a run."""
NO_NUMBERS = frozenset(f"topcli.{name}" for name in ("schemes.display", "tops.own"))
"""Modules there that do not."""
LOOPS = ("topcli.engine.machine", "topcli.engine.integration", "topcli.schemes.registry")
"""Modules with the time loops of all schemes, and with the wrappers of their steps."""
_ROOT = Path(topcli.__file__).parent
_IMPORT = re.compile(r"^ *(?:from (topcli[\w.]*) import (\([^)]*\)|.*)|import (topcli[\w.]*))", re.MULTILINE)
canonical = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False).encode
"""Canonical JSON text of plain data, for digests."""


@dataclass(frozen=True)
class Identity:
    """Resolved experiment or ensemble (``config``), the ``digest`` of what it computes, and that of the ``code``.

    Two runs are the same if both digests are equal.
    """

    config: dict[str, Any]
    digest: str
    code: str

    @property
    def key(self) -> str:
        """Eight digits that tell results of one name apart."""
        return digest_of_texts([self.digest, self.code])[:8]


def identity_of(experiment: Experiment) -> Identity:
    """Identity of an experiment or an ensemble. Raises SchemeCodeError for code without a file."""
    config = experiment.resolved()
    parts = {"topcli.engine.attitude": experiment.output.attitude, "topcli.analysis.crossings": experiment.crossings}
    modules = [module for module, needed in parts.items() if needed]
    code = code_digest(type(experiment.top), experiment.scheme, *modules)
    return Identity(config, digest_of(config, experiment.own_code), code)


def digest_of(resolved: Mapping[str, Any], own_code: str) -> str:
    """SHA-256 of what a run computes and records, from its resolved config: 64 hexadecimal digits.

    ``own_code`` is the digest of the code of a user's top and scheme, which a config only names.
    """
    output = {key: value for key, value in resolved["output"].items() if key != "format"}
    computed = {key: value for key, value in resolved.items() if key != "name"} | {"output": output}
    return hashlib.sha256((canonical(computed) + own_code).encode()).hexdigest()


def code_digest(top: type[Top], scheme: Scheme, *modules: str) -> str:
    """Digest of the source code that computes states of a top under a scheme, also in further ``modules``.

    Raises SchemeCodeError for code without a file.
    """
    makers = top.__module__, scheme.maker.__module__
    return source_digest((*LOOPS, *makers, *modules), tuple(own_sources(top, scheme).values()))


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
