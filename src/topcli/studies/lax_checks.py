"""Checks of the Lax forms of a top along the motion and along runs of its schemes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.lax import (
    LAMBDAS,
    LaxForm,
    commutator_residual,
    conjugation_defect,
    difference_slopes,
    discrete_lax_defect,
    eigenvalue_shift,
    lax_forms,
    rates,
    spectral_content,
    spectral_drift,
)
from topcli.analysis.reference import reference_states
from topcli.analysis.trajectory import Trajectory
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Top
from topcli.engine.run import Run
from topcli.errors import UsageError, shortened
from topcli.runs.report import finite
from topcli.runs.simulate import trajectory_of
from topcli.schemes.own_tops import forms, other_forms
from topcli.schemes.registry import find_scheme, names_for
from topcli.studies.entries import under_scheme
from topcli.tops import BodyTop
from topcli.tops.bodies import checked_equations

NAME = "the study of Lax forms"
BODIES = (BodyTop.components, BodyTop.components[:3])
ROWS = 1000
"""Largest number of states of a run that are used."""
DIFFERENCES = 40
"""Times at which dL/dt is computed by differences of the reference."""
MIDPOINT_STEPS = 200
DISCRETE_STEPS = 200
"""Steps over which the discrete Lax pair is checked."""
DEFECT_FLOOR = 1e-13
"""Conjugation defects below this are rounding errors, without an order in h."""
INITIAL = {"omega": (0.7, -0.4, 1.3), "gamma": (0.6, 0.48, 0.64)}
"""Default initial state, in general position."""
NO_PAIR = (
    "dL/dt = [M, L] holds for every top, integrable or not: it is another form of the Euler-Poisson equations. "
    "Conjugation conserves the block traces of L^k, of the diagonal and of the upper 3x3 block. They contain only γ² "
    "and m·γ, neither the energy nor a fourth integral; the trace tr L^k of the 6x6 matrix contains γ² alone"
)


def lax_experiment(name: str, config: str | Path | None, sets: Sequence[str]) -> Experiment:
    """Experiment to check: that of ``config``, of the top ``name``, or one that starts in general position.

    Raises UsageError for a config of another top or a state that is not omega, gamma.
    """
    top = forms(name)[0]
    if config is not None:
        experiment = load_experiment(config, sets)
        if experiment.top.kind != top.kind:
            raise UsageError(f"lax: {shortened(str(config))} is of the top {experiment.top.kind!r}, not {top.kind!r}")
    else:
        _require_body(top)
        names = names_for(top.form)
        experiment = load_experiment(
            {
                "top": top.kind,
                "initial": {name: INITIAL[name] for name in top.vectors},
                "scheme": "hk" if "hk" in names else names[0],
                "h": 0.01,
                "N": 5000,
            },
            sets,
        )
    _require_body(type(experiment.top))
    return experiment


def _require_body(top: type[Top]) -> None:
    """Raise UsageError for a top whose state is not omega, or omega and gamma."""
    if tuple(top.components) not in BODIES:
        other = next((form.form for form in other_forms(top) if tuple(form.components) in BODIES), "")
        raise UsageError(
            f"lax: the matrices are written for omega and gamma, not for ({', '.join(top.components)}) of the top "
            f"{top.form}; {f'take the top {other}, or ' if other else ''}give a config with the state in the body frame"
        )


def default_schemes(experiment: Experiment) -> list[str]:
    """All schemes of the experiment's top except the adaptive ones, which are slow."""
    form = experiment.top.form
    return [name for name in names_for(form) if not find_scheme(name, form).adaptive]


def _body(states: Array) -> Array:
    """States as omega and gamma (n, 6); without gravity gamma may be missing and is then zero."""
    return np.hstack([states, np.zeros((len(states), 6 - states.shape[1]))])


def _each(measure: Any, form: LaxForm) -> list[float]:
    """``measure(lambda)`` at every lambda; at one only if the form has no spectral parameter."""
    return [measure(lam) for lam in (LAMBDAS if form.spectral else LAMBDAS[:1])]


def _windows(experiment: Experiment) -> tuple[Array, float]:
    """States (m, 9, 6) of the motion at 9 times around each of m times, and the spacing of the 9."""
    top, y0 = experiment.top, np.array(experiment.y0)
    speed = float(np.abs(rates(checked_equations(top, NAME), _body(y0[None, :]))).max() + np.abs(y0).max())
    step = math.copysign(0.01 / max(1.0, speed), experiment.h)
    starts = np.linspace(0.0, experiment.duration, DIFFERENCES)
    times = (starts[:, None] + step * np.arange(9)).ravel()
    order = np.argsort(np.abs(times), kind="stable")
    states = np.empty((len(times), len(y0)))
    states[order] = reference_states(top, experiment.y0, times[order])
    return _body(states).reshape(DIFFERENCES, 9, 6), step


def _midpoint_states(experiment: Experiment, h: float, steps: int) -> Array:
    """States (n, 6) of the midpoint rule after 0 to ``steps`` steps, up to the first that does not converge."""
    top, rule = experiment.top, find_scheme("midpoint", experiment.top.form)
    return _body(Run(top, rule.build(top, rule.options()), experiment.y0, h, steps).collect().states)


