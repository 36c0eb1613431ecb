"""Initial state that is the last one of a stored run: ``initial: {from: RUN}``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from topcli.contracts import Outcome, Top
from topcli.errors import UsageError, quoted
from topcli.store.results import StoredResult, read_result
from topcli.store.series import read_series, series_names

BESIDE = ("from", "normalize")
RESULTS = Path("results")
"""Folder in which a run is found by its name."""


def last_state(initial: Mapping[str, Any], top_of: Callable[[Any], Top | None]) -> dict[str, Any]:
    """Section ``initial`` with the last state of the stored run that the given section names by ``from``.

    ``top_of(section)`` is the top of the config with this section; it must be that of the run. Raises UsageError.
    """
    if others := [key for key in initial if key not in BESIDE]:
        raise UsageError(f"from gives the whole state; leave out {', '.join(others)}")
    run = _run(initial["from"])
    config = run.manifest["config"]
    top = top_of(config["initial"])
    if top is None:
        return {}
    if config["top"] != top.section():
        raise UsageError(f"from: the top of the run {run.folder} differs from this one")
    if missing := [name for name in top.components if name not in series_names(run.series)]:
        raise UsageError(f"from: the run {run.folder} did not record {', '.join(missing)}")
    rows = read_series(run.series, top.components)
    state = top.initial_section([float(rows[name][-1]) for name in top.components])
    return {key: value for key, value in initial.items() if key != "from"} | state


def _run(name: object) -> StoredResult:
    """Stored run of this name or folder. Raises UsageError for none, and for one without its last state."""
    if not isinstance(name, str) or not name:
        raise UsageError("from must be the name or the folder of a stored run")
    run = read_result(Path(name)) or read_result(RESULTS / name)
    if run is None or run.outcome is None:
        raise UsageError(f"from: no finished run {quoted(name)}; give its name in {RESULTS}, or its folder")
    config, fault = run.manifest["config"], ""
    if "ensemble" in config or "section" in config:
        fault = "is an ensemble" if "ensemble" in config else "recorded crossings"
    elif "precision" in config:
        fault = "is in another precision, and its states are stored in doubles"
    elif run.outcome not in (Outcome.COMPLETED, Outcome.INTERRUPTED):
        fault = f"failed: it {run.manifest['message']}"
    elif run.manifest["step"] % config["output"]["every"]:
        fault = f"did not record its last state; output.every must divide its {run.manifest['step']} steps"
    elif faults := run.damage():
        fault = f"is damaged: {', '.join(faults)}"
    if fault:
        raise UsageError(f"from: the run {run.folder} {fault}")
    return run
