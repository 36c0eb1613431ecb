"""Bench one problem: measure the line-up and the peers, assemble the result."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.contracts import Array, Scheme
from topcli.runs.identity import scheme_code
from topcli.runs.report import finite
from topcli.store.provenance import environment, installed
from topcli.studies.bench.competitors import (
    MANY,
    Competitor,
    NoResultError,
    PeerCompetitor,
    PeerProcess,
    SchemeCompetitor,
    closed_form,
)
from topcli.studies.bench.front import decade_rows, front
from topcli.studies.bench.line_up import LineUp
from topcli.studies.bench.measure import Effort, Measurements, as_rows, deviations, explore, time_all
from topcli.studies.bench.peers import Peer, missing
from topcli.studies.bench.scenes import Problem


def code_of(line_up: LineUp, problem: Problem) -> str:
    """Digest of the code of all schemes that take part."""
    codes = [scheme_code(scheme, problem.top) for scheme in line_up.schemes]
    return hashlib.sha256(" ".join(codes).encode()).hexdigest()


def _peer_competitors(
    peers: Sequence[Peer], problem: Problem, processes: int, stack: ExitStack
) -> tuple[list[PeerCompetitor], list[tuple[str, str]], list[tuple[str, str]]]:
    """Start the peers; return their variants, and the peers not installed and failed, with the reasons."""
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


def _row(measured: Measurements, duration: float) -> dict[str, Any]:
    competitor = measured.competitor
    return {
        "name": competitor.name,
        "kind": competitor.kind,
        "order": competitor.order,
        "parameter": competitor.parameter,
        "compile_seconds": sum(rung.compile_seconds for rung in measured.rungs),
        "setup_seconds": min((rung.setup_seconds for rung in measured.rungs), default=0.0),
        "ended": measured.ended,
        "failed": [{"value": value, "reason": reason} for value, reason in measured.failed],
        "broken": measured.broken or None,
        "points": as_rows(measured, duration),
    }


def _closed_forms(schemes: Sequence[Scheme], problem: Problem, reference: Array) -> list[dict[str, Any]]:
    """Return rows for the closed forms, whose cost depends on the number of evaluations, not on the duration."""
    rows = []
    for scheme in schemes:
        states, seconds_per_state, setup = closed_form(scheme, problem)
        errors = np.linalg.norm(states - reference, axis=1)
        rows.append(
            {
                "name": scheme.name,
                "title": scheme.title,
                "error": float(errors.max()),
                "end_error": float(errors[-1]),
                "invariants": deviations(problem.top.invariants(), states),
                "seconds_per_state": seconds_per_state,
                "states": MANY,
                "setup_seconds": setup,
            }
        )
    return rows


def bench(
    problem: Problem,
    line_up: LineUp,
    peers: Sequence[Peer],
    effort: Effort,
    *,
    processes: int = 5,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    on_message: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Measure the schemes of ``line_up`` and the ``peers`` on ``problem``; return the result as plain data.

    A peer whose speed varies from process to process is measured in this many ``processes``. ``on_message`` receives
    one line for each peer that is skipped or fails. Raises RunError if the reference cannot follow the motion.
    """
    reference = reference_states(problem.top, problem.experiment.y0, problem.times)
    with ExitStack() as stack:
        others, absent, failed = _peer_competitors(peers, problem, processes, stack)
        for name, reason in absent:
            on_message(f"{problem.name}: peer {name} is skipped: {reason}")
        for name, reason in failed:
            on_message(f"error: {problem.name}: peer {name} failed: {reason}")
        taking_part: list[Competitor] = [*(SchemeCompetitor(scheme, problem) for scheme in line_up.schemes), *others]
        measurements = []
        for i, competitor in enumerate(taking_part):
            measurements.append(explore(competitor, problem, reference, effort))
            on_progress(i + 1, 2 * len(taking_part))
        time_all(measurements, effort, lambda done, total: on_progress(total + done, 2 * total))
    rows = [_row(measured, problem.duration) for measured in measurements]
    for row in rows:
        if row["broken"]:
            on_message(f"error: {problem.name}: {row['name']} failed: {row['broken']}")
        elif not row["points"]:
            reason = row["failed"][0]["reason"] if row["failed"] else row["ended"]
            on_message(f"{problem.name}: {row['name']} gave no result: {reason}")
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
            "closed_forms": _closed_forms(line_up.exact, problem, reference),
            "left_out": [{"name": name, "reason": reason} for name, reason in line_up.left_out],
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
