"""Trials of schemes in the hard cases, and failures compared with the declared limits."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from topcli.contracts import Scheme
from topcli.errors import (
    ConfigError,
    RunError,
    SchemeCodeError,
    StepTooLongError,
    UsageError,
    nearest,
    shortened,
)
from topcli.schemes.own_tops import forms
from topcli.schemes.plugins import reason_of, users_error
from topcli.schemes.registry import find_scheme, names_for, schemes_of
from topcli.store.provenance import environment
from topcli.studies.stress.cases import CASES, cases_named, cases_of
from topcli.studies.stress.checks import Case, CaseCache, CaseOutcome, Finding, Trial, false_order
from topcli.tops import TOPS

GENERIC = "backwards"
"""Case of every top whose motion is a generic one with a short step: there every scheme has its order."""
CODE_FAILED = "code failed"


@dataclass(frozen=True)
class JudgedTrial:
    """The finding of a trial and its verdict.

    ``verdict`` is ``"limit"`` if the scheme broke as it declares, ``"unexplained"`` if it broke without declaring it,
    ``"outlived limit"`` if it declares a limit and did not break, ``"code failed"`` if its code raised or could not be
    compiled, and ``"ok"`` otherwise.
    """

    case: Case
    scheme: Scheme
    finding: Finding
    verdict: str
    limit: str
    counters: Mapping[str, int]
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        return {
            "scheme": self.scheme.name,
            "top": self.scheme.top,
            "case": self.case.name,
            "outcome": self.finding.result.value,
            "step": self.finding.step,
            "why": self.finding.why,
            "verdict": self.verdict,
            "limit": self.limit or None,
            "figures": {key: value if np.isfinite(value) else None for key, value in self.finding.figures.items()},
            "counters": dict(self.counters),
            "seconds": self.seconds,
        }


def verdict_of(scheme: Scheme, case: str, result: CaseOutcome) -> str:
    """Verdict on the result of a case, given the limits that the scheme declares.

    A composed scheme has the limits of its base but need not reach them.
    """
    declared = case in scheme.limits
    if result is CaseOutcome.BROKE:
        return "limit" if declared else "unexplained"
    return "outlived limit" if declared and "+" not in scheme.name else "ok"


def judged_trial(
    case: Case,
    scheme: Scheme,
    cache: CaseCache,
    options: Mapping[str, Any] | None = None,
    generic: Case | None = None,
) -> JudgedTrial:
    """Try one scheme in one case.

    An order that is lost in the ``generic`` case of the top as well, if that is given, counts as a false declaration.
    """
    start = time.perf_counter()
    counters: Mapping[str, int] = {}
    failed, known = False, scheme.options.model_fields
    given = {key: value for key, value in (options or {}).items() if key in known}
    try:
        trial = Trial(case, case.experiment(scheme.name, given), cache)
        with np.errstate(all="ignore"):
            finding = case.check(trial)
            if generic is not None and finding.result is CaseOutcome.DEGRADED and "order" in finding.figures:
                why = false_order(Trial(generic, generic.experiment(scheme.name, given), cache))
                if why:
                    finding = replace(finding, result=CaseOutcome.BROKE, why=f"on a generic motion {why}")
        counters = trial.counters
    except (StepTooLongError, RunError) as error:
        finding = Finding(CaseOutcome.BROKE, f"refused: {str(error).splitlines()[0]}", 0)
    except ConfigError:
        raise
    except (ArithmeticError, ValueError) as error:
        # the interpreter may raise where machine code returns inf or nan
        finding = Finding(CaseOutcome.BROKE, f"failed: {users_error(error) or reason_of(error)}", 0)
    except Exception as error:
        known_error = error if isinstance(error, SchemeCodeError) else users_error(error)
        if known_error is None:
            raise
        finding, failed = Finding(CaseOutcome.BROKE, str(known_error), 0), True
    limit = scheme.limits.get(case.name, "")
    verdict = CODE_FAILED if failed else verdict_of(scheme, case.name, finding.result)
    return JudgedTrial(case, scheme, finding, verdict, limit, counters, time.perf_counter() - start)


def generic_case(form: str) -> Case:
    """Case of a top on whose motion every scheme has its order."""
    return next(case for case in cases_of(form) if case.name == GENERIC)


def chosen(schemes: Sequence[str], cases: Sequence[str], top: str | None) -> tuple[list[Scheme], list[Case]]:
    """Return the schemes and cases to try; all if none is named.

    Raises UnknownNameError for unknown names, and UsageError if nothing is left to try.
    """
    fits = [form.form for form in forms(top)] if top else list(TOPS)
    named = list(dict.fromkeys(case.name for name in cases for case in cases_named(name)))
    if top and cases and not {*named} & {*_names_for(fits)}:
        raise UsageError(f"--case {shortened(cases[0])}: no such case for {top}; {nearest(cases[0], _names_for(fits))}")
    if schemes:
        used = [scheme for name in dict.fromkeys(map(str.lower, schemes)) for scheme in _forms_of(name, fits)]
    else:
        used = [scheme for form in sorted(fits) for scheme in schemes_of(form)]
    asked = list(dict.fromkeys(scheme.top for scheme in used))
    if top is None:  # the cases of tops without their own are tried if they are the only ones
        own = {case.form for case in CASES}
        asked = [form for form in asked if form in own] or asked
    wanted = [case for form in asked for case in cases_of(form) if not cases or case.name in named]
    wanted.sort(key=lambda case: named.index(case.name) if cases else 0)
    used = [scheme for scheme in used if any(case.form == scheme.top for case in wanted)]
    if not used:
        raise UsageError(
            f"none of the schemes {shortened(', '.join(schemes))} has one of the cases; see topcli list cases"
        )
    return used, wanted


def require_options(options: Iterable[str], schemes: Iterable[Scheme]) -> None:
    """Raise UsageError for an option that none of the schemes has."""
    known = {name for scheme in schemes for name in scheme.options.model_fields}
    for key in options:
        if key not in known:
            raise UsageError(
                f"--set scheme.{shortened(key)}: none of the schemes has this option; {nearest(key, known)}"
            )


def _names_for(fits: Collection[str]) -> list[str]:
    return list(dict.fromkeys(case.name for form in fits for case in cases_of(form)))


def _forms_of(name: str, fits: Sequence[str]) -> list[Scheme]:
    """Return the schemes called ``name``, one for each form that it steps. Raises UnknownNameError or UsageError."""
    base = name.partition("+")[0]
    schemes = [find_scheme(name, form) for form in fits if base in names_for(form)]
    # the error of a name that is unknown, or of a scheme for another top
    return schemes or [find_scheme(name, fits[0])]


def stress(
    schemes: Sequence[str] = (),
    cases: Sequence[str] = (),
    top: str | None = None,
    options: Mapping[str, Any] | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[JudgedTrial]:
    """Try every chosen scheme in every chosen case of its top, in the order of the registry.

    Each of ``options`` is set for the schemes that have it. Raises UsageError for unknown schemes, cases and tops.
    """
    used, wanted = chosen(schemes, cases, top)
    pairs = [(case, scheme) for scheme in used for case in wanted if case.form == scheme.top]
    cache = CaseCache()
    done: list[JudgedTrial] = []
    for case, scheme in pairs:
        done.append(judged_trial(case, scheme, cache, options, generic_case(case.form)))
        on_progress(len(done), len(pairs))
    return done


SCHEMA_VERSION = 1


def stress_data(judged: Sequence[JudgedTrial]) -> dict[str, Any]:
    """Return the study as plain data: the cases, the trials, and the number of each outcome and verdict."""
    asked = {(trial.case.name, trial.case.form): trial.case for trial in judged}
    outcomes = [trial.finding.result.value for trial in judged]
    verdicts = [trial.verdict for trial in judged]
    return {
        "schema_version": SCHEMA_VERSION,
        "cases": [{"case": case.name, "top": case.form, "question": case.question} for case in asked.values()],
        "trials": [trial.as_dict() for trial in judged],
        "outcomes": {value: outcomes.count(value) for value in dict.fromkeys(outcomes)},
        "verdicts": {value: verdicts.count(value) for value in dict.fromkeys(verdicts)},
        "environment": environment(),
    }
