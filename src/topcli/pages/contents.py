"""Content of a page: chapters of facts, tables, pictures and texts, as plain strings that the template escapes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from topcli.errors import TopcliError, shortened
from topcli.table import Cells

REASON_LENGTH = 160
"""Longest reason for missing content that a page repeats."""


@dataclass(frozen=True)
class Facts:
    """Names and their values."""

    kind: ClassVar[str] = "facts"
    title: str
    rows: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Picture:
    """A picture as an SVG element made by ``pages.svg``, with its caption."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Pictures:
    """Pictures side by side where there is room."""

    kind: ClassVar[str] = "pictures"
    title: str
    pictures: Sequence[Picture]


@dataclass(frozen=True)
class Text:
    """A text shown line by line as it is, such as a config."""

    kind: ClassVar[str] = "text"
    title: str
    lines: Sequence[str]


@dataclass(frozen=True)
class Notes:
    """Sentences, each an item of a list."""

    kind: ClassVar[str] = "notes"
    title: str
    lines: Sequence[str]


Block = Facts | Cells | Pictures | Text | Notes


@dataclass
class Chapter:
    """One result on the page.

    ``state`` is its outcome in a word, which is ``good`` or not; ``missing`` lists what could not be shown, and why.
    ``data`` is what comparisons with other results need.
    """

    title: str
    kind: str
    subtitle: str = ""
    state: str = ""
    good: bool = True
    message: str = ""
    missing: list[str] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)

    def attempt(self, what: str, make: Callable[[], Block | None]) -> None:
        """Add the block that ``make`` returns, or note that ``what`` is missing; files may hold anything."""
        try:
            block = make()
        except MALFORMED as error:
            self.missing.append(f"{what}: {reason_of(error)}")
        else:
            if block is not None:
                self.blocks.append(block)


MALFORMED = (TopcliError, OSError, LookupError, TypeError, ValueError, AttributeError, ArithmeticError)
"""Errors of code that reads content of another form than topcli writes."""


def reason_of(error: Exception) -> str:
    """Reason for missing content, in one short line."""
    first = (str(error).splitlines() or [""])[0]
    if isinstance(error, TopcliError | OSError) and first:
        return shortened(first, REASON_LENGTH)
    return shortened(f"not of the form that topcli writes ({type(error).__name__}: {first})", REASON_LENGTH)
