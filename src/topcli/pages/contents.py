"""Content of a page: chapters of facts, tables, pictures and texts, which the template escapes.

The blocks on the origin of a result, its config and files, are common to all chapters.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from topcli.config.load import load
from topcli.config.models import Experiment
from topcli.config.text import to_yaml
from topcli.errors import TopcliError, UsageError, capitalized, shortened
from topcli.runs.report import seconds_note
from topcli.schemes.display import display_name
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.table import DASH, Cells, number
from topcli.tops import CATALOGUE, TOPS

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class Text:
    """A text shown line by line as it is, such as a config."""

    kind: ClassVar[str] = "text"
    title: str
    lines: Sequence[Any]


class Notes(Text):
    """Sentences, each an item of a list."""

    kind = "notes"


class Facts(Text):
    """Pairs of names and their values."""

    kind = "facts"


@dataclass(frozen=True)
class Pictures:
    """Pictures side by side where there is room: SVG, which browsers show without running anything in it, and captions.

    SVG that is drawn in a size of 5 inches is still readable at the width of a phone.
    """

    kind: ClassVar[str] = "pictures"
    title: ClassVar[str] = "Pictures"
    pictures: Sequence[tuple[bytes, str]]

    @property
    def lines(self) -> list[tuple[str, str]]:
        """Address of each picture, which contains it, and its caption."""
        prefix = "data:image/svg+xml;base64,"
        return [(prefix + base64.b64encode(svg).decode(), caption) for svg, caption in self.pictures]


Block = Facts | Cells | Pictures | Text | Notes


@dataclass
class Chapter:
    """One result on the page.

    ``state`` is its outcome in a word, which is ``good`` or not. ``blocks`` are shown, ``details`` folded below them.
    ``data`` is what comparisons with other results need.
    """

    title: str
    kind: str
    subtitle: str = ""
    state: str = ""
    good: bool = True
    message: str = ""
    blocks: list[Block] = field(default_factory=list)
    details: list[Block] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)

    def add(self, *blocks: Block, folded: bool = False) -> None:
        """Add the blocks that have content."""
        (self.details if folded else self.blocks).extend(block for block in blocks if block.lines)


MALFORMED = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError)
"""Errors of code that reads content of another form than this topcli writes."""
LONGEST_TEXT = 400
"""Lines of a config that a page shows; an ensemble may list thousands of states."""
LONGEST_LINE = 2000
PAPER = "K. Sogo, Discrete Spinning Tops: Difference equations for Euler, Lagrange, and Kowalevski tops"
Parts = Iterable[tuple[str, str]]
"""Form of a top and name of a scheme that steps it, for every scheme that took part."""


def value_text(value: object) -> str:
    """Value of a config or manifest in one short line."""
    if value is None:
        return DASH
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return shortened(", ".join(map(str, value)), 200) or DASH
    if isinstance(value, Mapping):
        value = ", ".join(f"{key} = {value_text(part)}" for key, part in value.items())
    return shortened(str(value), 200)


def text_block(title: str, text: str) -> Text:
    """A text line by line, without the rest of very long ones."""
    lines = [shortened(line, LONGEST_LINE) for line in text.splitlines()]
    left = len(lines) - LONGEST_TEXT
    return Text(title, lines if left <= 0 else [*lines[:LONGEST_TEXT], f"... and {left} more lines"])


def config_block(config: Mapping[str, Any]) -> Text:
    """The resolved config as YAML."""
    return text_block("Resolved config", to_yaml(dict(config)))


def _seconds(value: Any) -> str | None:
    """Seconds of a manifest with few digits, or those of a run in a sentence."""
    if isinstance(value, Mapping):
        return seconds_note(value).removesuffix(".")
    return number(value) if isinstance(value, float) else None


def provenance_block(manifest: Mapping[str, Any]) -> Facts:
    """Times, versions, machine, commit and digests of a manifest or a study."""
    commit, dirty = manifest.get("commit"), " with uncommitted changes" if manifest.get("dirty") else ""
    facts = {
        "started": manifest.get("started"),
        "ended": manifest.get("ended", manifest.get("written")),
        "seconds": _seconds(manifest.get("seconds")),
        **(manifest.get("environment") or {}),
        "commit": f"{commit}{dirty}" if commit else None,
        "code of the scheme": manifest.get("scheme_origin"),
        "code of the top": manifest.get("top_origin"),
        "digest of the experiment": manifest.get("digest"),
        "digest of the code": manifest.get("code"),
    }
    return Facts("Provenance", [(name, value_text(value)) for name, value in facts.items() if value is not None])


def files_block(folder: Path, files: Mapping[str, Any]) -> Cells:
    """Files of a folder with the sizes and checksums of the manifest."""
    lines = []
    for name, entry in files.items():
        size, digest = (entry["size"], entry["sha256"]) if isinstance(entry, Mapping) else (entry, DASH)
        lines.append([name, str(size), str(digest)])
    return Cells("Files", ["file", "bytes", "SHA-256"], lines, f"In {folder}", numbers=False)


def experiment_of(config: Mapping[str, Any]) -> Experiment | None:
    """Experiment of a resolved config; None if this topcli does not know its parts."""
    try:
        return load(config)
    except (TopcliError, *MALFORMED):
        return None


def parts_of(experiment: Experiment | None) -> Parts:
    """Top and scheme of an experiment; nothing for None."""
    return [(experiment.top.form, experiment.scheme.name)] if experiment else []


def sources_of(parts: Parts) -> list[str]:
    """Sources of all tops and schemes; a part without a scheme is that of a top alone."""
    sources: list[str] = []
    for form, name in dict.fromkeys(parts):
        if form in TOPS:
            title = TOPS[form].title.partition(" (")[0]
            sources.append(f"{capitalized(title)}: {TOPS[form].citation}")
        if not name:
            continue
        try:
            sources.append(f"{display_name(name)}: {find_scheme(name, form).citation}")
        except UsageError:  # of a top that only a config or a plugin declares
            like = [scheme.citation for scheme in all_schemes() if scheme.name == name and scheme.top in CATALOGUE]
            source = like[0] if like else "source unknown"
            sources.append(f"{shortened(display_name(name))}: {source}")
    return list(dict.fromkeys(sources))


def citation_block(sources: Sequence[str], version: object) -> Notes:
    """Citations: the program, the paper, and the ``sources`` of tops and schemes."""
    release = f", version {shortened(version)}" if isinstance(version, str) else ""
    own = f"the topcli authors, topcli: numerical experiments on discrete spinning tops{release}"
    return Notes("Citation", [own, PAPER, *sources])


def add_origin(chapter: Chapter, manifest: Mapping[str, Any], parts: Parts = ()) -> None:
    """Add config, provenance and citation of a result, from its ``manifest`` or from the data of a study."""
    if config := manifest.get("config"):
        chapter.add(config_block(config), folded=True)
    if manifest.keys() - {"config"}:
        chapter.add(provenance_block(manifest), folded=True)
    version = (manifest.get("environment") or {}).get("topcli")
    chapter.add(citation_block(sources_of(parts), version))
