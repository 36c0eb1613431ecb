"""``topcli show CONFIG --motion``: class, frequencies and neighbourhood of a motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from topcli.cli.output import emit, emit_prose, print_cells, print_json
from topcli.errors import UsageError


def show_motion(config: str, row: int | None, sets: Sequence[str], as_json: bool) -> None:
    """Print what the closed form says about the motion of a config. Raises UsageError for a sweep or an ensemble."""
    from topcli.analysis.motion import NEIGHBOURS, QUANTITIES
    from topcli.analysis.motion.of_top import motion_of
    from topcli.config.load import load_experiment

    if row is not None or Path(config).is_dir():
        raise UsageError(
            "--motion: needs a single experiment, not a sweep; "
            "save a row with `topcli show SWEEP --row NUMBER > FILE.yaml` and name that file"
        )
    experiment = load_experiment(config, sets, any_precision=True)
    motion = motion_of(experiment.top, experiment.y0)
    if as_json:
        print_json("show", {"config": experiment.resolved(), "digest": experiment.digest, "motion": motion.as_dict()})
        return
    print_cells(QUANTITIES.cells(motion), f"{experiment.name}: {motion.title}")
    if motion.neighbours:
        emit()
        print_cells(NEIGHBOURS.cells(motion), NEIGHBOURS.title_of(motion))
    for note in motion.notes:
        emit_prose(note)
