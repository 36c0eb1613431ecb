"""Failures of ``topcli compare`` for an ensemble."""

from __future__ import annotations

from typing import Any

from topcli.cli.output import print_message


def say_ensemble_failures(figures: dict[str, Any]) -> int:
    """Report trajectories that failed and measures without a value; the exit code."""
    schemes = figures["schemes"]
    for one in schemes:
        if set(one["outcomes"]) != {"completed"}:
            print_message(f"error: {one['label']}: {one['message']}")
        for name, fault in one["faults"].items():
            missing = f"no value for {fault['count']} of {figures['trajectories']} trajectories"
            print_message(
                f"warning: {one['label']}: {name}: {missing}; trajectory {fault['trajectory']}: {fault['reason']}"
            )
    if all(set(one["outcomes"]) == {"completed"} for one in schemes):
        return 0
    return 3 if any("completed" in one["outcomes"] for one in schemes) else 1
