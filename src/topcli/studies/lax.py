"""``topcli lax``: the Lax forms of a top along the motion and along runs of its schemes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from topcli.errors import ExitCode, UsageError, shortened
from topcli.studies import SILENT, Watch
from topcli.studies.study import (
    Data,
    Faults,
    Flag,
    Head,
    Overrides,
    Result,
    Study,
    config_flag,
    parts_of,
    scheme_names,
    top_title,
)
from topcli.table import Column, Table, number

if TYPE_CHECKING:
    from topcli.analysis.trajectory import Trajectory
    from topcli.config.models import Experiment
    from topcli.contracts import Array

ROWS = 1000
"""Largest number of states of a run that are used."""
DISCRETE_STEPS = 200
"""Steps over which the discrete Lax pair is checked."""
GENERIC = {"omega": (0.7, -0.4, 1.3), "gamma": (0.6, 0.48, 0.64)}
"""Default initial state, in general position."""
NO_PAIR = (
    "dL/dt = [M, L] holds for every top, integrable or not: it is another form of the Euler-Poisson equations. "
    "Conjugation conserves the block traces of L^k, of the diagonal and of the upper 3x3 block. They contain only γ² "
    "and m·γ, neither the energy nor a fourth integral; the trace tr L^k of the 6x6 matrix contains γ² alone"
)


def measure(
    top: Annotated[str, Flag("", "TOP")],
    *schemes: Annotated[str, scheme_names("all except adaptive ones")],
    config: Annotated[str | Path | None, config_flag("a generic state")] = None,
    overrides: Overrides = (),
    watch: Watch = SILENT,
) -> Result:
    """Check Lax forms (pairs L, M) of a top and the spectrum of L.

    A Lax form is a pair of matrices L and M that depend on the state. The study tests the Lax equation dL/dt = [M, L]
    along the motion and measures the drift of the spectrum of L under each scheme. For the Kowalevski top, it also
    tests the discrete Lax equation L' U = U L, where L' is L after a step and U is another matrix.

    Parameters
    ----------
    top : str
        Name of a top.
    *schemes : str
        Names of schemes. By default, all schemes of the top except adaptive ones are tested.
    config : path or str, optional
        Config of the experiment; by default, a generic initial state with h = 0.01 and N = 5000.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report with two tables. ``table`` has a row for each Lax form. ``drifts`` has a row for the exact flow and one
        for each scheme, with the drifts of the spectrum of L.

    Raises
    ------
    UsageError
        If the top or a scheme is unknown, or if the config is for another top.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.lax("euler", "hk", overrides=["N=200"])
    >>> report.table["lax_pair"].to_dict()
    {'3x3': True}
    """
    import numpy as np

    from topcli.analysis import lax
    from topcli.analysis.reference import reference_states
    from topcli.runs.plans import trajectory_of
    from topcli.runs.report import finite
    from topcli.schemes.registry import find_scheme, names_for
    from topcli.studies.entries import under_scheme
    from topcli.tops.bodies import checked_equations

    experiment = lax_experiment(top, config, overrides)
    watch.begin("lax")
    body = experiment.top
    equations = checked_equations(body, "the study of Lax forms")
    forms = lax.lax_forms(equations)
    every = max(1, experiment.N // ROWS)

    def drifts(states: np.ndarray) -> list[Data]:
        with np.errstate(all="ignore"):  # a run may blow up
            return [{"drift": max(lax.spectral_drift(form, states, lam) for lam in lax.LAMBDAS)} for form in forms]

    def orbit_of(experiment: Experiment, N: int, every: int) -> Trajectory:
        output = experiment.output.model_copy(update={"every": every})
        return trajectory_of(experiment.model_copy(update={"N": N, "output": output}))

    exact = _with_gamma(reference_states(body, experiment.y0, np.arange(0, experiment.N + 1, every) * experiment.h))
    about = {"scheme": "exact flow", "outcome": "completed", "discrete_lax_defect": None}
    runs: list[Data] = [{**about, "forms": drifts(exact)}]
    defaults = (name for name in names_for(body.form) if not find_scheme(name, body.form).adaptive)
    for name in dict.fromkeys(schemes or defaults):
        compared = under_scheme(experiment, name)
        orbit = orbit_of(compared, experiment.N, every)
        defect = None
        for form in forms:
            if form.name == "kowalevski":
                first = orbit_of(compared, min(experiment.N, DISCRETE_STEPS), 1).states
                defects = [lax.discrete_lax_defect(form, first, experiment.h, lam) for lam in lax.LAMBDAS]
                defect = max(defects)
        about = {"scheme": compared.scheme.name, "outcome": orbit.outcome.value, "discrete_lax_defect": defect}
        runs.append({**about, "message": orbit.ending.message, "forms": drifts(_with_gamma(orbit.states))})
    rows, slopes = [], lax.rates(equations, exact)
    for form in forms:
        independent, carried = lax.spectral_content(form, body.invariants(), len(body.components))
        residual = max(lax.commutator_residual(form, exact, slopes, lam) for lam in lax.LAMBDAS)
        about = {"form": form.name, "size": form.size, "lax_pair": form.lax_pair, "traces": form.traced}
        rows.append({**about, "residual": residual, "independent_integrals": independent, "carries": list(carried)})
    return Result(finite({"config": experiment.resolved(), "forms": rows, "runs": runs}))


def _with_gamma(states: Array) -> Array:
    """States as omega and gamma (n, 6); without gravity gamma may be missing and is then zero."""
    import numpy as np

    return np.pad(states, ((0, 0), (0, 6 - states.shape[1])))


def lax_experiment(name: str, config: str | Path | None, overrides: Sequence[str]) -> Experiment:
    """Experiment to check: that of ``config``, or of the top ``name`` from a state in general position.

    Raises UsageError for a config of another top or a state that is not omega, or omega and gamma.
    """
    from topcli.config.load import load_experiment
    from topcli.schemes.own_tops import forms
    from topcli.schemes.registry import names_for
    from topcli.tops import BodyTop

    top = forms(name)[0]
    experiment = None if config is None else load_experiment(config, overrides)
    cls = top if experiment is None else type(experiment.top)
    if cls.kind != top.kind:
        raise UsageError(f"lax: {shortened(str(config))} is of the top {cls.kind!r}, not {top.kind!r}")
    if tuple(cls.components) not in (BodyTop.components, BodyTop.components[:3]):
        components = ", ".join(cls.components)
        raise UsageError(f"lax: the matrices are written for omega and gamma, not for ({components}) of {cls.form}")
    names = names_for(cls.form)
    generic = {
        "top": cls.kind,
        "initial": {vector: GENERIC[vector] for vector in cls.vectors},
        "scheme": "hk" if "hk" in names else names[0],
        "h": 0.01,
        "N": 5000,
    }
    return experiment or load_experiment(generic, overrides)


def _subject(data: Data) -> str:
    config = data["config"]
    return f"{config['name']}: {top_title(config)}, h = {config['h']:g}, N = {config['N']}"


FORMS = Table(
    "forms",
    (
        Column("size", "size", lambda size: f"{size}x{size}"),
        Column("dL/dt - [M,L]", "residual", number),
        Column("traces", "traces"),
        Column("independent integrals", "independent_integrals"),
        Column("carried integrals", lambda form: ", ".join(form["carries"]) or None, key="carried_integrals"),
        Column("Lax pair", "lax_pair", lambda pair: "yes" if pair else "no"),
    ),
    heading="Lax forms",
    title=_subject,
    index="form",
    across=Column("", "form"),
)


def _drift_columns(data: Data) -> list[Column]:
    traces = [
        Column(f"{form['form']}: {form['traces']}", f"forms.{i}.drift", number, f"{form['form']}_drift")
        for i, form in enumerate(data["forms"])
    ]
    discrete = "L'U - UL" if _discrete(data) else ""
    return [Column(" ", "scheme"), *traces, Column(discrete, "discrete_lax_defect", number)]


def _discrete(data: Data) -> bool:
    return any(run["discrete_lax_defect"] is not None for run in data["runs"])


DRIFTS = Table(
    "runs",
    _drift_columns,
    name="drifts",
    heading="Drift of the spectrum",
    title="largest relative drift of the spectrum of L",
    index="scheme",
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    failed = len(faults(data).lines)
    return Head("Lax forms", _subject(data), f"{failed} failed" if failed else "measured", not failed)


def answer(data: Data) -> str:
    """Forms that are Lax pairs."""
    return "; ".join(f"{form['form']} is {'a' if form['lax_pair'] else 'no'} Lax pair" for form in data["forms"])


def notes(data: Data) -> Iterator[str]:
    """Meaning of the discrete Lax pair, and the reason why the block form is not a Lax pair."""
    if _discrete(data):
        yield "L'U - UL: defect of the discrete Lax pair of backlund, over the first steps of a run"
    yield f"block: no Lax pair: {NO_PAIR}"


def faults(data: Data) -> Faults:
    """Runs that did not complete."""
    lines = [f"{run['scheme']}: {run['message']}" for run in data["runs"] if run["outcome"] != "completed"]
    return Faults(ExitCode.FAILED if lines else ExitCode.SUCCESS, lines)


LAX = Study(
    "lax",
    measure,
    head,
    (FORMS, DRIFTS),
    answer=answer,
    notes=notes,
    faults=faults,
    parts=lambda data: parts_of(data["config"], [run["scheme"] for run in data["runs"][1:]]),
)
