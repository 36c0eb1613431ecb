"""Plan of a run: run, continue, or leave what is up to date, decided before anything is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from topcli.contracts import Outcome
from topcli.errors import UsageError
from topcli.runs.identity import Identity
from topcli.runs.resume import CHECKPOINT_SECONDS, Source, difference
from topcli.store.manifest import CHECKED_AT_ONCE, StoredRun
from topcli.store.run_folder import require_place, require_real

Progress = Callable[[int, int], None]
"""Called with (steps done, N) between chunks; of an ensemble, with those of all trajectories."""


@dataclass(frozen=True)
class RunOptions:
    """Options and callbacks of a run or an ensemble, of the command as of the function.

    Attributes
    ----------
    force : bool
        Run again; an existing different run is renamed, not overwritten.
    resume : bool
        Continue an interrupted or killed run from its last checkpoint; it ends, bit for bit, as without a stop.
    retry_failed : bool
        Repeat a run that failed before.
    checkpoint_every : float
        Seconds between checkpoints; 0 writes one after every chunk. An ensemble writes none.
    threads : int or None
        Threads of an ensemble, which do not change the results; None for all CPUs.
    stop : callable
        Called between chunks; if it returns True, the run ends as ``interrupted`` and keeps its rows.
    on_progress, on_message : callable
        Called with (steps done, N), and with a line for the user.
    """

    force: bool = False
    resume: bool = False
    retry_failed: bool = False
    checkpoint_every: float = CHECKPOINT_SECONDS
    threads: int | None = None
    stop: Callable[[], bool] = lambda: False
    on_progress: Progress = lambda done, total: None
    on_message: Callable[[str], None] = lambda line: None


@dataclass(frozen=True)
class Plan:
    """Plan of a run, with ``action`` describing it in words; ``existing`` is the run of that name, if there is one.

    ``up_to_date`` is True if it need not run again, ``rewrite`` if it only has to be written in another format, and
    ``damaged`` if a file of it does not match its checksum.
    """

    existing: StoredRun | None
    up_to_date: bool
    action: str
    damaged: bool = False
    rewrite: bool = False


def plan_run(identity: Identity, out: Path, options: RunOptions, source: Source | None = None) -> Plan:
    """Plan to run an experiment into ``out``, or to continue it from ``source``.

    Raises UsageError for a run that would be refused.
    """
    target, digest = out / identity.name, identity.digest
    existing = require_place(out, identity.name)
    begin = f"will continue from step {source.done}" if source else "will run"
    if existing is None:
        return Plan(None, False, begin)
    if existing.manifest["digest"] != digest:
        if not options.force and source is None:
            if differs := difference(existing.manifest["config"], identity.config):
                holds = f"a different experiment ({differs})"
            else:
                digests = f"digest {existing.manifest['digest'][:8]}, this one {digest[:8]}"
                holds = f"this experiment as {identity.other_code(existing.manifest)} ({digests})"
            raise UsageError(
                f"{target}: holds {holds}; nothing was written",
                "choose another name with --name or another folder with --out, or use --force, which renames "
                "the earlier run",
            )
        require_real(target)
        return Plan(existing, False, f"{begin}; the existing different run is renamed, not overwritten")
    failed = existing.outcome is not Outcome.COMPLETED
    largest, suffix = CHECKED_AT_ONCE, identity.config["output"]["format"]
    if not options.force and not (failed and options.retry_failed) and existing.up_to_date(identity.digests):
        if existing.series.suffix == f".{suffix}":
            return Plan(existing, True, f"up to date; {retry_hint(existing)}" if failed else "up to date")
        largest = None  # a rewritten file gets a checksum of its own, so the earlier one must be whole
        if not existing.damage():
            require_real(target)
            return Plan(existing, True, f"will be rewritten as {suffix}", rewrite=True)
    require_real(target)
    damage = existing.damage(largest)
    action = begin if source else "will run again"
    action += "".join(f"; {name} is damaged: {why}" for name, why in damage.items())
    return Plan(existing, False, action, bool(damage))


def retry_hint(existing: StoredRun) -> str:
    """Outcome of a finished run that failed, and the option that runs it again."""
    return f"the existing run ended as {existing.outcome.value}; --retry-failed runs it again"
