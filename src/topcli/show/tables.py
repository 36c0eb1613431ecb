"""Tables of stored results and of studies as CSV, Markdown and LaTeX."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.errors import UsageError, nearest, quoted
from topcli.figures.figure import Figure
from topcli.runs.report import ENSEMBLE, INVARIANTS
from topcli.store.files import SEAL, DamagedError, check_study, read_json
from topcli.store.results import read_result
from topcli.studies import imported
from topcli.studies.bench.result import DECADE_TABLE, POINT_TABLE
from topcli.studies.study import Data, Study, stored_result, study_file, study_of
from topcli.table import Table

ENDINGS = {".csv": "csv", ".md": "markdown", ".tex": "latex"}
"""Formats by the ending of a file."""
MAIN = "table"
"""Name of the main table of a result, the one that CSV shows by default."""


@dataclass(frozen=True)
class Tables:
    """Tables of one result, those of its pages first, and the plain data that they show."""

    data: Any
    shown: Sequence[Table]
    further: Sequence[Table] = ()

    @property
    def named(self) -> dict[str, Table]:
        """All tables by name."""
        return {table.name: table for table in (*reversed(self.further), *reversed(self.shown))}

    def chosen(self, name: str | None) -> Tables:
        """The table called ``name`` alone; all for None. Raises UsageError."""
        if name is None:
            return self
        if name not in self.named:
            raise UsageError(f"--table {quoted(name)}: no such table; {nearest(name, list(self.named))}")
        return Tables(self.data, [self.named[name]])

    @property
    def filled(self) -> list[Table]:
        """Tables with rows, the main one first; at least one."""
        known = sorted(self.named.values(), key=lambda table: table.name != MAIN)
        return [table for table in known if len(table.content(self.data)[0])] or known[:1]

    def text(self, form: str) -> str:
        """All tables in a format; of several, the main one as CSV."""
        if form != "csv":
            return "\n".join(table.text(self.data, form) for table in self.shown if table.content(self.data)[0])
        main = self.shown[0] if len(self.shown) == 1 else self.named.get(MAIN, self.shown[0])
        return main.text(self.data, form)


def tables_of(study: Study, data: Any) -> Tables:
    """Tables of the result of a study."""
    return Tables(data, study.tables_of(data), study.frames)


def stored_tables(place: Path) -> Tables:
    """Tables of a run, an ensemble, a benchmark or a study at ``place``. Raises UsageError and RunError."""
    run = read_result(place) if os.path.isdir(place) else None
    if run is not None and run.outcome is not None:
        report = run.report()
        if run.manifest.get("kind") == "bench":
            return Tables(report, [DECADE_TABLE, POINT_TABLE])
        return Tables(report, [ENSEMBLE if report.get("kind") == "ensemble" else INVARIANTS])
    file = study_file(place) if os.path.isdir(place) else place
    if file is None:
        raise UsageError(f"{place}: no run, sweep or study is stored here")
    return tables_of(*read_study(file))


def read_study(file: Path) -> tuple[Study, Data]:
    """Study and its result in a JSON file. Raises UsageError for any other file, and if it is damaged."""
    try:
        data = read_json(file)
        if SEAL in data:
            check_study(data)
    except OSError as error:
        raise UsageError(f"{file}: cannot be read ({error.strerror})") from None
    except DamagedError as error:
        raise UsageError(f"{file}: {error}") from None
    study = study_of(data)
    if study is None:
        raise UsageError(f"{file}: not a result of a study")
    return study, data


def study_figure(file: Path) -> Figure:
    """Figure of the result of a study in a JSON file. Raises UsageError."""
    study, data = read_study(file)
    if not study.figure:
        raise UsageError(f"{file}: a result of topcli {study.name} has no figure of its own")
    result = stored_result(data)
    title = study.head(data).title
    return Figure(
        study.figure_name(data), title, f"topcli {study.name}", lambda request: imported(study.figure)(result)
    )
