"""Run of a batch, side by side or one by one, recording the data for its measures."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from topcli.config.models import Experiment
from topcli.contracts import Array, check_stop
from topcli.engine.ensemble import EnsembleCode, EnsembleRun, Execution, tile_of
from topcli.engine.fingerprint import same_method
from topcli.engine.loop import state_after
from topcli.engine.tile import Piece
from topcli.sweeps.batch import Batch, BatchRecorder, bytes_per_run
from topcli.sweeps.measures import Measure

SIDE_BY_SIDE = 4
"""Smallest batch whose runs advance side by side; fewer are faster one by one."""
BATCH_BYTES = 1 << 26
"""Memory of the records of a batch."""
MAX_RUNS = 4096


def batch_size(experiment: Experiment, measures: Sequence[Measure], budget: int = BATCH_BYTES) -> int:
    """Number of runs whose records fit into ``budget`` bytes, at least 1."""
    return max(1, min(MAX_RUNS, budget // bytes_per_run(experiment, measures)))


MAX_CODES = 256
_codes: dict[tuple[Any, ...], EnsembleCode] = {}
_latest: dict[tuple[Any, ...], EnsembleCode] = {}
"""The latest code by everything but the parameters of the top."""


def _code(experiment: Experiment, tile: int, side_by_side: bool) -> EnsembleCode:
    """Code of the experiment's method, kept for other experiments with the same scheme, options and class of top.

    Tops whose methods are equal share the machine code; constants of the top are its arguments.
    """
    kind = (experiment.scheme.build, type(experiment.top), experiment.options.model_dump_json(), tile, side_by_side)
    key = (*kind, experiment.top.model_dump_json())
    code = _codes.get(key)
    if code is None:
        if len(_codes) >= MAX_CODES:
            _codes.clear()
            _latest.clear()
        method, known = experiment.method(), _latest.get(kind)
        if known is not None and same_method(method, known.method):
            code = known.with_constants(experiment.top, method)
        else:
            code = _latest[kind] = EnsembleCode(experiment.top, method, tile, side_by_side)
            code.single_loop()  # so that no run has to wait for it
        code = _codes.setdefault(key, code)
    return code


class BatchRun:
    """Runs of ``experiment`` from several initial states, recorded for ``measures``; the code is made ready once.

    Parameters
    ----------
    experiment : Experiment
        Everything but the initial state, which is ignored.
    measures : sequence of Measure
        Measures of the runs, as ``resolve_measures`` returns them.
    count : int, optional
        Usual number of initial states at a time; from ``SIDE_BY_SIDE`` on, the runs advance side by side. It does not
        change the values.
    threads : int, optional
        Number of threads, which does not change the values; all CPUs by default.
    stop : callable, optional
        Called between chunks; once it returns true, the unfinished runs are ``interrupted``.
    """

    def __init__(
        self,
        experiment: Experiment,
        measures: Sequence[Measure],
        *,
        count: int = 1,
        threads: int | None = None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.experiment, self.measures = experiment, tuple(measures)
        self.size = batch_size(experiment, self.measures)
        """Number of runs whose records fit into memory."""
        self.stop = stop
        self._stop = lambda: self.stop()
        count = min(count, self.size)
        self._recorder: BatchRecorder | None = None
        self._recording = 0.0
        self._initial: Piece | None = None
        self._code = _code(experiment, tile_of(count), count >= SIDE_BY_SIDE)
        self._stepping: dict[float, EnsembleRun[None]] = {}
        self._run = EnsembleRun(
            experiment.top,
            self._code.method,
            np.empty((0, len(experiment.top.components))),
            experiment.h,
            experiment.N,
            experiment.output.every,
            on_piece=self._record,
            execution=Execution(stop=self._stop, threads=threads, code=self._code),
        )

    def _record(self, piece: Piece) -> None:
        assert self._recorder is not None
        began = time.thread_time()
        if self._run.side_by_side:
            self._recorder.add(piece)
        elif len(piece.n) == 1 and piece.n[0] == 0 and self.experiment.N:
            self._flush()
            self._initial = replace(piece, states=piece.states.copy())
        else:
            self._recorder.add(self._joined(piece))
        self._recording += time.thread_time() - began

    def _joined(self, piece: Piece) -> Piece:
        """``piece`` after the initial state of its run, which is held back: one row costs as much as hundreds."""
        initial, self._initial = self._initial, None
        if initial is None:
            return piece
        n, states = np.concatenate([initial.n, piece.n]), np.concatenate([initial.states, piece.states], axis=1)
        return Piece(initial.first, n, states, initial.kept + piece.kept)

    def _flush(self) -> None:
        """Record an initial state that no other row followed."""
        if self._initial is not None and self._recorder is not None:
            self._recorder.add(self._initial)
        self._initial = None

    def finished(self, initial: Array) -> Batch:
        """Run from the states ``initial`` (runs, d) and return what was recorded."""
        self._run.begin(initial)
        self._recorder = BatchRecorder(self.experiment, self.measures, self._run.y0)
        self._initial = None
        before, self._recording = self._run.run_seconds, 0.0
        began = time.perf_counter()
        for _ in self._run:
            pass
        self._flush()
        seconds = self._run.run_seconds - before
        if self._run.side_by_side:  # these include what ``_record`` does
            seconds = max(0.0, seconds - self._recording / self._run.threads)
        seconds = min(seconds, time.perf_counter() - began)
        share = np.full(len(initial), seconds / len(initial))
        return self._recorder.finish(self._run.endings, self._run.last, share, self.one_step)

    @property
    def side_by_side(self) -> bool:
        """True if the runs advance side by side."""
        return self._run.side_by_side

    def one_step(self, states: Array, h: float) -> Array:
        """States (k, d) after one step of ``h`` from ``states`` (k, d); nan where the step fails."""
        after = np.full_like(states, np.nan)
        usable = np.flatnonzero(np.isfinite(states).all(axis=1))
        code = self._code
        loop = None if self.side_by_side else code.single_loop()
        if loop and loop.compiled:  # a run for each state would cost as much as hundreds of steps
            for i in usable:
                end = state_after(loop, states[i], code.p, h)
                if end is not None:
                    after[i] = end
            check_stop()
            return after
        if h not in self._stepping:
            top, y0 = self.experiment.top, np.empty((0, states.shape[1]))
            self._stepping[h] = EnsembleRun(
                top, code.method, y0, h, 1, on_piece=lambda piece: None, execution=Execution(self._stop, 1, code=code)
            )
        run = self._stepping[h]
        run.begin(states[usable])
        for _ in run:
            pass
        check_stop()
        stepped = run.last_n == 1
        after[usable[stepped]] = run.last[stepped]
        return after
