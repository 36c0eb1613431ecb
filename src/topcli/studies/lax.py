"""``topcli lax``: Lax forms of a top along the motion and along runs, and the integrals in their spectra.

In a Lax form dL/dt = [M, L], L and M are matrices that depend on the state (omega, gamma), affinely, and on a spectral
parameter lambda; the spectrum of L is constant. A top's moments and gravity determine its forms:

=============  ====  ===========================  =========================================================
form           size  top                          source
=============  ====  ===========================  =========================================================
`manakov`      3     no gravity (Euler)           Manakov 1976
`lagrange`     3     A = B, gravity on axis 3     Ratiu, van Moerbeke 1982
`kowalevski`   5     A = B = 2C, gravity on 1     Reyman, Semenov-Tian-Shansky 1987; Bobenko et al. 1989
`block`        6     any                          Sogo, Discrete Spinning Tops, section 1.1, after (Audin)
=============  ====  ===========================  =========================================================

Three-vectors become matrices with the paper's sign: hat(v) hat(u) - hat(u) hat(v) = hat(u x v).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.reference import reference_states
from topcli.contracts import Array, EulerPoisson, Invariant, Outcome
from topcli.engine.drive import orbit
from topcli.errors import ExitCode
from topcli.schemes.registry import names_for
from topcli.studies import SILENT, Watch
from topcli.studies.entries import entries_of, experiment_on
from topcli.studies.report import Report, Table
from topcli.tops.bodies import checked_equations

Matrices = NDArray[Any]
"""Stacks (n, size, size) of real or complex matrices."""
MatrixOf = Callable[[Array, complex], Matrices]
"""States (n, 6) and lambda in, matrices (n, size, size) out; affine in the states."""
LAMBDAS: tuple[complex, ...] = (0.5, 1.0, 2.0, 1.0 + 1.0j)
"""Spectral parameters at which spectra are computed."""
_GENERIC = np.array([[0.83, -0.41, 1.27, 0.36, 0.62, -0.71], [-0.57, 1.13, 0.38, -0.81, 0.44, 0.29]])
"""States in general position."""
WEIGHTS = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)
"""Central differences of order 8: the weights of the states 1, 2, 3, 4 steps away."""
RANK_TOLERANCE = 1e-9
_ROWS = 1000
"""Largest number of states of a run that are used."""


@dataclass(frozen=True)
class LaxForm:
    """One form dL/dt = [M, L] of a top's equations.

    ``blocks`` is the number of traces that conjugation keeps: one for an ordinary matrix, tr L^k. The matrices of the
    block form represent Gamma + epsilon M with epsilon² = 0, and conjugation by such matrices keeps two block traces:
    those of the diagonal and of the upper block of L^k, which are the two parts of the trace of (Gamma + epsilon M)^k.
    The trace tr L^k of the whole matrix is twice the first of them.
    """

    name: str
    size: int
    L: MatrixOf
    M: MatrixOf
    lax_pair: bool = True
    """True if the spectrum carries all integrals of the top; otherwise the form only rewrites the equations."""
    blocks: int = 1

    @property
    def traced(self) -> str:
        """Name of the invariants."""
        return "tr L^k" if self.blocks == 1 else "block traces of L^k"

    def invariants(self, states: Array, lam: complex) -> Matrices:
        """Traces of the blocks of L, ..., L^size at ``states`` (n, 6): shape (n, size * blocks)."""
        L = power = self.L(states, lam)
        k, traces = self.size // self.blocks, []
        for _ in range(self.size):
            traces += [np.trace(power[:, :k, i * k : (i + 1) * k], axis1=1, axis2=2) for i in range(self.blocks)]
            power = power @ L
        return np.stack(traces, axis=1)


def _hat(v: Array) -> Matrices:
    """Antisymmetric matrices, with the paper's sign, of vectors (n, 3): shape (n, 3, 3)."""
    a, b, c = v.T
    o = np.zeros_like(a)
    return np.moveaxis(np.array([[o, c, -b], [-c, o, a], [b, -a, o]]), 2, 0)


def block_form(equations: EulerPoisson) -> LaxForm:
    """The paper's form (Gamma M; 0 Gamma), (Omega G; 0 Omega), which every top has, integrable or not.

    It is another form of the Euler-Poisson equations and no Lax pair: its traces contain gamma² and m.gamma alone.
    """
    I, G = np.array(equations.moments), _hat(np.array([equations.gravity]))  # noqa: E741

    def matrix(diagonal: Matrices, upper: Matrices) -> Matrices:
        return np.block([[diagonal, upper + 0.0 * diagonal], [0.0 * diagonal, diagonal]])

    return LaxForm(
        "block",
        6,
        lambda y, lam: matrix(_hat(y[:, 3:]), _hat(I * y[:, :3])),
        lambda y, lam: matrix(_hat(y[:, :3]), G),
        lax_pair=False,
        blocks=2,
    )


