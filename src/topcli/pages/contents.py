"""Content of a page: chapters of facts, tables, pictures and texts, as plain strings that the template escapes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from topcli.errors import TopcliError, shortened
from topcli.table import Cells

if TYPE_CHECKING:
    from topcli.contracts import Array
    from topcli.figures.picture import Drawable
    from topcli.store.manifest import StoredRun

REASON_LENGTH = 160
"""Longest reason for missing content that a page repeats."""
DAMAGED, UNFINISHED = "damaged", "unfinished"
"""States of results that are not complete."""


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
class Picture:
    """A picture of one panel over columns of ``data``, drawn with the page; ``name`` is unique within it.

    ``size`` is in inches; that of a picture with few curves is still readable at the width of a phone.
    """

    panel: Drawable
    data: Mapping[str, Array]
    name: str
    caption: str
    size: tuple[float, float] = (5.6, 3.2)


@dataclass(frozen=True)
class Pictures:
    """Pictures side by side where there is room."""

    kind: ClassVar[str] = "pictures"
    title: ClassVar[str] = "Pictures"
    pictures: Sequence[Picture]


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

    def attempt(self, what: str, make: Callable[..., Block | None], *arguments: Any) -> None:
        """Add the block that ``make`` returns, or note that ``what`` is missing; files may hold anything.

        None, and a block without pictures, are left out.
        """
        try:
            block = make(*arguments)
        except MALFORMED as error:
            self.missing.append(f"{what}: {reason_of(error)}")
        else:
            if block is not None and block != Pictures([]):
                self.blocks.append(block)

    def drawn(self, draw: Callable[[Picture], str]) -> dict[str, str]:
        """Draw all pictures, and return them by name; those that cannot be drawn are noted as missing."""
        made: dict[str, str] = {}
        for block in [block for block in self.blocks if isinstance(block, Pictures)]:
            try:
                made |= {picture.name: draw(picture) for picture in block.pictures}
            except MALFORMED as error:
                self.blocks.remove(block)
                self.missing.append(f"pictures: {reason_of(error)}")
        return made

    def damaged(self, reasons: Sequence[str]) -> None:
        """Say that the result is damaged, and why; nothing is said without a reason."""
        if reasons:
            self.state, self.good = DAMAGED, False
            self.missing += reasons

    def check(self, stored: StoredRun) -> Mapping[str, str]:
        """Compare a result with its checksums, and return its damaged files."""
        damage = stored.damage()
        self.damaged([f"{file}: {why}" for file, why in damage.items()])
        return damage


MALFORMED = (TopcliError, OSError, LookupError, TypeError, ValueError, AttributeError, ArithmeticError)
"""Errors of code that reads content of another form than topcli writes."""


def reason_of(error: Exception) -> str:
    """Reason for missing content, in one short line."""
    first = (str(error).splitlines() or [""])[0]
    if not (isinstance(error, TopcliError | OSError) and first):
        first = f"not of the form that topcli writes ({type(error).__name__}: {first})"
    return shortened(first, REASON_LENGTH)
