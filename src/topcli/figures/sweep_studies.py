"""Figures of the packaged sweeps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isclose
from typing import TYPE_CHECKING, Any, ClassVar

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

if TYPE_CHECKING:
    from topcli.config.sweep.rows import Row
    from topcli.sweeps.evaluate import Results, Work


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
class _Shown:
    """Back end of a sweep that evaluates the rows that a view shows; others stay unfinished.

    ``keys`` are those of the sweep, ``views`` the conditions of each view.
    """

    keys: tuple[str, ...]
    views: tuple[tuple[str, ...], ...]
    on_progress: Callable[[int, int], None]

    def __call__(
        self, made: Iterable[list[Row]], work: Work, stop: Callable[[], bool]
    ) -> Iterator[tuple[list[Row], Results]]:
        """Yield batches with their results."""
        from topcli.sweeps.run import default_threads, in_threads

        wanted = [shown for batch in made if (shown := [row for row in batch if self._is_shown(row)])]
        done, total = 0, sum(map(len, wanted))
        for batch, results in in_threads(default_threads())(wanted, work, stop):
            yield batch, results
            done += sum(results.done)
            self.on_progress(done, total)

    def _is_shown(self, row: Row) -> bool:
        values = dict(zip(self.keys, row.keys, strict=True))
        return any(satisfies(values, conditions) for conditions in self.views)


def satisfies(values: Mapping[str, Any], conditions: Sequence[str]) -> bool:
    """True if the values of a row's keys satisfy the ``conditions``, as ``SweepRows.where`` reads them."""
    wanted: dict[str, list[str]] = {}
    for name, _, value in (condition.partition("=") for condition in conditions):
        wanted.setdefault(name, []).append(value)
    return all(
        any(
            text == values[name] if isinstance(values[name], str) else isclose(float(text), values[name])
            for text in texts
        )
        for name, texts in wanted.items()
    )


@dataclass(frozen=True)
class SweepStudyFigure(Figure):
    """Views of the packaged sweep ``scene``, of which missing rows that they show are run; finished ones never again.

    ``topcli sweep`` runs the others.
    """

    rank: ClassVar[int] = 1
    views: tuple[View, ...]
    layout: Grid = field(default_factory=Grid)

    def load(self, request: Request) -> Loaded:
        """Return panels and data. Raises UsageError and RunError."""
        from topcli.config.sweep.document import load_sweep
        from topcli.sweeps.run import Watcher, run_sweep

        sweep = load_sweep(self.scene)
        shown = _Shown(sweep.keys, tuple(view.where for view in self.views), request.on_progress)
        result = run_sweep(sweep, request.results, watcher=Watcher(message=request.on_message), backend=shown)
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
