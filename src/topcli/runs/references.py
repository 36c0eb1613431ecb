"""The reference behind errors, computed once for each top, initial state and time grid, and shared by all runs.

It is a Taylor series (``analysis.reference``) or the closed form of the top (its scheme ``exact``). Comparisons name
one of them; for sweeps ``reference_kind`` chooses. A state of the reference at a time does not depend on the other
times that are asked for, so that sharing changes no bit.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from functools import cache
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.reference import reference_obstacle, reference_states
from topcli.config.models import Experiment
from topcli.contracts import Array, Sampler, Scheme, Top, check_stop
from topcli.engine.setups import prepare
from topcli.errors import RunError, UsageError, quoted
from topcli.schemes.registry import find_scheme

TAYLOR = "taylor"
EXACT = "exact"
"""Name of the schemes that are the closed form of a top."""
METHODS = {TAYLOR: "Taylor series in double-double arithmetic", EXACT: "closed form (scheme exact)"}
"""Kinds of references, with what they are."""
LESS_ACCURATE = frozenset({"kowalevski"})
"""Forms whose closed form is not the reference: its error grows where gravity is weak, and it refuses some motions."""
MAX_BYTES = 1 << 28
"""Memory of the references that are kept."""
STRIPES = 64
"""Number of references that may be computed at the same time."""
MAX_STEPS = 1_000_000
"""Taylor steps of the reference of one run: about a minute."""
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


def exact_method(top: Top) -> Sampler | None:
    """Closed-form solution of a top; None if it has none."""
    scheme = _exact_scheme(top.form)
    method = scheme.build(top, scheme.options()) if scheme else None
    return method if isinstance(method, Sampler) else None


def reference_kind(top: Top, scheme: Scheme) -> str:
    """Kind of the reference that sweeps compare runs of ``scheme`` with.

    The closed form if it is as accurate as the series, and not the scheme itself.
    """
    if top.form in LESS_ACCURATE or scheme.name == EXACT:
        return TAYLOR
    return EXACT if exact_method(top) else TAYLOR


def reference_form(top: Top, kind: str) -> Sampler | None:
    """Closed form behind a kind of reference; None for the series.

    Raises UsageError for an unknown kind, and for a closed form that the top does not have.
    """
    if kind not in METHODS:
        raise UsageError(f"unknown reference {quoted(kind)}; use {' or '.join(METHODS)}")
    if kind == TAYLOR:
        return None
    if exact := exact_method(top):
        return exact
    raise UsageError(f"the top {top.form} has no scheme exact to compare with; use the reference {TAYLOR}")


def obstacle(top: Top, scheme: Scheme) -> str:
    """Reason why there is no reference for runs of ``top`` under ``scheme``; empty if there is one."""
    return "" if reference_kind(top, scheme) == EXACT else reference_obstacle(top)


def _closed_states(exact: Sampler, top: Top, y0: Array, h: float, n: NDArray[np.int64]) -> Array:
    """States (m, d) of a closed form after ``n`` (m,) steps; it is set up first if need be."""
    p = top.constants()
    if exact.setup is not None:
        prepare(exact.setup, y0, p)
    states = np.empty((len(n), len(y0)))
    for start in range(0, len(n), CLOSED_STATES):
        check_stop()
        part = slice(start, start + CLOSED_STATES)
        states[part] = exact.states(y0, h, n[part], p)
    return states


class SharedReferences:
    """References of at most ``max_bytes``; those of the motion not used for longest are dropped first.

    One takes at most ``max_steps`` Taylor steps. They heed a request to stop.
    """

    def __init__(self, max_bytes: int = MAX_BYTES, max_steps: int = MAX_STEPS) -> None:
        self._max_bytes, self._bytes, self._max_steps = max_bytes, 0, max_steps
        self._lock = threading.Lock()
        self._computing = [threading.Lock() for _ in range(STRIPES)]
        self._kept: OrderedDict[Motion, list[tuple[Array, Array]]] = OrderedDict()
        self._refused: dict[tuple[Motion, bytes], str] = {}
        self.computed = 0
        """Number of references that were computed."""

    def states(self, top: Top, kind: str, y0: Array, h: float, n: NDArray[np.int64]) -> Array:
        """States (m, d) after ``n`` (m,) steps of ``h`` of the motion of ``top`` from ``y0`` (d,).

        ``kind`` is one of ``METHODS``. Raises RunError if the motion cannot be followed or takes too many Taylor steps,
        and UsageError as ``reference_form``.
        """
        exact = reference_form(top, kind)
        t = n * h
        # a closed form is computed at the exact products n h, other references at their rounded values
        motion = (top.form, top.model_dump_json(), h if exact else 0.0, np.ascontiguousarray(y0).tobytes())
        computing = self._computing[hash(motion) % STRIPES]
        while not computing.acquire(timeout=POLL_SECONDS):  # others that need it wait instead of computing it too
            check_stop()
        try:
            states = self._known(motion, t)
            if states is None:
                start = np.asarray(y0, dtype=np.float64)
                states = _closed_states(exact, top, start, h, n) if exact else self._followed(motion, top, start, t)
                self._keep(motion, t, states)
            return states
        finally:
            computing.release()

    def _followed(self, motion: Motion, top: Top, start: Array, t: Array) -> Array:
        """States at the times ``t`` by Taylor series; a refusal is remembered. Raises RunError."""
        key = (motion, sha256(t.tobytes()).digest())
        if key in self._refused:
            raise RunError(self._refused[key])
        try:
            return reference_states(top, start.tolist(), t, self._max_steps)
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


def exact_names(experiment: Experiment) -> frozenset[str]:
    """Columns that ``exact_columns`` returns: components of the state and integrals of the motion."""
    return frozenset((*experiment.top.components, *(integral.name for integral in experiment.top.invariants())))


def exact_columns(experiment: Experiment) -> dict[str, Array]:
    """Exact values (m,) of the components and integrals at the recorded times, by the series or else the closed form.

    Raises UsageError if the motion is not known exactly.
    """
    top, y0, n = experiment.top, np.array(experiment.y0), np.arange(0, experiment.N + 1, experiment.output.every)
    exact = exact_method(top)
    if not (why := reference_obstacle(top)):
        states = reference_states(top, experiment.y0, n * experiment.h)
    elif exact is None:
        raise UsageError(f"{experiment.name}: no exact motion: {why}, and there is no closed form")
    else:
        states = _closed_states(exact, top, y0, experiment.h, n)
    columns = dict(zip(top.components, states.T, strict=True))
    return columns | {kept.name: np.full(len(n), float(kept.value(y0[None, :])[0])) for kept in top.invariants()}
