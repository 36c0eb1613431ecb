"""Numerical experiments on discrete spinning tops.

The names of the Python interface are imported on first use, so that ``import topcli`` takes almost no time::

    import topcli

    trajectory = topcli.simulate("kowalevski_hybrid")
    print(trajectory.to_pandas().head())
    print(trajectory.invariants())
"""

from __future__ import annotations

__version__ = "0.1.0"
STUDIES = {
    "compare": ("topcli.studies.compare", "Compare errors, drifts, reversibility and speed of schemes."),
    "order": ("topcli.studies.order", "Measure errors at several h, and orders of convergence."),
    "bench": ("topcli.studies.bench", "Measure speed against error and name the fastest schemes."),
    "analyse": ("topcli.studies.analyse", "Analyse a time series that another program computed."),
    "roundoff": ("topcli.studies.roundoff", "Measure growth of round-off, and cost of compensated sums."),
    "stress": ("topcli.studies.stress", "Test schemes in hard cases and find what breaks."),
    "check": ("topcli.studies.check", "Check the declared properties of schemes and tops."),
    "claims": ("topcli.paper.claims", "Test the claims of the paper by experiments."),
    "lax": ("topcli.studies.lax", "Check Lax forms (pairs L, M) of a top and the spectrum of L."),
    "integrability": ("topcli.studies.integrability", "Collect evidence on the integrability of a scheme's map."),
    "lyapunov": ("topcli.studies.lyapunov", "Measure Lyapunov exponents and detect chaos."),
    "frequencies": ("topcli.studies.frequencies", "Measure the frequencies of an orbit and detect chaos."),
}
"""Module and first line of the help of each study; the function in the module has the name of the study."""
HOMES = {
    "Motion": "topcli.analysis.motion",
    "Top": "topcli.contracts",
    "Trajectory": "topcli.analysis.trajectory",
    "figure": "topcli.figures.catalogue",
    "measure": "topcli.sweeps.measures",
    "motion": "topcli.cli.running",
    "run": "topcli.cli.running",
    "scheme": "topcli.schemes.registry",
    "simulate": "topcli.runs.simulate",
    "step": "topcli.runs.step_map",
    "sweep": "topcli.cli.running",
    "top": "topcli.tops.own",
    **{name: module for name, (module, _) in STUDIES.items()},
}
"""Modules of the public names; ``__init__.pyi`` declares them for type checkers."""
__all__ = sorted(["__version__", *HOMES])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name not in HOMES:
        raise AttributeError(f"module 'topcli' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(HOMES[name]), name)
