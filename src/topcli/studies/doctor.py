"""Diagnosis of the installation: versions, CPU, threads, cache of compiled code, plugins."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from topcli.engine.code_cache import cache_folder, cache_state
from topcli.engine.ensemble import default_threads
from topcli.engine.native import native
from topcli.schemes.plugins import ENTRY_POINT_GROUP, top_origin
from topcli.schemes.registry import all_schemes, plugin_failures
from topcli.store.provenance import environment, installed
from topcli.sweeps.measures import all_measures
from topcli.tops import TOPS

EXTRAS = ("scipy", "pandas", "matplotlib", "typer", "rich", "ruamel.yaml", "platformdirs")


def _probe(x: Any, n: int) -> int:
    x[0] = x[0] + 1.0
    return n + 1


def _registered_by(entry: EntryPoint, entries: Sequence[EntryPoint]) -> list[str]:
    """Names of the schemes, measures and tops of an entry point.

    Of several entry points of a package each has what its own module, or one within it, defines; what no such module
    defines counts for all of them.
    """
    origin = entry.dist.name if entry.dist else entry.name
    parts = [(each.name, inspect.unwrap(each.build), each.origin) for each in all_schemes()]
    parts += [(each.name, each.evaluate, each.origin) for each in all_measures()]
    parts += [(form, TOPS[form], top_origin(TOPS[form])) for form in TOPS]
    modules = {each.module for each in entries if (each.dist.name if each.dist else each.name) == origin}
    names = set()
    for name, value, where in parts:
        within = [module for module in modules if f"{value.__module__}.".startswith(f"{module}.")]
        if where == origin and (not within or max(within, key=len) == entry.module):
            names.add(name)
    return sorted(names)


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
    entries = sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda entry: entry.name)
    for entry in entries:
        names = _registered_by(entry, entries)
        about = f"failed: {failures[entry.name]}" if entry.name in failures else f"registers {', '.join(names)}"
        if not names and entry.name not in failures:
            about = "registers no scheme, measure or top"
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
