"""Initial state that is the last one of a stored run: ``initial: {from: RUN}``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from topcli.config.document import describe
from topcli.contracts import Outcome, Top
from topcli.errors import UsageError
from topcli.store.results import StoredResult, read_result
from topcli.store.series import read_series, series_names

RESULTS = Path("results")
"""Folder in which a run is found by its name."""


def last_state(initial: Mapping[str, Any], top_of: Callable[[Any], Top]) -> dict[str, Any]:
    """Section ``initial`` with the last state of the stored run that the given section names by ``from``.

    ``top_of(section)`` is the top of the config with this section; it must be that of the run. Raises UsageError.
    """
    name = initial["from"]
    if others := [key for key in initial if key not in ("from", "normalize")]:
        raise UsageError(f"from gives the whole state; leave out {', '.join(others)}")
    run = (read_result(Path(name)) or read_result(RESULTS / name)) if isinstance(name, str) and name else None
    if run is None or run.outcome is None:
        raise UsageError(f"from: {describe(name)} is no finished run; give its name in {RESULTS}, or its folder")

    config = run.manifest["config"]
    if fault := _unfit(run):
        raise UsageError(f"from: the run {run.folder} {fault}")
    top = top_of(config["initial"])
    missing = [component for component in top.components if component not in series_names(run.series)]
    if missing or config["top"] != top.section():
        fault = f"did not record {', '.join(missing)}" if missing else "has another top"
        raise UsageError(f"from: the run {run.folder} {fault}")
    rows = read_series(run.series, top.components)
    state = top.initial_section([float(rows[component][-1]) for component in top.components])
    return {key: value for key, value in initial.items() if key != "from"} | state


def _unfit(run: StoredResult) -> str:
    """Reason why the last row of a run is not the state in doubles after its last step; empty if it is."""
    manifest, config = run.manifest, run.manifest["config"]
    for key, reason in (
        ("ensemble", "is an ensemble"),
        ("section", "recorded crossings"),
        ("precision", "is in another precision, and its states are stored in doubles"),
    ):
        if key in config:
            return reason
    if run.outcome not in (Outcome.COMPLETED, Outcome.INTERRUPTED):
        return f"failed: it {manifest['message']}"
    if manifest["step"] % (every := config["output"]["every"]):
        return f"did not record its last state, for {manifest['step']} steps are no multiple of output.every = {every}"
    damage = run.damage()
    return f"is damaged: {', '.join(damage)}" if damage else ""
