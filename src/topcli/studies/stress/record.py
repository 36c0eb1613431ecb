"""The results of the stress study on disk, written whole or not at all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from topcli.engine.fingerprint import fingerprint
from topcli.runs.identity import scheme_code
from topcli.schemes.registry import all_schemes
from topcli.store.provenance import environment
from topcli.store.study import stored_study, write_study
from topcli.studies.stress import CASES
from topcli.studies.stress.checks import false_order
from topcli.studies.stress.suite import Judged, tried
from topcli.tops import TOPS

FILE = "stress.json"
SCHEMA_VERSION = 1


def stress_data(judged: Sequence[Judged]) -> dict[str, Any]:
    """Return the study as plain data: the cases, the trials, and the number of each outcome and verdict."""
    asked = {(one.case.name, one.case.form): one.case for one in judged}
    outcomes = [one.finding.result.value for one in judged]
    verdicts = [one.verdict for one in judged]
    return {
        "schema_version": SCHEMA_VERSION,
        "cases": [{"case": case.name, "top": case.form, "question": case.question} for case in asked.values()],
        "trials": [one.as_dict() for one in judged],
        "outcomes": {value: outcomes.count(value) for value in dict.fromkeys(outcomes)},
        "verdicts": {value: verdicts.count(value) for value in dict.fromkeys(verdicts)},
        "environment": environment(),
    }


def stress_source() -> str:
    """Digest of everything that the results of the whole suite depend on: the code and limits of schemes and cases."""
    schemes = []
    for scheme in all_schemes():
        code = scheme_code(scheme, TOPS[scheme.top].new())
        schemes.append([scheme.name, scheme.top, code, sorted(scheme.limits.items())])
    checks = [
        [case.name, case.form, case.question, fingerprint(case.check, case.config, compiled=False)] for case in CASES
    ]
    text = json.dumps([schemes, checks, fingerprint(tried, false_order, compiled=False)])
    return hashlib.sha256(text.encode()).hexdigest()


def write_stress(data: dict[str, Any], out: Path, source: str | None) -> Path:
    """Write the study to ``out/stress/stress.json`` atomically and return its path.

    ``source`` is the digest of the whole suite; None for a part of it. Raises UsageError and RunError.
    """
    return write_study(out / "stress" / FILE, data, source)


def stored_stress(out: Path) -> dict[str, Any] | None:
    """Return the study stored in ``out/stress``; None if there is none. Raises RunError if it is damaged."""
    return stored_study(out / "stress" / FILE, SCHEMA_VERSION, "topcli stress")
