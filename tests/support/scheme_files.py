"""Scheme files written by tests: load one as ``--plugin`` does, run it, and leave no trace in the registry."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from steppers import built
from topcli import plugins
from topcli.contracts import Outcome
from topcli.engine.drive import orbit
from topcli.engine.machine import Machine
from topcli.plugins import load_plugin_file
from topcli.tops.kowalevski import Kowalevski

FILE = """
import topcli
from topcli.contracts import Stepper
{body}

@topcli.scheme("mine", top="kowalevski", order=1, explicit=True, self_adjoint=False)
def mine(top, options):
    '''Change omega1.'''
    return Stepper(step, 6{options})
"""


@dataclass(frozen=True)
class Found:
    """omega1 after two steps from 1, and whether the machine code was stored."""

    value: float
    cached: bool


def tables() -> dict[str, Any]:
    """Tables that plugins extend, by name, with all that is built in."""
    from topcli.figures.catalogue import FIGURES
    from topcli.schemes.registry import SCHEMES, all_schemes
    from topcli.sweeps.measures import MEASURES
    from topcli.tops import TOPS

    all_schemes()
    return {
        "schemes": SCHEMES,
        "tops": TOPS.data,
        "origins": TOPS.origins,
        "files": plugins.FILES,
        "figures": FIGURES,
        "measures": MEASURES,
    }


@contextmanager
def unchanged_tables() -> Iterator[None]:
    """At the end the tables are as they were."""
    extended = tables()
    before, modules = {name: dict(table) for name, table in extended.items()}, set(sys.modules)
    before["schemes"] = {name: [*declarations] for name, declarations in before["schemes"].items()}
    try:
        yield
    finally:
        plugins.REGISTERED.clear()
        folders = {str(path.parent) for path in plugins.FILES.keys() - before["files"].keys()}
        for name in sys.modules.keys() - modules:  # beside plugin files
            if any(str(getattr(sys.modules[name], "__file__", None) or "").startswith(folder) for folder in folders):
                del sys.modules[name]
        for name, table in extended.items():
            table.clear()
            table.update(before[name])


@contextmanager
def loaded_file(path: Path) -> Iterator[None]:
    """Load what a file registers, and forget it at the end."""
    with unchanged_tables():
        load_plugin_file(path)
        yield


def write_scheme(folder: Path, body: str, options: str = "") -> Path:
    """A scheme file with ``body``, which defines ``step``."""
    path = folder / "mine.py"
    path.write_text(FILE.format(body=body, options=options))
    return path


def run_scheme(path: Path) -> Found:
    """Load the file and take two steps."""
    with loaded_file(path):
        top = Kowalevski()
        method = built("mine", top)
    machine = Machine(top, method)
    _, states, ending = orbit(top, machine, (1.0, 0.25, 0.5, 0.6, 0.48, 0.64), 0.1, 2)
    assert ending.outcome is Outcome.COMPLETED
    return Found(float(states[-1, 0]), machine.loop.cached)
