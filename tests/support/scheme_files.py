"""Scheme files written by tests: load one as ``--plugin`` does, run it, and leave no trace in the registry."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from topcli.contracts import Outcome
from topcli.engine.run import Run
from topcli.runs.identity import method_fingerprint
from topcli.schemes import registry
from topcli.tops.kowalevski import Kowalevski

FILE = """
import topcli
from topcli.contracts import Stepper
{body}

@topcli.scheme("mine", top="kowalevski", title="mine", order=1, explicit=True, self_adjoint=False,
               citation="none", equations="none")
def mine(top, options):
    '''Change omega1.'''
    return Stepper(step, 6{options})
"""


@dataclass(frozen=True)
class Found:
    """omega1 after two steps from 1, whether the machine code was stored, and the code key of the run folder."""

    value: float
    cached: bool
    code: str


@contextmanager
def loaded_file(path: Path) -> Iterator[None]:
    """Load what a file registers, and forget it at the end."""
    registry.load_plugin_file(path)
    try:
        yield
    finally:
        registry.unload_plugin_files()


def write_scheme(folder: Path, body: str, options: str = "") -> Path:
    """A scheme file with ``body``, which defines ``step``."""
    path = folder / "mine.py"
    path.write_text(FILE.format(body=body, options=options))
    return path


def run_scheme(path: Path) -> Found:
    """Load the file and take two steps."""
    registry.all_schemes()  # so that the built-in ones are among those that stay
    before = registry.registry.snapshot()
    try:
        registry.load_plugin_file.__wrapped__(path)
        top = Kowalevski()
        method = registry.find_scheme("mine", "kowalevski").build(top, None)
    finally:
        registry.registry.restore(before)
    run = Run(top, method, (1.0, 0.25, 0.5, 0.6, 0.48, 0.64), 0.1, 2)
    last = [float(chunk.states[-1, 0]) for chunk in run if len(chunk.n)][-1]
    assert run.ending is not None
    assert run.ending.outcome is Outcome.COMPLETED
    return Found(last, run.cached, method_fingerprint(method))
