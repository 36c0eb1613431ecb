"""``topcli.step``: the step of a scheme as a function of arrays of states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from topcli.config.document import parse_override
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.engine.drive import drive
from topcli.engine.machine import lanes_of
from topcli.engine.tangent import TangentCode, TangentRun, tangent_code
from topcli.errors import UsageError
from topcli.runs.plans import plans


class StepMap:
    """Compiled function that maps a state, or an array of states, to the states after a step.

    The last axis of an array contains the components of a state. All processors share the computation, and the new
    states are identical to those of ``topcli run``. A state becomes nan if its step fails. All quantities are
    dimensionless.

    Attributes
    ----------
    experiment : Experiment
        Top, scheme and step size of the map.
    components : tuple of str
        Names of the components of a state.
    h : float
        Step size.
    initial : ndarray, shape (d,)
        Initial state of the config.
    """

    def __init__(self, experiment: Experiment) -> None:
        self.experiment, self.h = experiment, experiment.h
        self.components = type(experiment.top).components
        self.initial = np.array(experiment.y0, dtype=float)
        self._plan = replace(next(plans(experiment)), invariants=(), quantities=())
        self._tangents: dict[int, TangentCode] = {}

    def __repr__(self) -> str:
        experiment = self.experiment
        return f"<map of {experiment.scheme.name} for {experiment.top.kind}, h = {self.h:g}>"

    def __call__(self, states: ArrayLike, steps: int = 1) -> Array:
        """Return the states after ``steps`` steps.

        Parameters
        ----------
        states : array_like, shape (..., d)
            States of the top.
        steps : int, optional
            Number of steps.

        Returns
        -------
        ndarray, shape (..., d)
            New states; nan where a step fails.

        Raises
        ------
        UsageError
            If the states have another length, or if ``steps`` is less than one.
        """
        y, shape = self._rows(states, "states", steps)
        if not len(y):
            return y.reshape(shape)
        run = drive(replace(self._plan, states=np.ascontiguousarray(y), N=steps, every=steps, tallied=0))
        return np.where((run.last_n == steps)[:, None], run.last, np.nan).reshape(shape)

    def tangent(self, states: ArrayLike, vectors: ArrayLike, steps: int = 1) -> tuple[Array, Array]:
        """Return the states after ``steps`` steps, and the images of tangent vectors.

        Parameters
        ----------
        states, vectors : array_like, shape (..., d)
            States, and a tangent vector at each state. The two arrays are broadcast against each other.
        steps : int, optional
            Number of steps.

        Returns
        -------
        tuple of ndarray, shape (..., d)
            New states and images; nan where a step fails.

        Raises
        ------
        UsageError
            If the scheme has no tangent map, if the arrays do not fit, or if ``steps`` is less than one.
        """
        try:
            arrays = np.broadcast_arrays(np.asarray(states, dtype=float), np.asarray(vectors, dtype=float))
        except ValueError as error:
            raise UsageError(f"states and vectors do not fit: {error}") from None
        (y, shape), (v, _) = (self._rows(array, "states and vectors", steps) for array in arrays)
        assert self._plan.machine is not None
        lanes, method = lanes_of(len(y)), self._plan.machine.method
        if lanes not in self._tangents:
            self._tangents[lanes] = tangent_code(self.experiment.scheme, self.experiment.top, method, lanes)
        results = np.full((2, *y.shape), np.nan)
        for first in range(0, len(y), lanes):
            part = slice(first, first + lanes)
            run = TangentRun(self._tangents[lanes], self.h, y[part], v[part])
            run.advance(steps)
            results[0, part], results[1, part] = run.states, run.images
        results[:, ~np.isfinite(results).all(axis=(0, 2))] = np.nan
        return results[0].reshape(shape), results[1].reshape(shape)

    def jacobian(self, states: ArrayLike, steps: int = 1) -> Array:
        """Return the derivative of the new states with respect to the old ones, shape (..., d, d).

        Raises the same errors as ``tangent``.
        """
        y = np.asarray(states, dtype=float)
        d = len(self.components)
        _, images = self.tangent(y[..., None, :], np.eye(d), steps)
        return np.swapaxes(images, -1, -2)

    def _rows(self, states: ArrayLike, what: str, steps: int) -> tuple[Array, tuple[int, ...]]:
        """States as rows (m, d), and their shape."""
        y, d = np.asarray(states, dtype=float), len(self.components)
        if y.ndim == 0 or y.shape[-1] != d:
            raise UsageError(
                f"{what}: the last axis has the {d} components {', '.join(self.components)}, not {y.shape}"
            )
        if steps != int(steps) or steps < 1:
            raise UsageError(f"steps = {steps}: must be a whole number from 1 on")
        return np.ascontiguousarray(y.reshape(-1, d)), y.shape


def step(config: str | Path | Mapping[str, Any], overrides: Sequence[str] = ()) -> StepMap:
    """Return one step of a config's scheme as a compiled function of states.

    Parameters
    ----------
    config : path, str or mapping
        Config file, name of a scene (a packaged config), or the content of a config. The keys ``N``, ``T`` and
        ``output`` are not needed, and are ignored.
    overrides : sequence of str, optional
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line, such as
        ``"h=0.01"``.

    Returns
    -------
    StepMap
        Function, called f here: ``f(states)`` returns the states after one step, ``f(states, n)`` those after n steps.
        ``f.tangent(states, vectors)`` takes one step and applies the tangent map (the derivative of the step) to the
        vectors.

    Raises
    ------
    ConfigError
        If the config cannot be loaded.

    Examples
    --------
    >>> import numpy, topcli
    >>> f = topcli.step("kowalevski_generic_hk", ["h=0.1"])
    >>> f(numpy.zeros((1000, 6)) + f.initial).shape
    (1000, 6)
    >>> bool(abs(numpy.linalg.det(f.jacobian(f.initial)) - 1) < 0.01)
    True
    """
    used = [text for text in overrides if parse_override(text)[0][0] not in ("N", "T", "output")]
    return StepMap(load_experiment(config, used, {"N": 1, "output": {}}))
