"""Initial state that is the last one of a stored run: ``initial: {from: RUN}``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from topcli.config.document import describe
from topcli.contracts import Outcome, Top
from topcli.errors import UsageError
from topcli.store.results import read_result
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
    if "ensemble" in run.manifest["config"]:
        raise UsageError(f"from: the run {run.folder} is an ensemble")

    # the last row must be the state in doubles after the last step, of the same top
    manifest, config = run.manifest, run.manifest["config"]
    top, step, every = top_of(config["initial"]), manifest["step"], config["output"]["every"]
    missing = [component for component in top.components if component not in series_names(run.series)]
    reasons = {
        "recorded crossings": "section" in config,
        "is in another precision, and its states are stored in doubles": "precision" in config,
        f"failed: it {manifest['message']}": run.outcome not in (Outcome.COMPLETED, Outcome.INTERRUPTED),
        f"did not record its last state, for {step} steps are no multiple of output.every = {every}": step % every > 0,
        f"did not record {', '.join(missing)}": bool(missing),
        "has another top": config["top"] != top.section(),
    }
    fault = next((reason for reason, wrong in reasons.items() if wrong), "")
    if not fault and (damage := run.damage()):
        fault = f"is damaged: {', '.join(damage)}"
    if fault:
        raise UsageError(f"from: the run {run.folder} {fault}")
    rows = read_series(run.series, top.components)
    state = top.initial_section([float(rows[component][-1]) for component in top.components])
    return {key: value for key, value in initial.items() if key != "from"} | state
