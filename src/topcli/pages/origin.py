"""Blocks on the origin of a result: config, versions and times, files, and how to cite it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from topcli.config.load import any_from
from topcli.config.models import Experiment
from topcli.config.yaml_text import to_yaml
from topcli.errors import TopcliError, UsageError, shortened
from topcli.pages.contents import Cells, Facts, Notes, Text
from topcli.schemes.registry import find_scheme
from topcli.table import number
from topcli.tops import TOPS

LONGEST_TEXT = 400
"""Lines of a config that a page shows; an ensemble may list thousands of states."""
LONGEST_LINE = 2000
PAPER = "K. Sogo, Discrete Spinning Tops: Difference equations for Euler, Lagrange, and Kowalevski tops"


def value_text(value: object) -> str:
    """Value of a config or manifest in one short line."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return shortened(", ".join(map(str, value)), 200) or "–"
    if isinstance(value, Mapping):
        return shortened(", ".join(f"{key} = {value_text(one)}" for key, one in value.items()), 200)
    return shortened(str(value), 200)


def config_block(config: Mapping[str, Any]) -> Text:
    """The resolved config as YAML."""
    return text_block("Resolved config", to_yaml(dict(config)))


def text_block(title: str, text: str) -> Text:
    """A text line by line, without the rest of very long ones."""
    lines = [shortened(line, LONGEST_LINE) for line in text.splitlines()]
    left = len(lines) - LONGEST_TEXT
    return Text(title, lines if left <= 0 else [*lines[:LONGEST_TEXT], f"... and {left} more lines"])


def provenance_block(manifest: Mapping[str, Any]) -> Facts:
    """Times, versions, machine, commit and digests of a manifest or a study."""
    environment = manifest.get("environment") or {}
    seconds = manifest.get("seconds")
    dirty = " with uncommitted changes" if manifest.get("dirty") else ""
    if isinstance(seconds, Mapping):
        seconds = {name: number(one) if isinstance(one, float) else one for name, one in seconds.items()}
    rows = [
        ("started", manifest.get("started")),
        ("ended", manifest.get("ended", manifest.get("written"))),
        ("seconds", number(seconds) if isinstance(seconds, float) else seconds),
        *((name, environment[name]) for name in environment),
        ("commit", f"{manifest['commit']}{dirty}" if manifest.get("commit") else None),
        ("code of the scheme", manifest.get("scheme_origin")),
        ("digest of the experiment", manifest.get("digest")),
        ("digest of the code", manifest.get("code", manifest.get("source"))),
    ]
    return Facts("Provenance", [(name, value_text(value)) for name, value in rows if value is not None])


def files_block(folder: Path, files: Mapping[str, Any], damage: Mapping[str, str]) -> Cells:
    """Files of a folder with the sizes and checksums of the manifest."""
    lines = []
    for name, entry in files.items():
        size, digest = (entry["size"], entry["sha256"]) if isinstance(entry, Mapping) else (entry, "–")
        lines.append([name, str(size), str(digest), damage.get(name, "intact")])
    broken = dict.fromkeys(damage.values(), "bad")
    header = ["file", "bytes", "SHA-256", "state"]
    return Cells("Files", header, lines, f"In {folder}", numbers=False, marks=broken)


def experiment_of(config: Mapping[str, Any]) -> Experiment | None:
    """Experiment of a resolved config, or the first of an ensemble; None if this topcli does not know its parts."""
    try:
        found = any_from(config)
    except (TopcliError, LookupError, TypeError, ValueError, AttributeError):
        return None
    return found if isinstance(found, Experiment) else found.first


def parts_of(experiment: Experiment | None) -> list[tuple[str, str]]:
    """Top and scheme of an experiment, as ``citation_block`` takes them; nothing for None."""
    return [(experiment.top.form, experiment.scheme.name)] if experiment else []


def citation_block(parts: Iterable[tuple[str, str]], version: object) -> Notes:
    """References to cite: the program, the paper, and the sources of all tops and schemes.

    ``parts`` are the form of a top and the name of a scheme that steps it, for every scheme that took part.
    """
    sources: list[str] = []
    for form, name in dict.fromkeys(parts):
        if form in TOPS:
            sources.append(f"{TOPS[form].kind} top: {TOPS[form].citation}")
        try:
            sources.append(f"scheme {name}: {find_scheme(name, form).citation}")
        except UsageError:
            sources.append(f"scheme {shortened(name)}: its source is unknown to this topcli")
    release = shortened(version) if isinstance(version, str) else "unknown"
    return Notes(
        "Citation",
        [
            f"the topcli authors, topcli: numerical experiments on discrete spinning tops, version {release}",
            PAPER,
            *dict.fromkeys(sources),
        ],
    )
