"""Pages on the objects of the Python interface, one each, and the table that lists them."""

from __future__ import annotations

import inspect
from functools import cache
from importlib import import_module

import topcli

Page = list[str]

GROUPS: dict[str, tuple[str, ...]] = {
    "Experiments and studies": (
        *("run", "compare", "sweep", "order", "roundoff", "lyapunov", "frequencies", "integrability"),
        *("lax", "stress", "claims", "analyse", "motion", "check"),
    ),
    "Arrays without files": ("simulate", "simulate_ensemble", "step"),
    "Results": (
        *("Trajectory", "Ensemble", "Motion", "show.report.Report", "show.report.StudyReport"),
        *("show.results.RunReport", "show.results.SweepReport", "show.report.MotionReport"),
    ),
    "Extensions": (
        *("scheme", "top", "measure", "figure", "case", "contracts.Stepper", "sweeps.batch.Batch"),
        *("contracts.Block", "contracts.Sampler", "contracts.Integrability"),
    ),
    "Tops, schemes and invariants": (
        *("Top", "contracts.Scheme", "contracts.Invariant", "contracts.EulerPoisson"),
        *("contracts.Outcome", "contracts.Ending"),
    ),
    "Look up": (
        *("schemes.registry.find_scheme", "schemes.registry.all_schemes", "schemes.compose.find_composition"),
        *("tops.top_class", "studies.citations.works_of"),
        *("config.load.load_experiment", "config.load.load"),
    ),
    "Numbers from trajectories": (
        *("analysis.quantities.Quantity", "analysis.reference.reference_states", "analysis.lax.discrete_lax_defect"),
    ),
    "Errors": ("errors.TopcliError", "errors.UsageError", "errors.RunError", "errors.UnknownNameError"),
}
"""Objects by subject, named from ``topcli`` on."""
MEMBERS = {
    "Top": "constants, invariants, euler_poisson, warnings, new\n   :exclude-members: model_config",
    "Trajectory": "",
    "Ensemble": "",
    "Motion": "",
    "show.report.Report": "save",
    "show.report.StudyReport": "plot, as_dict",
    "show.results.RunReport": "folder, outcome, status, is_ensemble, series, plot, as_dict",
    "show.results.SweepReport": "folder, outcomes, rows, plot, as_dict",
    "show.report.MotionReport": "plot\n   :show-inheritance:",
    "contracts.Scheme": "",
    "contracts.Outcome": "\n   :undoc-members:",
    "analysis.quantities.Quantity": "",
}
"""Members on the pages of classes."""


def documented(name: str) -> object:
    """Object of a name such as ``run`` or ``contracts.Scheme``."""
    module, _, last = name.rpartition(".")
    return getattr(import_module(f"topcli.{module}") if module else topcli, last)


def file_of(name: str) -> str:
    """Name of the page of an object; ``Top`` and ``top`` differ also where files ignore case."""
    return f"class-{name}" if inspect.isclass(documented(name)) else name


def object_page(name: str) -> Page:
    """Page of one object, from its docstring."""
    directive = "autoclass" if inspect.isclass(documented(name)) else "autofunction"
    members = [f"   :members: {MEMBERS[name]}".rstrip(" ")] if name in MEMBERS else []
    short = name.rpartition(".")[2]
    index = "```{index} ! " + short + "\n```"
    return [f"# {short}", "", index, "", "```{eval-rst}", f".. {directive}:: topcli.{name}", *members, "```", ""]


def object_table() -> Page:
    """Table of all objects with the first line of their docstrings, a section for each subject."""
    lines: Page = []
    for title, names in GROUPS.items():
        lines += [f"## {title}", "", "| object | |", "| --- | --- |"]
        for name in names:
            about = (inspect.getdoc(documented(name)) or "").partition("\n\n")[0].replace("\n", " ").replace("``", "`")
            lines += [f"| [`topcli.{name}`](reference/api/{file_of(name)}.md) | {about.replace('|', chr(92) + '|')} |"]
        lines += [""]
    return lines


@cache
def object_files() -> dict[str, str]:
    """Name of the page of each object."""
    return {name: file_of(name) for names in GROUPS.values() for name in names}
