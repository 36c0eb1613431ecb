"""Reference solutions behind errors, computed once for each top, initial state and time grid.

A reference solution is a Taylor series (``analysis.reference``) or the closed form of the top (its scheme ``exact``).
A comparison names one of them; for sweeps, ``reference_of`` chooses. All runs share the solutions. This changes no bit
of the results, because a reference state does not depend on the other times at which the solution is computed.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.reference import MAX_TAYLOR_STEPS, distances, reference_obstacle, reference_states
from topcli.contracts import Array, Sampler, Scheme, Top, check_stop
from topcli.engine.consumers import Consumer
from topcli.engine.integration import Integration
from topcli.engine.rows import Plan, Rows
from topcli.errors import RunError, UsageError, quoted
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

TAYLOR = "taylor"
_EXACT = "exact"
"""Name of the schemes that are the closed form of a top."""
METHODS = {TAYLOR: "Taylor series in double-double arithmetic", _EXACT: "closed form (scheme exact)"}
"""Kinds of references, with what they are."""
LESS_ACCURATE = frozenset({"kowalevski"})
"""Forms whose closed form is not the reference: its error grows where gravity is weak, and it refuses some motions."""
MAX_BYTES = 1 << 28
"""Memory of the references of a process."""
SHARED_TAYLOR_STEPS = 1_000_000
"""Taylor steps that a shared reference takes at most, by default: about a minute."""
CLOSED_STATES = 1 << 16
"""States of a closed form between two questions whether to stop."""


@cache
def _exact_scheme(form: str) -> Scheme | None:
    try:
        scheme = find_scheme(_EXACT, form)
    except UsageError:
        return None
    return scheme if scheme.order is None and not scheme.options.model_fields else None


def closed_form_of(top: Top) -> Sampler | None:
    """Closed-form solution of a top; None if it has none."""
    scheme = _exact_scheme(top.form)
    method = scheme.build(top, scheme.options()) if scheme else None
    return method if isinstance(method, Sampler) else None


@dataclass(frozen=True)
class Reference:
    """The reference of the motions of ``top``: its ``closed_form``, or the Taylor series if that is None."""

    top: Top
    closed_form: Sampler | None = None

    @property
    def obstacle(self) -> str:
        """Reason why there is no such reference; empty if there is one."""
        return "" if self.closed_form else reference_obstacle(self.top)

    def states(self, y0: Array, h: float, n: NDArray[np.int64], max_steps: int = MAX_TAYLOR_STEPS) -> Array:
        """States (m, d) after ``n`` (m,) steps of ``h``, by at most ``max_steps`` Taylor steps.

        Raises RunError if the motion cannot be followed.
        """
        if self.closed_form is None:
            return reference_states(self.top, y0.tolist(), n * h, max_steps)
        p = self.top.constants()
        states = np.empty((len(n), len(y0)))
        for start in range(0, len(n), CLOSED_STATES):
            check_stop()
            part = slice(start, start + CLOSED_STATES)
            states[part] = self.closed_form.states(y0, h, n[part], p)
        return states


def reference_of(top: Top, kind: str | None = None, judged: Scheme | None = None) -> Reference:
    """Reference of the motions of ``top``, of the ``kind`` in ``METHODS`` that is asked for, or else the best one.

    That is the closed form, unless the top has none, or a less accurate one than the series, or runs of this scheme
    are ``judged`` by the reference. Raises UsageError for an unknown kind, and for a closed form that the top lacks.
    """
    if kind is not None and kind not in METHODS:
        raise UsageError(f"unknown reference {quoted(kind)}; use {' or '.join(METHODS)}")
    itself = judged is not None and judged.name == _EXACT
    if kind == TAYLOR or (kind is None and (itself or top.form in LESS_ACCURATE)):
        return Reference(top)
    closed = closed_form_of(top)
    if closed is None and kind == _EXACT:
        raise UsageError(
            f"the top {TOPS.called(top.form)} has no scheme exact to compare with; use the reference {TAYLOR}"
        )
    return Reference(top, closed)


def error_obstacle(top: Top, scheme: Scheme) -> str:
    """Reason why there is no reference for runs of ``top`` under ``scheme``; empty if there is one."""
    return reference_of(top, judged=scheme).obstacle


class SharedReferences:
    """References of this process, of at most ``max_bytes``; refusals are remembered too.

    One takes at most ``SHARED_TAYLOR_STEPS`` Taylor steps. They heed a request to stop.
    """

    def __init__(self, max_bytes: int = MAX_BYTES) -> None:
        self._max_bytes, self._bytes = max_bytes, 0
        self._lock = threading.Lock()
        self._states: OrderedDict[Any, Array | str] = OrderedDict()
        """States (m, d) by motion and times, or the reason why there are none; the latest come last."""

    def states(self, reference: Reference, y0: Array, h: float, n: NDArray[np.int64]) -> Array:
        """States (m, d) of ``reference`` after ``n`` (m,) steps of ``h`` from ``y0`` (d,).

        Raises RunError if the motion cannot be followed or takes too many Taylor steps.
        """
        # a closed form is computed at the exact products n h, the series at their rounded values
        step, top = h if reference.closed_form else 0.0, reference.top
        key = (
            type(top),  # a notebook may define a top again under its name
            top.model_dump_json(),
            step,
            np.ascontiguousarray(y0).tobytes(),
            sha256((n * h).tobytes()).digest(),
        )
        with self._lock:
            states = self._states.get(key)
        if states is None:
            try:
                states = reference.states(np.asarray(y0, dtype=np.float64), h, n, SHARED_TAYLOR_STEPS)
            except RunError as error:
                states = str(error)
            with self._lock:
                if key not in self._states:
                    self._states[key], self._bytes = states, self._bytes + _size(states)
                while self._bytes > self._max_bytes:
                    self._bytes -= _size(self._states.popitem(last=False)[1])
        if isinstance(states, str):
            raise RunError(states)
        return states


def _size(states: Array | str) -> int:
    return states.nbytes if isinstance(states, np.ndarray) else len(states)


REFERENCES = SharedReferences()
"""References shared by all runs of this process."""


class Errors(Consumer):
    """Distances of the trajectories from ``reference``: the ``largest`` over the rows, and the ``final`` one (B,).

    ``faults`` are the reasons why a reference could not be computed, by trajectory; errors are then nan. Without
    ``rows`` there is only the final error.
    """

    def __init__(self, reference: Reference, rows: bool = True) -> None:
        self._reference, self._rows = reference, rows

    def begin(self, plan: Plan) -> None:
        """Compute the references of the trajectories of a plan."""
        count, n = len(plan.states), np.arange(0, plan.N + 1, plan.every) if self._rows else np.zeros(0, dtype=np.int64)
        n = n if len(n) and n[-1] == plan.N else np.append(n, plan.N)
        self.faults, self._references = dict[int, str](), list[Array | None]([None] * count)
        self.largest, self.final = np.full(count, np.nan), np.full(count, np.nan)
        for i, y0 in enumerate(plan.states):
            try:
                self._references[i], self.largest[i] = REFERENCES.states(self._reference, y0, plan.h, n), 0.0
            except RunError as error:
                self.faults[i] = str(error)

    def add(self, rows: Rows) -> None:
        """Compare rows with the references."""
        if not (self._rows and len(rows)):
            return
        start = int(rows.n[0]) // rows.plan.every
        for i, (states, length) in enumerate(zip(rows.states, rows.lengths.tolist(), strict=True), rows.first):
            reference = self._references[i]
            if reference is not None and length:
                error = distances(states[:length], reference[start : start + length]).max()
                self.largest[i] = np.maximum(self.largest[i], error)

    def end(self, run: Integration) -> None:
        """Compare the last states of the trajectories that took all steps."""
        for i in np.flatnonzero(run.last_n == run.plan.N).tolist():
            reference = self._references[i]
            if reference is not None:
                self.final[i] = distances(run.last[i], reference[-1])
