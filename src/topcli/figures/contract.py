"""The protocol of a figure: it loads its panels, their data and their source; ``make`` draws and writes them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from topcli.errors import UsageError
from topcli.figures.picture import Drawable, Grid


class NothingMeasuredError(UsageError):
    """A figure of measurements that have not been taken yet (exit code 2)."""


def ignored(*news: object) -> None:
    """Ignore progress or a message."""


@dataclass(frozen=True)
class Request:
    """Folders of results and configs, and permissions to produce missing results.

    With ``force`` existing results are produced again. With ``stored_only`` a figure whose results take minutes is
    loaded from existing results or raises NothingMeasuredError. ``overrides`` are ``key=value`` texts for the configs
    of the runs that are drawn, ``overlay`` draws the exact motion behind them, and the parameters of matplotlib in
    ``style`` replace those of the print style.
    """

    results: Path = Path("results")
    configs: Path = Path("configs")
    force: bool = False
    stored_only: bool = False
    on_progress: Callable[[int, int], None] = ignored
    on_message: Callable[[str], None] = ignored
    overrides: tuple[str, ...] = ()
    overlay: bool = False
    style: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Loaded:
    """Content of a figure.

    ``source`` is plain data that identifies what the figure is made from; ``data`` is called only if the figure must be
    drawn. ``metadata`` is stored with the plotted data. ``variant`` distinguishes the files of a figure that overrides
    have changed.
    """

    panels: Sequence[Drawable]
    data: Callable[[], Mapping[str, np.ndarray]]
    source: Mapping[str, Any]
    layout: Grid = field(default_factory=Grid)
    metadata: Mapping[str, str] = field(default_factory=dict)
    variant: str = ""


@dataclass(frozen=True)
class Figure(ABC):
    """A figure of the catalogue.

    ``name`` is that on the command line and of the files, ``title`` a description in one line, ``scene`` the scene or
    command that the results come from. ``takes_overrides`` and ``takes_overlay`` say which requests it can fulfil, and
    ``rank`` when it begins among several: 0 for the paper's figures, 1 for those that take longest.
    """

    takes_overrides: ClassVar[bool] = False
    rank: ClassVar[int] = 2
    name: str
    title: str
    scene: str

    @property
    def needs(self) -> frozenset[str]:
        """Stored results that it reads or makes, which no other process may make at the same time."""
        return frozenset()

    @property
    def takes_overlay(self) -> bool:
        """True if the figure can show the exact motion."""
        return False

    @abstractmethod
    def load(self, request: Request) -> Loaded:
        """Return panels, data and source. Raises UsageError and RunError."""
