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

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.reference import MAX_TAYLOR_STEPS, reference_obstacle, reference_states
from topcli.contracts import Array, Sampler, Scheme, Top, check_stop
from topcli.errors import RunError, UsageError, quoted
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

TAYLOR = "taylor"
EXACT = "exact"
"""Name of the schemes that are the closed form of a top."""
METHODS = {TAYLOR: "Taylor series in double-double arithmetic", EXACT: "closed form (scheme exact)"}
"""Kinds of references, with what they are."""
LESS_ACCURATE = frozenset({"kowalevski"})
"""Forms whose closed form is not the reference: its error grows where gravity is weak, and it refuses some motions."""
KEPT_BYTES = 1 << 28
"""Memory of the references that are kept."""
STRIPES = 64
"""Number of references that may be computed at the same time."""
SHARED_TAYLOR_STEPS = 1_000_000
"""Taylor steps that a shared reference takes at most, by default: about a minute."""
CLOSED_STATES = 1 << 16
"""States of a closed form between two questions whether to stop."""
POLL_SECONDS = 0.1
"""The same while another run computes the reference, in seconds."""
KEPT_REFUSALS = 4096
Motion = tuple[str, str, float, bytes]
"""Form and parameters of a top, h or 0, and the initial state, which determine a reference."""


@cache
def _exact_scheme(form: str) -> Scheme | None:
    try:
        scheme = find_scheme(EXACT, form)
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
    itself = judged is not None and judged.name == EXACT
    if kind == TAYLOR or (kind is None and (itself or top.form in LESS_ACCURATE)):
        return Reference(top)
    closed = closed_form_of(top)
    if closed is None and kind == EXACT:
        raise UsageError(
            f"the top {TOPS.called(top.form)} has no scheme exact to compare with; use the reference {TAYLOR}"
        )
    return Reference(top, closed)


def obstacle(top: Top, scheme: Scheme) -> str:
    """Reason why there is no reference for runs of ``top`` under ``scheme``; empty if there is one."""
    return reference_of(top, judged=scheme).obstacle


class SharedReferences:
    """References of at most ``max_bytes``; those of the motion not used for longest are dropped first.

    One takes at most ``max_steps`` Taylor steps. They heed a request to stop.
    """

    def __init__(self, max_bytes: int = KEPT_BYTES, max_steps: int = SHARED_TAYLOR_STEPS) -> None:
        self._max_bytes, self._bytes, self._max_steps = max_bytes, 0, max_steps
        self._lock = threading.Lock()
        self._computing = [threading.Lock() for _ in range(STRIPES)]
        self._kept: OrderedDict[Motion, list[tuple[Array, Array]]] = OrderedDict()
        self._refused: dict[tuple[Motion, bytes], str] = {}
        self.computed = 0
        """Number of references that were computed."""

    def states(self, reference: Reference, y0: Array, h: float, n: NDArray[np.int64]) -> Array:
        """States (m, d) of ``reference`` after ``n`` (m,) steps of ``h`` from ``y0`` (d,).

        Raises RunError if the motion cannot be followed or takes too many Taylor steps.
        """
        t, top = n * h, reference.top
        # a closed form is computed at the exact products n h, the series at their rounded values
        step = h if reference.closed_form else 0.0
        motion = (top.form, top.model_dump_json(), step, np.ascontiguousarray(y0).tobytes())
        computing = self._computing[hash(motion) % STRIPES]
        while not computing.acquire(timeout=POLL_SECONDS):  # others that need it wait instead of computing it too
            check_stop()
        try:
            states = self._known(motion, t)
            if states is None:
                states = self._compute(motion, reference, np.asarray(y0, dtype=np.float64), h, n)
                self._keep(motion, t, states)
            return states
        finally:
            computing.release()

    def _compute(self, motion: Motion, reference: Reference, y0: Array, h: float, n: NDArray[np.int64]) -> Array:
        """States of a reference that is not kept; a refusal is remembered. Raises RunError."""
        key = (motion, sha256((n * h).tobytes()).digest())
        if key in self._refused:
            raise RunError(self._refused[key])
        try:
            return reference.states(y0, h, n, self._max_steps)
        except RunError as error:
            if len(self._refused) < KEPT_REFUSALS:
                self._refused[key] = str(error)
            raise

    def _known(self, motion: Motion, t: Array) -> Array | None:
        """States at the times ``t`` from a reference that holds all of them; None if there is none."""
        with self._lock:
            for times, states in self._kept.get(motion, ()):
                at = np.minimum(np.searchsorted(np.abs(times), np.abs(t)), len(times) - 1)
                if np.array_equal(times[at], t):
                    self._kept.move_to_end(motion)
                    return states if len(at) == len(states) else states[at]
        return None

    def _keep(self, motion: Motion, times: Array, states: Array) -> None:
        with self._lock:
            self.computed += 1
            if times.nbytes + states.nbytes > self._max_bytes:
                return
            self._kept.setdefault(motion, []).append((times, states))
            self._kept.move_to_end(motion)
            self._bytes += times.nbytes + states.nbytes
            while self._bytes > self._max_bytes:
                oldest = next(iter(self._kept))
                dropped = self._kept[oldest].pop(0)
                self._bytes -= sum(array.nbytes for array in dropped)
                if not self._kept[oldest]:
                    del self._kept[oldest]


REFERENCES = SharedReferences()
"""References shared by all runs of this process."""
