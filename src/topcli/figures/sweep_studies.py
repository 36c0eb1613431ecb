"""Figures of the packaged sweeps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from topcli.contracts import Array
from topcli.engine.fingerprint import fingerprint
from topcli.errors import RunError
from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.curves import CurvePanel, curve_column
from topcli.figures.picture import Grid
from topcli.figures.sweep import Choice, curves
from topcli.store.manifest import sha256_of
from topcli.sweeps.rows import read_rows


@dataclass(frozen=True)
class View:
    """A panel of curves: a ``choice`` from the rows that satisfy ``where``, under a ``title``.

    ``xlabel`` and ``ylabel`` replace the names of the key and the measure, ``xlog`` makes the horizontal axis
    logarithmic. ``law`` maps x (m,) to the values of a dashed line labelled ``law_label``.
    """

    title: str
    choice: Choice
    where: tuple[str, ...] = ()
    xlabel: str = ""
    ylabel: str = ""
    xlog: bool = False
    law: Callable[[Array], Array] | None = None
    law_label: str = ""


@dataclass(frozen=True)
class SweepStudyFigure(Figure):
    """Views of the packaged sweep ``scene``, whose missing rows are run; finished rows are never run again."""

    rank: ClassVar[int] = 1
    views: tuple[View, ...]
    layout: Grid = field(default_factory=Grid)

    def load(self, request: Request) -> Loaded:
        """Return panels and data. Raises UsageError and RunError."""
        from topcli.config.sweep.document import load_sweep
        from topcli.sweeps.run import Watcher, run_sweep

        def progress(done: int, total: int, failed: int) -> None:
            request.on_progress(done, total)

        result = run_sweep(
            load_sweep(self.scene), request.results, watcher=Watcher(progress, message=request.on_message)
        )
        rows = read_rows(result.folder)
        if not result.outcomes.get("completed"):
            raise RunError(f"{self.name}: no run of the sweep {result.folder} was completed")
        panels: list[CurvePanel] = []
        data: dict[str, np.ndarray] = {}
        for letter, view in zip("abcdefgh", self.views, strict=False):
            panel, columns = _drawn(view, curves(rows.where(view.where), view.choice))
            panels.append(replace(panel, prefix=f"{letter}:", title=f"({letter}) {view.title}".rstrip(), alone=False))
            data |= {f"{letter}:{name}": values for name, values in columns.items()}
        source = {"rows": sha256_of(rows.path), "code": fingerprint(curves, _drawn, compiled=False)}
        return Loaded(tuple(panels), lambda: data, source, self.layout)


def _drawn(
    view: View, drawn: tuple[CurvePanel, Mapping[str, np.ndarray]]
) -> tuple[CurvePanel, Mapping[str, np.ndarray]]:
    """Panel and columns of a view, with its labels and its law."""
    panel, columns = drawn
    panel = replace(
        panel,
        xlabel=view.xlabel or panel.xlabel,
        ylabel=view.ylabel or panel.ylabel,
        xlog=view.xlog or panel.xlog,
    )
    if view.law is None:
        return panel, columns
    x = np.unique(np.concatenate([columns[curve_column(label, "x")] for label in panel.labels]))
    law = {curve_column(view.law_label, "x"): x, curve_column(view.law_label, "y"): view.law(x)}
    return replace(panel, guide=view.law_label), {**columns, **law}
