"""Config and sweep files: search by path or by the name of a packaged one, and reading."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

from topcli.config.document import Document, describe
from topcli.config.text import parse_toml, parse_yaml
from topcli.errors import ConfigError, UnknownNameError, nearest, quoted

SUFFIXES = (".yaml", ".yml", ".toml")


def scene_files(folder: str = "") -> dict[str, Path]:
    """Files of the packaged scenes by name, or of the packaged ``sweeps``; they need no path.

    They are inside the package if a wheel installed it, otherwise in ``configs`` of the checkout.
    """
    package = Path(__file__).resolve().parents[1]
    scenes = package / "scenes" if (package / "scenes").is_dir() else package.parents[1] / "configs"
    return {path.stem: path for path in sorted((scenes / folder).glob("*.*")) if path.suffix in SUFFIXES}


def sweep_files() -> dict[str, Path]:
    """Files of the packaged sweeps by name."""
    return scene_files("sweeps")


def first_sentence(path: Path) -> str:
    """Return the first sentence of the comment at the top of a config; empty if there is none."""
    lines = itertools.takewhile(lambda line: line.startswith("#"), path.read_text(encoding="utf-8").splitlines())
    words = " ".join(line.removeprefix("#").strip() for line in lines)
    return words.split(". ")[0].removesuffix(".")


def find_config(source: Path | str, sweep: bool = False) -> Path:
    """Return the file of ``source``: itself if it is named like a config, otherwise the scene or ``sweep`` called so.

    Scenes are matched without case, and with - for _. Raises UnknownNameError with the nearest scenes.
    """
    path, text = Path(source), os.fspath(source)
    if not text or path.suffix or "/" in text:
        return path  # reading it reports what is wrong with it
    packaged, kind = (sweep_files(), "sweep") if sweep else (scene_files(), "scene")
    name = text.lower().replace("-", "_")
    if name in packaged:
        return packaged[name]
    files = [text + suffix for suffix in SUFFIXES if os.path.isfile(text + suffix)]
    near = f"did you mean the file {files[0]}?" if files else nearest(name, packaged, f"topcli list {kind}s")
    raise UnknownNameError(f"no packaged {kind} is called {quoted(text)} (files end in .yaml, .yml or .toml); {near}")


def is_config(name: str) -> bool:
    """True if ``name`` is that of an existing config file or of a packaged scene."""
    try:
        return os.path.isfile(find_config(name))
    except UnknownNameError:
        return False


def read_document(path: Path) -> Document:
    """Read a YAML or TOML config file.

    Raises ConfigError with ``file:line:column`` for wrong syntax, and with the nearest names for a missing file.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{path}: not a config; its name ends in .yaml, .yml or .toml")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        stems = [other.stem for other in path.parent.glob("*.*") if other.suffix in SUFFIXES]
        near = f"; {nearest(path.stem, stems)}" if stems else ""
        raise ConfigError(f"{path}: no such file{near}") from None
    except (OSError, ValueError) as error:  # also bytes that are not UTF-8
        raise ConfigError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    data, lines = (parse_toml if path.suffix.lower() == ".toml" else parse_yaml)(text, str(path))
    if not isinstance(data, dict) or not data:
        fault = f"a config is a list of `key: value` lines, not {describe(data)}; `topcli init` writes one"
        raise ConfigError(f"{path}:1: {fault}")
    places = {key: f"{path}:{line}" for key, line in lines.items()}
    return Document.of(data, places)
