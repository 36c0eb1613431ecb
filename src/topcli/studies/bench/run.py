"""Bench one problem: choose who takes part, measure, put the result together."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from topcli.analysis.reference import reference_states
from topcli.contracts import Array, Sampler, Scheme, Stepper
from topcli.errors import UsageError
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import SchemeMisfitError, composable_names, find_scheme, names_for
from topcli.store.provenance import environment, installed
from topcli.studies.bench.competitors import (
    Competitor,
    NoResultError,
    PeerCompetitor,
    PeerProcess,
    SchemeCompetitor,
    closed_form,
)
from topcli.studies.bench.front import decade_rows, front
from topcli.studies.bench.measure import Effort, Standing, as_rows, deviations, explore, time_all
from topcli.studies.bench.scenes import Problem
from topcli.studies.identity import method_fingerprint
from topcli.studies.peers import Peer, missing
from topcli.studies.report import finite

COMPOSED = {"hk": ("kahan-li6", "kahan-li8")}
"""Compositions that take part when no scheme is named, where the base fits."""


@dataclass(frozen=True)
class Entrants:
    """Who takes part: ``schemes`` of ours, ``exact`` solutions apart, and who is left out and why."""

    schemes: tuple[Scheme, ...]
    exact: tuple[Scheme, ...]
    left_out: tuple[tuple[str, str], ...]


def default_names(form: str) -> list[str]:
    """Every scheme of a form of a top, and the compositions of ``COMPOSED``."""
    names, composable = names_for(form), composable_names(form)
    composed = [f"{base}+{name}" for base in COMPOSED if base in composable for name in COMPOSED[base]]
    assert all(name in COMPOSITIONS for one in COMPOSED.values() for name in one)
    return [*names, *composed]


def choose(problem: Problem, names: Sequence[str]) -> Entrants:
    """The schemes ``names`` that fit the problem's top; every one where none is named.

    A scheme that is named and cannot be measured is a mistake, a UsageError; one that fits other tops only, or that
    is there by default and runs in the interpreter, is left out. Raises UnknownNameError with the nearest names.
    """
    schemes: list[Scheme] = []
    exact: list[Scheme] = []
    left_out: list[tuple[str, str]] = []
    for name in names or default_names(problem.top.form):
        try:
            scheme = find_scheme(name, problem.top.form)
        except SchemeMisfitError:
            left_out.append((name, f"does not fit the top {problem.top.form}"))
            continue
        if scheme in schemes or scheme in exact:
            raise UsageError(f"scheme {scheme.name!r} is named twice")
        try:
            method = scheme.build(problem.top, scheme.options())
        except ValidationError as error:
            left_out.append((scheme.name, f"needs options ({error.errors()[0]['loc'][0]})"))
            continue
        if isinstance(method, Sampler) and scheme.order is None:
            exact.append(scheme)
        elif isinstance(method, Sampler):
            left_out.append((scheme.name, "is evaluated, not stepped: its error is that of the scheme it solves"))
        elif isinstance(method, Stepper) and method.plain and not names:
            left_out.append(
                (scheme.name, "runs in the interpreter; the peer scipy is the same method, and tells its cost")
            )
        else:
            schemes.append(scheme)
    return Entrants(tuple(schemes), tuple(exact), tuple(left_out))


def code_of(entrants: Entrants, problem: Problem) -> str:
    """A digest of the code of all schemes that take part."""
    codes = [method_fingerprint(scheme.build(problem.top, scheme.options())) for scheme in entrants.schemes]
    return hashlib.sha256(" ".join(codes).encode()).hexdigest()


def _peer_competitors(
    peers: Sequence[Peer], problem: Problem, processes: int, stack: ExitStack
) -> tuple[list[PeerCompetitor], list[tuple[str, str]], list[tuple[str, str]]]:
    """The variants of the peers, running; those not installed, and those that failed, with the reasons."""
    absent = [(peer.name, reason) for peer in peers if (reason := missing(peer))]
    started: list[tuple[Peer, list[PeerProcess]]] = []
    for peer in peers:
        if not missing(peer):
            group = [PeerProcess(peer, problem) for _ in range(processes if peer.varies else 1)]
            for process in group:
                stack.callback(process.close)
            started.append((peer, group))
    competitors, failed = [], []
    for peer, group in started:
        try:
            answers = [process.answer() for process in group]
        except NoResultError as failure:
            failed.append((peer.name, str(failure)))
            continue
        competitors += [PeerCompetitor(peer, variant, group, problem) for variant in answers[0]["variants"]]
    return competitors, absent, failed


def _row(standing: Standing, duration: float) -> dict[str, Any]:
    competitor = standing.competitor
    return {
        "name": competitor.name,
        "kind": competitor.kind,
        "order": competitor.order,
        "parameter": competitor.parameter,
        "compile_seconds": sum(rung.compile_seconds for rung in standing.rungs),
        "ended": standing.ended,
        "failed": [{"value": value, "reason": reason} for value, reason in standing.failed],
        "broken": standing.broken or None,
        "points": as_rows(standing, duration),
    }


def _closed_forms(schemes: Sequence[Scheme], problem: Problem, reference: Array) -> list[dict[str, Any]]:
    """The solutions in closed form, apart: what they cost goes with the number of looks, not with time."""
    rows = []
    for scheme in schemes:
        states, seconds = closed_form(scheme, problem)
        errors = np.linalg.norm(states - reference, axis=1)
        rows.append(
            {
                "name": scheme.name,
                "title": scheme.title,
                "error": float(errors.max()),
                "end_error": float(errors[-1]),
                "invariants": deviations(problem.top.invariants(), states),
                "seconds_per_state": seconds / len(states),
            }
        )
    return rows


def bench(
    problem: Problem,
    entrants: Entrants,
    peers: Sequence[Peer],
    effort: Effort,
    *,
    processes: int = 5,
    progress: Callable[[int, int], None] = lambda done, total: None,
    told: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Measure the schemes of ``entrants`` and the ``peers`` on ``problem``: the result as plain data.

    A peer that varies from process to process is measured in so many ``processes``. ``told`` receives lines of talk:
    every peer that is left out, by name, among them. Raises RunError when the motion cannot be followed.
    """
    reference = reference_states(problem.top, problem.experiment.y0, problem.times)
    with ExitStack() as stack:
        others, absent, failed = _peer_competitors(peers, problem, processes, stack)
        for name, reason in absent:
            told(f"{problem.name}: peer {name} is skipped: {reason}")
        for name, reason in failed:
            told(f"error: {problem.name}: peer {name} failed: {reason}")
        taking_part: list[Competitor] = [*(SchemeCompetitor(scheme, problem) for scheme in entrants.schemes), *others]
        standings = []
        for i, competitor in enumerate(taking_part):
            standings.append(explore(competitor, problem, reference, effort))
            progress(i + 1, 2 * len(taking_part))
        time_all(standings, effort, lambda done, total: progress(total + done, 2 * total))
    rows = [_row(standing, problem.duration) for standing in standings]
    for row in rows:
        if row["broken"]:
            told(f"error: {problem.name}: {row['name']} failed: {row['broken']}")
        elif not row["points"]:
            reason = row["failed"][0]["reason"] if row["failed"] else row["ended"]
            told(f"{problem.name}: {row['name']} gave no result: {reason}")
    return finite(
        {
            "name": problem.name,
            "title": problem.title,
            "top": problem.top.title,
            "config": problem.experiment.resolved(),
            "duration": problem.duration,
            "intervals": problem.intervals,
            "goal": problem.goal,
            "reference": "Taylor series in double-double arithmetic",
            "effort": {"budget": effort.budget, "repetitions": effort.repetitions, "processes": processes},
            "competitors": rows,
            "closed_forms": _closed_forms(entrants.exact, problem, reference),
            "left_out": [{"name": name, "reason": reason} for name, reason in entrants.left_out],
            "skipped_peers": [{"name": name, "reason": reason} for name, reason in absent],
            "failed_peers": [{"name": name, "reason": reason} for name, reason in failed],
            "front": front(rows),
            "decades": decade_rows(rows),
            "environment": {
                **environment(),
                "peers": {package: installed(package) for peer in peers for package in peer.requires},
            },
        }
    )
