"""Decision whether to run, resume or keep a stored run, made before anything is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from topcli.config.models import OUTSIDE_IDENTITY, name_fault
from topcli.contracts import Outcome
from topcli.errors import UsageError
from topcli.runs.identity import Identity
from topcli.store.folder import NO_FOLDER, OCCUPIED, UNREADABLE, Folder, Resumable
from topcli.store.series import damaged

CHECKPOINT_SECONDS = 10.0
"""Seconds between two checkpoints; the first one comes after half of it."""

_REFUSALS = {
    NO_FOLDER: ("output folder {folder.out}: {wrong}; choose another with --out",),
    UNREADABLE: (
        "{wrong}; nothing was written",
        "choose another folder with --out, or another name with --set name=...",
    ),
    OCCUPIED: (
        "{folder.target}: {wrong}; nothing was written",
        "move it away, or choose another folder with --out or another name with --set name=...",
    ),
}
"""Lines of the error for each of ``store.folder.FAULTS``."""

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
class Decision:
    """Action on a run, ``action`` in words, and the ``notes`` to show before it begins.

    ``source`` is the run to be continued, None to start from step 0.
    """

    verb: Literal["run", "leave"]
    action: str
    source: Resumable | None = None
    notes: tuple[str, ...] = ()


def decide(identity: Identity, folder: Folder, options: RunOptions) -> Decision:
    """Decide what to do about the run with this ``identity`` in ``folder``.

    Raises UsageError for a run that is refused, and RunError if there is only a damaged one to continue.
    """
    run = folder.run
    if folder.fault:
        kind, wrong = folder.fault
        raise UsageError(*(line.format(folder=folder, wrong=wrong) for line in _REFUSALS[kind]))
    current = run is not None and run.complete(identity.digests) and run.series.suffix == f".{identity.format}"
    failed = run is not None and run.outcome is not Outcome.COMPLETED
    source = _source(identity, folder) if options.resume and (folder.damage or not current) else None
    decision = _run(identity, folder, options, source)
    if run and current and not folder.damage and not options.force and not (failed and options.retry_failed):
        hint = f"; the existing run ended as {run.outcome.value}; --retry-failed runs it again" if failed else ""
        return Decision("leave", f"up to date{hint}")
    if folder.linked:
        raise _link_error(folder.target)
    return decision


def _link_error(target: Path) -> UsageError:
    """Error for a run that would replace the symbolic link ``target``."""
    return UsageError(
        f"{target}: is a symbolic link, which no run can replace; nothing was written",
        "remove it, or choose another name with --set name=...",
    )


def require_no_link(target: Path) -> None:
    """Raise UsageError if a result would replace a symbolic link."""
    if target.is_symlink():
        raise _link_error(target)


def _run(identity: Identity, folder: Folder, options: RunOptions, source: Resumable | None) -> Decision:
    """Return the decision to run, from the start or from ``source``, and to replace the stored run."""
    notes = _notes(identity, folder, options, source)
    begin = f"will continue from step {source.done}" if source else "will run"
    if folder.run is None:
        return Decision("run", begin, source, notes)
    if folder.run.manifest["digest"] == identity.digest:
        action = begin if source else "will run again"
        action += "".join(f"; {name} is damaged: {why}" for name, why in folder.damage.items())
        return Decision("run", action, source, (action, *notes) if folder.damage else notes)
    if not options.force and source is None:
        raise UsageError(
            f"{folder.target}: holds {_other(identity, folder.run.manifest)}; nothing was written",
            "choose another name with --set name=... or another folder with --out, or use --force, which renames "
            "the earlier run",
        )
    return Decision("run", f"{begin}; the existing different run is renamed, not overwritten", source, notes)


def _other(identity: Identity, manifest: dict[str, Any]) -> str:
    """The different experiment, or other code, of a run with this ``manifest``, in half a line."""
    if differs := difference(manifest["config"], identity.config):
        return f"a different experiment ({differs})"
    digests = f"digest {manifest['digest'][:8]}, this one {identity.digest[:8]}"
    return f"this experiment as {identity.other_code(manifest)} ({digests})"


def _running(identity: Identity, folder: Folder) -> int | None:
    """Process number of another process that runs the same experiment into the folder; None if there is none."""
    owners = (part.owner for part in folder.parts if part.alive)
    return next((owner["pid"] for owner in owners if owner.get("digest") == identity.digest), None)


def _notes(identity: Identity, folder: Folder, options: RunOptions, source: Resumable | None) -> tuple[str, ...]:
    """Reports before a run starts at step 0: of what ``--resume`` would continue, and of the process that runs it."""
    if options.resume:
        return () if source else ("nothing to resume; starting from step 0",)
    notes = []
    if running := _running(identity, folder):
        notes.append(f"process {running} is running this experiment too")
    left_here = folder.parts or any(source.where.folder == folder.target for source in folder.sources)
    fitting = [source.done for source in folder.sources if identity.same(source.about)]
    if left_here and fitting:
        N = identity.config["N"]
        notes.append(f"starting from step 0; --resume would continue an unfinished run at step {max(fitting)} of {N}")
    return tuple(notes)


def _source(identity: Identity, folder: Folder) -> Resumable | None:
    """Unfinished run of the same experiment and code that got furthest; None if there is none to continue.

    Raises UsageError if another process is running it, or if an unfinished run of that name is of a different
    experiment or other code, and RunError if it is damaged.
    """
    config = identity.config
    if running := _running(identity, folder):
        raise UsageError(
            f"{folder.target}: process {running} is running this experiment now; there is nothing to resume"
        )
    if fitting := [source for source in folder.sources if identity.same(source.about)]:
        best = max(fitting, key=lambda source: (source.checkpoint is None, source.done))
        wanted = config["output"]["format"]
        if (written := best.about["config"].get("output", {}).get("format", wanted)) != wanted:
            raise UsageError(
                f"{best.where.folder}: the unfinished run, at step {best.done}, is written as {written}, not {wanted}",
                f"resume it with --set output.format={written}",
            )
        return best
    if not folder.sources:
        if folder.damaged_checkpoint:
            raise damaged(folder.damaged_checkpoint, "or written by another version of topcli")
        return None
    other = max(folder.sources, key=lambda source: (source.about.get("digest") == identity.digest, source.done))
    if other.about.get("digest") == identity.digest:
        why = f"was made by other code of the scheme {config['scheme']['name']}"
    elif differs := difference(other.about.get("config", {}), config):
        why = f"is of a different experiment ({differs})"
    else:
        why = "was started by another version of topcli"
    raise UsageError(
        f"{other.where.folder}: the unfinished run, at step {other.done}, {why}; it is kept, and nothing was written",
        "resume it with its own config and code, or start again without --resume",
    )


def config_to_resume(out: Path, name: str) -> dict[str, Any] | None:
    """Config of the unfinished run ``name`` in ``out`` that got furthest, or of the finished one; None without a run.

    Raises UsageError if another process is computing the only one.
    """
    if name_fault(name):
        return None
    folder = Folder.look(out, name)
    if folder.sources:
        return max(folder.sources, key=lambda source: source.done).about["config"]
    if running := next((part.owner.get("pid") for part in folder.parts if part.alive), None):
        raise UsageError(f"{folder.target}: process {running} is computing this run now; there is nothing to resume")
    return folder.run.manifest["config"] if folder.run else None


def flattened(data: Any, path: str = "") -> dict[str, Any]:
    """Values of a resolved config by their dotted keys."""
    if not isinstance(data, dict):
        return {path: data}
    values: dict[str, Any] = {}
    for key, value in data.items():
        values |= flattened(value, f"{path}.{key}" if path else key)
    return values


def difference(there: dict[str, Any], here: dict[str, Any]) -> str:
    """First differences in half a line, such as ``h: 0.001 stored, 0.002 requested``; empty if both are equal.

    The keys of a resolved config that do not belong to the identity of a run are left out.
    """
    old, new = flattened(there), flattened(here)
    keys = [key for key in dict.fromkeys([*old, *new]) if old.get(key) != new.get(key) and key not in OUTSIDE_IDENTITY]
    shown = [f"{key}: {old.get(key, 'nothing')} stored, {new.get(key, 'nothing')} requested" for key in keys[:3]]
    return "; ".join(shown) + ("; ..." if len(keys) > 3 else "")
