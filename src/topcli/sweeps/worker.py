"""Work on a worker of a Dask cluster: preparation, comparison of versions, evaluation of batches."""

from __future__ import annotations

import hashlib
import pickle
import sys
import tempfile
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from distributed import WorkerPlugin, get_worker

import topcli
from topcli.engine.drive import limit_threads
from topcli.errors import TopcliError, UsageError
from topcli.schemes.own_tops import ORIGINS
from topcli.schemes.plugins import FILES, PluginFile, load_plugin_file
from topcli.schemes.registry import SCHEMES
from topcli.store.provenance import cpu_name, installed
from topcli.store.sources import package_digest
from topcli.sweeps.measures import MEASURES
from topcli.sweeps.row_results import Results, Work, forget
from topcli.tops import TOPS

Versions = dict[str, str]


def versions() -> Versions:
    """Versions in this process on which the bits of a result depend."""
    packages = {name: installed(name) or "missing" for name in ("numba", "llvmlite", "numpy")}
    return {
        "topcli": topcli.__version__,
        "python": sys.version.split()[0],
        **packages,
        "the source of topcli": package_digest()[:12],
    }


def difference(here: Versions, there: Versions) -> str:
    """First difference of two sets of versions, in words; empty if they are equal."""
    for name, version in here.items():
        if there.get(name) != version:
            return f"{name} is {there.get(name, 'missing')} there and {version} here"
    return ""


def describe() -> dict[str, Any]:
    """Versions and processor of this worker."""
    return {"versions": versions(), "cpu": cpu_name()}


@dataclass(frozen=True)
class Job:
    """Data that a worker needs before it evaluates rows of a sweep; ``token`` identifies the job."""

    token: str
    versions: Versions
    files: tuple[PluginFile, ...]

    @property
    def content(self) -> str:
        """Digest of the plugin files; empty if there are none."""
        return hashlib.sha256(pickle.dumps([sorted(file.content.items()) for file in self.files])).hexdigest()


@dataclass
class _State:
    """State of a worker process."""

    lock: threading.RLock = field(default_factory=threading.RLock)
    faults: dict[str, str] = field(default_factory=dict)
    """By the token of each job that has been prepared: why this worker cannot do it; empty if it can."""
    jobs: dict[str, Job] = field(default_factory=dict)
    loaded: str = ""
    """Digest of the plugin files that are loaded."""
    folder: Path | None = None
    """Folder of the plugin files that are loaded."""
    before: tuple[dict[Any, Any], ...] = ()
    """The tables that plugin files extend, before the first file was loaded."""
    stopped: set[str] = field(default_factory=set)


_state = _State()


class Preparation(WorkerPlugin):
    """Prepares each worker for a job, also workers that join later."""

    def __init__(self, job: Job) -> None:
        self.job, self.name = job, f"topcli-{job.token}"

    def setup(self, worker: Any) -> None:
        """Compare the versions, load the plugin files and limit the threads."""
        fault = difference(self.job.versions, versions())
        with _state.lock, suppress(TopcliError):
            if not fault:
                try:
                    _set_threads(worker.state.nthreads)
                    _load(self.job, worker.local_directory)
                except TopcliError as error:
                    fault = str(error)
            _state.jobs[self.job.token], _state.faults[self.job.token] = self.job, fault

    def teardown(self, worker: Any) -> None:
        """Forget the job; its plugin files stay until other ones come."""
        _state.jobs.pop(self.job.token, None)
        _state.faults.pop(self.job.token, None)


def _set_threads(count: int) -> None:
    """Let everything in this process that divides its work use ``count`` threads: the threads of the worker."""
    import numba

    limit_threads(count)
    with suppress(ValueError):  # at most as many as numba has begun with
        numba.set_num_threads(min(count, numba.get_num_threads()))


def _load(job: Job, place: str) -> None:
    """Load the plugin files of a job unless they are loaded; others, such as older versions, are forgotten."""
    if not job.files or _state.loaded == job.content:
        return
    tables: tuple[dict[Any, Any], ...] = (SCHEMES, TOPS.data, ORIGINS, MEASURES, FILES)
    if _state.before:
        for table, entries in zip(tables, _state.before, strict=True):
            table.clear()
            table.update(entries)
        forget()
    # the schemes of one name are a list that grows
    copies = ({key: [*v] if isinstance(v, list) else v for key, v in table.items()} for table in tables)
    _state.before = tuple(copies)
    _state.loaded, _state.folder = "", Path(tempfile.mkdtemp(prefix="topcli-", dir=place))
    for number, file in enumerate(job.files):
        for name, content in file.content.items():
            path = _state.folder / str(number) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        load_plugin_file(_state.folder / str(number) / Path(file.path).name)
    _state.loaded = job.content


def _with_places_of_client(text: str, job: Job) -> str:
    """``text`` with the paths of the plugin files as they are for the client, so that rows have the same messages."""
    for number, file in enumerate(job.files):
        folder = f"{_state.folder}/{number}"
        text = text.replace(f"{folder}/{Path(file.path).name}", file.path).replace(folder, file.folder)
    return text


def _require_ready(token: str) -> Job:
    """Job ``token``, for which this worker is prepared. Raises UsageError if it is not."""
    where = f"worker {get_worker().address}"
    fault = _state.faults.get(token, "has not been prepared")
    if fault:
        raise UsageError(f"{where}: {fault}")
    job = _state.jobs[token]
    if job.files and _state.loaded != job.content:
        raise UsageError(f"{where}: another sweep has loaded other plugin files; use other workers")
    return job


def evaluate(token: str, work: Work, rows: bytes) -> Results:
    """Evaluate pickled rows on a worker that is prepared for the job ``token``. Raises UsageError if it is not."""
    job = _require_ready(token)
    results = work(pickle.loads(rows), lambda: token in _state.stopped)
    _require_ready(token)  # other plugin files may have been loaded in the meantime
    if job.files:
        results.message[:] = [_with_places_of_client(text, job) for text in results.message]
    return results


def stop(token: str) -> None:
    """Give up the rows of a job that are being evaluated."""
    _state.stopped.add(token)
