"""Figures of comparisons: errors and swings of several schemes over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.picture import REFERENCE, Line, Panel, component_symbol
from topcli.figures.scenes import scene_config

if TYPE_CHECKING:
    from topcli.studies.compare import Comparison


def _panels(labels: Sequence[str], component: str) -> tuple[Panel, Panel]:
    """Errors (left) and the swinging component (right)."""
    return (
        Panel(tuple(Line(f"error:{label}", label) for label in labels), "error of the state", log=True),
        Panel(tuple(Line(f"swing:{label}", label) for label in (REFERENCE, *labels)), component_symbol(component)),
    )


def _data(comparison: Comparison) -> dict[str, np.ndarray]:
    """Series of a comparison; errors of zero become nan because a logarithmic axis has no zero."""
    return {
        name: np.where(values > 0.0, values, np.nan) if name.startswith("error:") else values
        for name, values in comparison.series.items()
    }


def loaded_comparison(comparison: Comparison) -> Loaded:
    """The figure of ``topcli compare``."""
    figures = comparison.figures
    labels = [scheme["label"] for scheme in figures["schemes"]]
    source = {"config": figures["config"], "schemes": labels}
    return Loaded(_panels(labels, figures["reference"]["swing"]), lambda: _data(comparison), source)


@dataclass(frozen=True)
class ComparisonFigure(Figure):
    """The experiment of ``scene`` under several schemes."""

    schemes: tuple[str, ...]

    def load(self, request: Request) -> Loaded:
        """Return the panels and the comparison that makes their columns. Raises UsageError and RunError."""
        from inspect import getsource

        from topcli.analysis.reference import reference_states
        from topcli.config.load import load_experiment
        from topcli.engine.fingerprint import fingerprint
        from topcli.studies.compare import compare_schemes
        from topcli.studies.entries import under_scheme
        from topcli.studies.identity import method_fingerprint

        experiment = load_experiment(scene_config(self.scene, request.configs))
        compared = [under_scheme(experiment, name) for name in self.schemes]
        source = {
            "study": [fingerprint(reference_states, compiled=False), getsource(compare_schemes)],
            "runs": [[one.digest, method_fingerprint(one.method())] for one in compared],
        }
        panels = _panels([one.scheme.name for one in compared], experiment.top.swing)
        return Loaded(panels, lambda: _data(compare_schemes(experiment, self.schemes)), source)
