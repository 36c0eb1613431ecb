"""``topcli lax``: the Lax forms of a top along the motion and along runs of its schemes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.lax import (
    LAMBDAS,
    commutator_residual,
    lax_forms,
    rates,
    spectral_content,
    spectral_drift,
)
from topcli.analysis.reference import reference_states
from topcli.contracts import Array, Outcome
from topcli.engine.drive import orbit
from topcli.errors import ExitCode
from topcli.schemes.registry import names_for
from topcli.studies import SILENT, Watch
from topcli.studies.entries import entries_of, experiment_on
from topcli.studies.report import Report, Table
from topcli.tops.bodies import checked_equations

_ROWS = 1000
"""Largest number of states of a run that are used."""
NO_PAIR = (
    "block: no Lax pair: dL/dt = [M, L] holds for every top, integrable or not: it is another form of the "
    "Euler-Poisson equations. Conjugation conserves the block traces of L^k, of the diagonal and of the upper 3x3 "
    "block. They contain only γ² and m·γ, neither the energy nor a fourth integral; the trace tr L^k of the 6x6 matrix "
    "contains γ² alone"
)


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
    slopes = rates(equations, exact)
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
    return Report("lax", title, answer, tables, [NO_PAIR], errors, code, experiment.resolved())


def _with_gamma(states: Array) -> Array:
    """States as omega and gamma (n, 6); without gravity gamma may be missing and is then zero."""
    return np.pad(states, ((0, 0), (0, 6 - states.shape[1])))
