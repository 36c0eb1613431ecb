"""Numerical experiments on discrete spinning tops.

The names of the Python interface are imported on first use, so that ``import topcli`` takes almost no time::

    import topcli

    trajectory = topcli.simulate("kowalevski_hybrid")
    print(trajectory.to_pandas().head())
    print(trajectory.invariants())
"""

from __future__ import annotations

__version__ = "0.1.0"
HOMES = {
    "Motion": "topcli.analysis.motion",
    "Top": "topcli.contracts",
    "Trajectory": "topcli.analysis.trajectory",
    "analyse": "topcli.show.report",
    "case": "topcli.studies.stress.cases",
    "check": "topcli.show.report",
    "claims": "topcli.show.report",
    "compare": "topcli.show.report",
    "figure": "topcli.figures.catalogue",
    "frequencies": "topcli.show.report",
    "integrability": "topcli.show.report",
    "lax": "topcli.show.report",
    "lyapunov": "topcli.show.report",
    "measure": "topcli.sweeps.measures",
    "motion": "topcli.show.report",
    "order": "topcli.show.report",
    "roundoff": "topcli.show.report",
    "run": "topcli.show.results",
    "scheme": "topcli.schemes.registry",
    "simulate": "topcli.runs.simulate",
    "step": "topcli.runs.step_map",
    "stress": "topcli.show.report",
    "sweep": "topcli.show.results",
    "top": "topcli.schemes.own_tops",
}
"""Modules of the public names; ``__init__.pyi`` declares them for type checkers."""
__all__ = sorted(["__version__", *HOMES])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name not in HOMES:
        raise AttributeError(f"module 'topcli' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(HOMES[name]), name)
