"""Diagnosis of the installation: versions, CPU, threads, cache of compiled code, plugins."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from topcli.engine.code_cache import cache_folder, cache_state
from topcli.engine.ensemble import default_threads
from topcli.engine.native import native
from topcli.schemes.registry import ENTRY_POINT_GROUP, all_schemes, plugin_failures
from topcli.store.provenance import environment, installed
from topcli.studies.measures import all_measures

EXTRAS = ("scipy", "pandas", "matplotlib", "typer", "rich", "ruamel.yaml", "platformdirs")


def _probe(x: Any, n: int) -> int:
    x[0] = x[0] + 1.0
    return n + 1


def diagnosis() -> dict[str, Any]:
    """Environment, cache, threads, plugins and problems of this installation, as plain data."""
    import numpy as np

    problems: list[str] = []
    folder = cache_folder()
    native(_probe, "pq")
    again = native(_probe, "pq")
    if again(np.zeros(1), 1) != 2:
        problems.append("compiled code gives wrong results on this machine")
    state = cache_state()
    problems += state.problems
    if not again.cached and not state.problems:
        problems.append(f"compiled code is not kept: {folder} cannot be written or loaded; every process recompiles")
    failures = {failure.name: failure.reason for failure in plugin_failures()}
    plugins = []
    for entry in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda entry: entry.name):
        origin = entry.dist.name if entry.dist else entry.name
        names = sorted({one.name for one in (*all_schemes(), *all_measures()) if one.origin == origin})
        about = f"failed: {failures[entry.name]}" if entry.name in failures else f"registers {', '.join(names)}"
        if not names and entry.name not in failures:
            about = "registers no scheme or measure"
            problems.append(f"plugin {entry.name} {about}")
        plugins.append({"name": entry.name, "state": about})
    problems += [f"plugin {name} failed: {reason}" for name, reason in failures.items()]
    return {
        "environment": {**environment(), **{package: installed(package) for package in EXTRAS}},
        "cache": {
            "folder": str(folder),
            "entries": state.entries,
            "bytes": state.size,
            "kept between processes": again.cached,
        },
        "threads": default_threads(),
        "plugins": plugins,
        "problems": problems,
    }