def manakov_form(equations: EulerPoisson) -> LaxForm:
    """L = M + lambda J², M = Omega + lambda J with J = diag((B + C - A)/2, ...)."""
    I = np.array(equations.moments)  # noqa: E741
    J = np.diag(0.5 * I.sum() - I)
    return LaxForm(
        "manakov", 3, lambda y, lam: _hat(I * y[:, :3]) + lam * (J @ J), lambda y, lam: _hat(y[:, :3]) + lam * J
    )


def lagrange_form(equations: EulerPoisson) -> LaxForm:
    """L = Gamma + lambda M + lambda² A G, M = Omega + lambda G."""
    I, G = np.array(equations.moments), _hat(np.array([equations.gravity]))  # noqa: E741
    return LaxForm(
        "lagrange",
        3,
        lambda y, lam: _hat(y[:, 3:]) + lam * _hat(I * y[:, :3]) + lam**2 * I[0] * G,
        lambda y, lam: _hat(y[:, :3]) + lam * G,
    )


def kowalevski_form(equations: EulerPoisson) -> LaxForm:
    """The 5x5 pair in so(3, 2); the equations in units of C, in which the paper's A = B = 2, C = 1 hold."""
    c = equations.gravity[0] / equations.moments[2]

    def matrix(upper: Array, side: complex, first: Matrices, lower: Array) -> Matrices:
        V = side * np.eye(3, 2) + first[:, :, None] * [1.0, 0.0]
        W = lower[:, None, None] * np.array([[0.0, 1.0], [-1.0, 0.0]])
        return np.block([[_hat(upper), V], [V.transpose(0, 2, 1), W]])

    return LaxForm(
        "kowalevski",
        5,
        lambda y, lam: matrix(y[:, :3] * [2.0, 2.0, 1.0], 2.0 * lam, -(c / lam) * y[:, 3:], -y[:, 2]),
        lambda y, lam: matrix(y[:, :3], lam, 0.0 * y[:, 3:], 0.0 * y[:, 2]),
    )


def lax_forms(equations: EulerPoisson) -> tuple[LaxForm, ...]:
    """Lax forms of the equations: the pairs of an integrable top, and always the paper's block form."""
    A, B, C = equations.moments
    x, y, z = equations.gravity
    forms = (
        (x == y == z == 0.0, manakov_form),
        (A == B and x == y == 0.0, lagrange_form),
        (A == B == 2.0 * C and y == z == 0.0, kowalevski_form),
        (True, block_form),
    )
    return tuple(form(equations) for holds, form in forms if holds)


def _size(stack: Matrices) -> float:
    return float(np.linalg.norm(stack, axis=(1, 2)).max())


def commutator_residual(form: LaxForm, states: Array, slopes: Array, lam: complex) -> float:
    """Largest ||dL/dt - [M, L]|| relative to the larger of ||dL/dt|| and ||M L||, for ``slopes`` (n, 6) of the states.

    dL/dt is L's linear part at the slopes.
    """
    L, M = form.L(states, lam), form.M(states, lam)
    change = form.L(slopes, lam) - form.L(np.zeros_like(states), lam)
    return _size(change - (M @ L - L @ M)) / (max(_size(change), _size(M @ L)) or 1.0)


def spectral_drift(form: LaxForm, states: Array, lam: complex) -> float:
    """Largest change of ``form.invariants`` from the first state, relative to ||L||^k; round-off on the exact flow."""
    traces = form.invariants(states, lam)
    degrees = np.repeat(np.arange(1.0, form.size + 1.0), form.blocks)
    return float((np.abs(traces - traces[0]) / _size(form.L(states, lam)) ** degrees).max())


def _gradients(values: Callable[[Array], Array], state: Array, d: int) -> Array:
    """Gradients (k, d) of polynomials ``values(states)`` (n, k), of degree eight at most, in the first d components."""
    steps = [k * np.eye(6)[:d] for k in (0.1, 0.2, 0.3, 0.4)]
    pairs = [w * (values(state + e) - values(state - e)) for w, e in zip(WEIGHTS, steps, strict=True)]
    return 10.0 * np.sum(pairs, axis=0).T


