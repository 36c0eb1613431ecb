"""Numerical experiments on discrete spinning tops.

The names of the Python interface are imported on first use, so that ``import topcli`` costs nothing::

    import topcli

    trajectory = topcli.simulate("kowalevski_hybrid")
    print(trajectory.to_pandas().head())
    print(trajectory.invariants())
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from topcli.analysis.ensemble import Ensemble as Ensemble
    from topcli.analysis.motion.result import Motion as Motion
    from topcli.analysis.trajectory import Trajectory as Trajectory
    from topcli.runs.simulate import simulate as simulate
    from topcli.runs.simulate_ensemble import simulate_ensemble as simulate_ensemble
    from topcli.schemes.registry import scheme as scheme
    from topcli.show.claims import claims as claims
    from topcli.show.motions import motion as motion
    from topcli.show.runs import run as run
    from topcli.show.stresses import stress as stress
    from topcli.show.study import compare as compare
    from topcli.show.study import order as order
    from topcli.show.sweeps import sweep as sweep
    from topcli.sweeps.measures import measure as measure

__version__ = "0.1.0"
__all__ = [
    "Ensemble",
    "Motion",
    "Trajectory",
    "__version__",
    "claims",
    "compare",
    "measure",
    "motion",
    "order",
    "run",
    "scheme",
    "simulate",
    "simulate_ensemble",
    "stress",
    "sweep",
]

_HOMES = {
    "Ensemble": "topcli.analysis.ensemble",
    "Motion": "topcli.analysis.motion.result",
    "Trajectory": "topcli.analysis.trajectory",
    "claims": "topcli.show.claims",
    "compare": "topcli.show.study",
    "measure": "topcli.sweeps.measures",
    "motion": "topcli.show.motions",
    "order": "topcli.show.study",
    "run": "topcli.show.runs",
    "scheme": "topcli.schemes.registry",
    "simulate": "topcli.runs.simulate",
    "simulate_ensemble": "topcli.runs.simulate_ensemble",
    "stress": "topcli.show.stresses",
    "sweep": "topcli.show.sweeps",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'topcli' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
