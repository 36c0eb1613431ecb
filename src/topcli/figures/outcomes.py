"""Figures of outcomes: schemes in the hard cases of their tops, and verdicts on the paper's claims.

The shades of the stress study differ in grey too. The claims have a bar for each part of the paper.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.errors import counted
from topcli.figures.figure import Loaded, study_digest
from topcli.figures.picture import Grid, below_panels
from topcli.figures.style import Styles
from topcli.paper.claim import FAILS, HOLDS, HOLDS_WITHIN, MISPRINT, NOT_TRIED, category_of
from topcli.paper.ledger import ledger
from topcli.schemes.display import display_name
from topcli.studies.stress.study import UNEXPLAINED, known_top
from topcli.studies.study import Result
from topcli.tops import TOPS

STRESS_OUTCOMES = ("not tried", "held", "degraded", "broke")
SHADES = ("#ffffff", "#dcebf5", "#f2a541", "#7b1e2b")
"""In grey: 1.00, 0.90, 0.70 and 0.23. Cells of trials that were not made are hatched too."""
HATCH = {"facecolor": SHADES[0], "edgecolor": "0.55", "hatch": "//////", "linewidth": 0.0}
CELL = 0.155
"""Height of a cell in inches."""
HEAD = 5.2
"""Height of the names above a panel and of its own name below, in cells."""
COLUMNS = (("kowalevski", "heavy", "lagrange/inertial"), ("euler", "euler+gamma", "lagrange"))
"""Tops in the two columns of the picture; other tops follow in the second."""

Names = Mapping[str, Sequence[str]]
"""Names that the numbers in the columns ``top``, ``scheme``, ``case`` and ``outcome`` stand for."""


def figure_data(study: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, list[str]]]:
    """Plotted numbers, one row a trial, and the names that the numbers stand for."""
    trials = study["trials"]
    names = {key: list(dict.fromkeys(trial[key] for trial in trials)) for key in ("top", "scheme", "case")}
    names["outcome"] = list(STRESS_OUTCOMES)
    data = {key: np.array([float(known.index(trial[key])) for trial in trials]) for key, known in names.items()}
    data["step"] = np.array([np.nan if trial["step"] is None else float(trial["step"]) for trial in trials])
    data["unexplained"] = np.array([float(trial["verdict"] in UNEXPLAINED) for trial in trials])
    return data, names


def stress_panel(result: Result, top: str | None = None) -> tuple[StressPanel, dict[str, np.ndarray]]:
    """Panel of all trials of one top, by default the first, and its data. Raises UnknownNameError for another top."""
    data, names = figure_data(result.data)
    return _panel(result.data["trials"], known_top(result.data, top), names, every=True), data


def _step_text(step: float) -> str:
    """A step in a small cell: up to three digits in full, larger ones as a power of ten, without small exponents."""
    if np.isnan(step):
        return ""
    return f"{step:.0f}" if step < 1000 else f"1e{round(np.log10(step))}"


@dataclass(frozen=True)
class StressPanel:
    """The trials of one top: a row for each case, a column for each scheme, a shade for each outcome.

    The cases that all schemes held, ``others`` in number, share the last row.
    """

    top: str
    schemes: tuple[str, ...]
    cases: tuple[str, ...]
    names: Names
    others: int = 0

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the rows."""
        return (*self.cases, *([counted(self.others, "other")] if self.others else []))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the cells into ``axes``."""
        from matplotlib.colors import ListedColormap
        from matplotlib.patches import Rectangle

        values = np.zeros((len(self.rows), len(self.schemes)))
        values[len(self.cases) :] = STRESS_OUTCOMES.index("held")
        for trial in np.flatnonzero(data["top"] == self.names["top"].index(self.top)):
            case = self.names["case"][int(data["case"][trial])]
            if case not in self.cases:
                continue
            row = self.cases.index(case)
            column = self.schemes.index(self.names["scheme"][int(data["scheme"][trial])])
            values[row, column] = data["outcome"][trial]
            if self.names["outcome"][int(values[row, column])] == "broke":
                text = "!" if data["unexplained"][trial] else _step_text(data["step"][trial])
                axes.text(column, row, text, ha="center", va="center", color="white", fontsize=6)
        for row, column in np.argwhere(values == STRESS_OUTCOMES.index("not tried")):
            axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, **HATCH))
        axes.imshow(values, cmap=ListedColormap(SHADES), vmin=-0.5, vmax=3.5, aspect="auto", interpolation="nearest")
        axes.set_xticks(range(len(self.schemes)), map(display_name, self.schemes), rotation=90, fontsize=7)
        axes.set_yticks(range(len(self.rows)), self.rows, fontsize=7)
        axes.xaxis.tick_top()
        axes.set_xticks(np.arange(len(self.schemes) + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(len(self.rows) + 1) - 0.5, minor=True)
        axes.tick_params(which="both", length=0, pad=2)
        axes.grid(False)
        axes.grid(which="minor", color="white", linewidth=0.8)
        axes.set_xlabel(TOPS.called(self.top), fontsize=9, labelpad=3)


def _in_columns(tops: Sequence[str]) -> list[list[str]]:
    """The tops in the columns of the picture, without empty ones."""
    named = {top for column in COLUMNS for top in column}
    columns = [[top for top in column if top in tops] for column in COLUMNS]
    columns[1] += [top for top in tops if top not in named]
    return [column for column in columns if column]


@dataclass(frozen=True)
class StressGrid(Grid):
    """Panels in two columns whose cells have equal sizes, and a legend of the shades."""

    figsize: tuple[float, float] | None = (7.0, 6.0)

    def axes(self, figure: Any, panels: Sequence[Any]) -> list[Any]:
        """Axes of the panels in their order."""
        by_top = {panel.top: panel for panel in panels}
        columns = [[by_top[top] for top in column] for column in _in_columns(list(by_top))]
        widths = [max(len(panel.schemes) for panel in column) for column in columns]
        outer = figure.add_gridspec(1, len(columns), width_ratios=widths)
        places: dict[str, Any] = {}
        for index, column in enumerate(columns):
            inner = outer[0, index].subgridspec(
                len(column), 1, height_ratios=[len(panel.rows) + HEAD for panel in column]
            )
            places |= {panel.top: figure.add_subplot(inner[row, 0]) for row, panel in enumerate(column)}
        return [places[panel.top] for panel in panels]

    def annotate(self, figure: Any) -> None:
        """Add the legend of the shades."""
        from matplotlib.patches import Patch

        meanings = {
            "held": SHADES[1],
            "degraded: invariants kept, accuracy lost": SHADES[2],
            "broke, at the step in the cell (! undeclared)": SHADES[3],
        }
        handles = [Patch(facecolor=shade, edgecolor="0.6") for shade in meanings.values()]
        handles.append(Patch(**HATCH))
        below_panels(figure, handles, [*meanings, "not tried"], 4, fontsize=7.5, handlelength=1.0)


def loaded_stress(result: Result) -> Loaded:
    """The figure of a study of hard cases, with a panel for each top."""
    study = result.data
    data, names = figure_data(study)
    panels = [_panel(study["trials"], top, names) for column in _in_columns(names["top"]) for top in column]
    by_top = {panel.top: panel for panel in panels}
    heights = [sum(len(by_top[top].rows) + HEAD for top in column) for column in _in_columns(names["top"])]
    layout = StressGrid(figsize=(7.0, 0.4 + CELL * max(heights)))
    made_from = {"study": study_digest(study)}
    return Loaded(panels, lambda: data, made_from, layout, {"topcli.names": json.dumps(names)})


def _panel(trials: Sequence[Mapping[str, Any]], top: str, names: Names, every: bool = False) -> StressPanel:
    """Panel of the trials of one top, with a row for each case that not all schemes held, or for ``every`` case."""
    own = [trial for trial in trials if trial["top"] == top]
    schemes, cases = (tuple(dict.fromkeys(trial[key] for trial in own)) for key in ("scheme", "case"))
    held = {(trial["scheme"], trial["case"]) for trial in own if trial["outcome"] == "held"}
    shown = tuple(case for case in cases if every or any((scheme, case) not in held for scheme in schemes))
    return StressPanel(top, schemes, shown, names, len(cases) - len(shown))


LOOKS = {
    HOLDS: ("#0072B2", "white"),
    HOLDS_WITHIN: ("#56B4E9", "black"),
    MISPRINT: ("#E69F00", "black"),
    FAILS: ("#D55E00", "white"),
    NOT_TRIED: ("0.8", "black"),
}
"""Colours of the bars and of the numbers in them, in the order of the legend."""
OTHERS = "other claims"


@dataclass(frozen=True)
class VerdictPanel:
    """Number of statements with each verdict, a stacked bar for each of the ``subjects``.

    The columns are the ``verdicts``, each with a number of claims for every subject.
    """

    subjects: tuple[str, ...]
    verdicts: tuple[str, ...]

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the bars into ``axes``, the first subject on top."""
        rows = np.arange(len(self.subjects))
        left = np.zeros(len(rows))
        for verdict in self.verdicts:
            counts = data[verdict]
            colour, ink = LOOKS[verdict]
            axes.barh(rows, counts, left=left, height=0.72, color=colour, label=verdict)
            for row in np.flatnonzero(counts):
                at = (left[row] + 0.5 * counts[row], row)
                axes.text(*at, f"{counts[row]:.0f}", ha="center", va="center", color=ink, fontsize="small")
            left = left + counts
        axes.set_yticks(rows, self.subjects)
        axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(0.0, 1.02 * left.max()), xlabel="number of statements")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.tick_params(axis="y", length=0)
        axes.grid(False)
        look: dict[str, Any] = {"fontsize": "small", "frameon": False, "handlelength": 1.2, "columnspacing": 1.2}
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(LOOKS), borderaxespad=0.2, **look)


def verdict_panel(claims: Sequence[Mapping[str, Any]]) -> tuple[VerdictPanel, dict[str, np.ndarray]]:
    """Panel and data of decided claims, given as the plain data of ``topcli claims --json``."""
    homes = {claim.id: section.title.partition(" (")[0] for section in ledger().sections for claim in section.claims}
    pairs = [(homes.get(one["id"], OTHERS), category_of(one["verdict"])) for one in claims]
    present = {subject for subject, _ in pairs}
    subjects = tuple(subject for subject in dict.fromkeys((*homes.values(), OTHERS)) if subject in present)
    verdicts = tuple(verdict for verdict in LOOKS if any(found == verdict for _, found in pairs))
    data = {verdict: np.array([float(pairs.count((one, verdict))) for one in subjects]) for verdict in verdicts}
    return VerdictPanel(subjects, verdicts), data


def loaded_claims(result: Result) -> Loaded:
    """Picture of decided claims."""
    panel, data = verdict_panel(result.data["claims"])
    return Loaded([panel], lambda: data, {})