def spectral_content(form: LaxForm, invariants: Sequence[Invariant], d: int) -> tuple[int, tuple[str, ...]]:
    """Number of independent integrals in the traces of a Lax form, and names of the ``invariants`` among them.

    The rank of the gradients of the traces at ``LAMBDAS``, at states in general position. An invariant, a function of
    the first ``d`` components of the state, is among the integrals if its gradient lies in the span of these gradients.
    """
    independent, carried = 6, {invariant.name for invariant in invariants}
    for state in _GENERIC:
        rows = np.concatenate([_gradients(lambda y, z=lam: form.invariants(y, z), state, 6) for lam in LAMBDAS])
        rows = np.concatenate([np.real(rows), np.imag(rows)])
        sizes = np.linalg.norm(rows, axis=1, keepdims=True)
        rows = (rows / np.maximum(sizes, 1e-300))[sizes[:, 0] > RANK_TOLERANCE * sizes.max()]
        _, values, basis = np.linalg.svd(rows)
        rank = int((values > RANK_TOLERANCE * values[0]).sum())
        independent, span = min(independent, rank), basis[:rank, :]
        for invariant in invariants:
            gradient = np.zeros(6)
            gradient[:d] = _gradients(lambda y, f=invariant: f.value(y[:, :d])[:, None], state, d)[0]
            outside = gradient - span.T @ (span @ gradient)
            if np.linalg.norm(outside) > 1e-8 * np.linalg.norm(gradient):
                carried.discard(invariant.name)
    return independent, tuple(invariant.name for invariant in invariants if invariant.name in carried)


def lax(
    top: str,
    *schemes: str,
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    watch: Watch = SILENT,
) -> Report:
    """Check Lax forms (pairs L, M) of a top and the spectrum of L.

    A Lax form is a pair of matrices L and M that depend on the state. The study tests the Lax equation dL/dt = [M, L]
    along the motion and measures the drift of the spectrum of L under each scheme.

    Parameters
    ----------
    top : str
        Name of a top.
    *schemes : str
        Names of schemes. By default, all schemes of the top except adaptive ones are tested.
    config : path, str or mapping, optional
        Config of the experiment; by default, a generic initial state with h = 0.01 and N = 5000.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        ``table`` has a row for each Lax form. The second table has a row for the exact flow and one for each scheme,
        with the largest relative drifts of the spectrum of L.

    Raises
    ------
    UsageError
        If the top or a scheme is unknown, or if the config is for another top.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.lax("euler", "hk", overrides=["N=200"])
    >>> report.table["Lax pair"].to_dict()
    {'manakov': True, 'block': False}
    """
    experiment = experiment_on(top, "", config, overrides, h=0.01, N=5000)
    body, h, N = experiment.top, experiment.h, experiment.N
    equations = checked_equations(body, "the study of Lax forms")
    pairs, every = lax_forms(equations), max(1, N // _ROWS)
    adaptive = "" if schemes else "adaptive"
    compared = entries_of(
        experiment, schemes, names_for(body.form), lambda entry: adaptive if entry.scheme.adaptive else ""
    )
    watch.begin("lax", experiment, unit="schemes")

    def drifts(states: Array) -> dict[str, float]:
        with np.errstate(all="ignore"):  # a run may blow up
            return {
                f"{pair.name}: {pair.traced}": max(spectral_drift(pair, _with_gamma(states), lam) for lam in LAMBDAS)
                for pair in pairs
            }

    exact = _with_gamma(reference_states(body, experiment.y0, np.arange(0, N + 1, every) * h))
    slopes = np.stack(equations.rates(tuple(exact.T)), axis=1)
    table = []
    for pair in pairs:
        independent, carried = spectral_content(pair, body.invariants(), len(body.components))
        row = {
            "form": pair.name,
            "size": f"{pair.size}x{pair.size}",
            "dL/dt - [M,L]": max(commutator_residual(pair, exact, slopes, lam) for lam in LAMBDAS),
            "traces": pair.traced,
            "independent integrals": independent,
            "carried integrals": ", ".join(carried) or None,
            "Lax pair": pair.lax_pair,
        }
        table.append(row)
    runs: list[dict[str, Any]] = [{"scheme": "exact flow", **drifts(exact)}]
    errors = []
    for name, each in compared.items():
        method = each.method()
        _, states, ending = orbit(body, method, each.y0, h, N, every)
        runs.append({"scheme": name, **drifts(states)})
        watch(len(runs) - 1, len(compared))
        if ending.outcome is not Outcome.COMPLETED:
            errors.append(f"{name}: {ending.message}")
    answer = "; ".join(f"{pair.name} is {'a' if pair.lax_pair else 'no'} Lax pair" for pair in pairs)
    title = f"{experiment.name}: {body.title}, h = {h:g}, N = {N}"
    tables = [Table("Lax forms", table), Table("Drift of the spectrum", runs)]
    code = ExitCode.FAILED if errors else ExitCode.SUCCESS
    return Report("lax", title, answer, tables, (), errors, code, experiment.resolved())


def _with_gamma(states: Array) -> Array:
    """States as omega and gamma (n, 6); without gravity gamma may be missing and is then zero."""
    return np.pad(states, ((0, 0), (0, 6 - states.shape[1])))