def _pairs(numbers: Array) -> list[list[float]]:
    return [[float(z.real), float(z.imag)] for z in sorted(numbers, key=lambda z: (round(z.real, 9), z.imag))]


def _form_figures(
    form: LaxForm, experiment: Experiment, reference: Array, windows: Array, step: float
) -> dict[str, Any]:
    top = experiment.top
    slopes = rates(checked_equations(top, NAME), reference)
    middle, by_differences = windows[:, 4], difference_slopes(windows, step)
    content = spectral_content(form, top.invariants(), len(top.components))
    defects = []
    for h, steps in ((experiment.h, MIDPOINT_STEPS), (0.5 * experiment.h, 2 * MIDPOINT_STEPS)):
        states = _midpoint_states(experiment, h, steps)
        if len(states) == steps + 1:
            defects.append(max(_each(lambda lam, s=states, h=h: conjugation_defect(form, s, h, lam), form)))
    first = reference[:1]
    return {
        "form": form.name,
        "title": form.title,
        "citation": form.citation,
        "size": form.size,
        "lax_pair": form.lax_pair,
        "traces": form.traced,
        "why_not": None if form.lax_pair else NO_PAIR,
        "residual_by_field": max(_each(lambda lam: commutator_residual(form, reference, slopes, lam), form)),
        "residual_by_differences": max(_each(lambda lam: commutator_residual(form, middle, by_differences, lam), form)),
        "independent_integrals": content.independent,
        "carries": list(content.carries),
        "spectrum": [
            {"lambda": [lam.real, lam.imag], "eigenvalues": _pairs(np.linalg.eigvals(form.L(first, lam))[0])}
            for lam in map(complex, LAMBDAS if form.spectral else LAMBDAS[:1])
        ],
        "midpoint": {
            "steps": MIDPOINT_STEPS,
            "conjugation_defect": defects[0] if len(defects) == 2 else None,
            "order": math.log2(defects[0] / defects[1]) if len(defects) == 2 and defects[1] > DEFECT_FLOOR else None,
        },
    }


def _drift(name: str, label: str, forms: Sequence[LaxForm], states: Array) -> dict[str, Any]:
    return {
        "scheme": name,
        "outcome": label,
        "forms": [
            {
                "form": form.name,
                "drift": max(_each(lambda lam, form=form: spectral_drift(form, states, lam), form)),
                "eigenvalue_shift": max(_each(lambda lam, form=form: eigenvalue_shift(form, states, lam), form)),
            }
            for form in forms
        ],
    }


def _discrete_lax(experiment: Experiment, forms: Sequence[LaxForm]) -> float | None:
    """Largest defect of ``backlund``'s discrete Lax pair over the first steps of a run; None for another top."""
    form = next((form for form in forms if form.name == "kowalevski"), None)
    if form is None:
        return None
    N = min(experiment.N, DISCRETE_STEPS)
    output = experiment.output.model_copy(update={"every": 1})
    states = _body(trajectory_of(experiment.model_copy(update={"N": N, "output": output})).states)
    return (
        max(_each(lambda lam: discrete_lax_defect(form, states, experiment.h, lam), form)) if len(states) > 1 else None
    )


def _thinned(trajectory: Trajectory) -> Array:
    rows = np.unique(np.linspace(0, len(trajectory) - 1, ROWS).astype(int))
    return _body(trajectory.states[rows])


def lax_study(experiment: Experiment, schemes: Sequence[str]) -> dict[str, Any]:
    """Check every Lax form of the experiment's top; plain data, ready for JSON.

    For each form: dL/dt - [M, L] along the motion, with dL/dt from the equations and from differences on the
    reference; which integrals the spectrum carries; the spectrum at the start; how far a step of the midpoint rule
    is from L' = U L U^-1. Then the drift of the spectrum along the exact flow and along a run of each scheme, the
    largest over lambda: deviations of tr L^k, or of the block traces of the block form, relative to ||L||^k, and of the
    eigenvalues relative to ||L||. For the Kowalevski top also the defect L' U - U L of the discrete Lax pair of
    ``backlund`` along each run.
    """
    top = experiment.top
    forms = lax_forms(checked_equations(top, NAME))
    every = max(1, experiment.N // ROWS)
    n = np.arange(0, experiment.N + 1, every)
    reference = _body(reference_states(top, experiment.y0, n * experiment.h))
    windows, step = _windows(experiment)
    runs = [{**_drift("exact flow", "completed", forms, reference), "discrete_lax_defect": None}]
    for name in dict.fromkeys(schemes):
        compared = under_scheme(experiment, name)
        trajectory = trajectory_of(
            compared.model_copy(update={"output": compared.output.model_copy(update={"every": every})})
        )
        with np.errstate(all="ignore"):  # the run may blow up
            runs.append(_drift(compared.scheme.name, trajectory.ending.outcome.value, forms, _thinned(trajectory)))
        runs[-1]["discrete_lax_defect"] = _discrete_lax(compared, forms)
        runs[-1]["message"] = trajectory.ending.message
    return finite(
        {
            "config": experiment.resolved(),
            "lambdas": [[lam.real, lam.imag] for lam in map(complex, LAMBDAS)],
            "forms": [_form_figures(form, experiment, reference, windows, step) for form in forms],
            "runs": runs,
        }
    )
