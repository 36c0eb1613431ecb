"""Decision on a run, from its identity, one look at its folder, and the options: a table of cases without a disk."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

import resuming
from topcli.errors import RunError, UsageError
from topcli.runs.decision import Decision, RunOptions, decide
from topcli.runs.identity import Identity
from topcli.runs.run import run_experiment
from topcli.store.folder import Folder, Resumable
from topcli.store.manifest import REPORT, StoredRun
from topcli.store.parts import Part

OUT, NAME = Path("out"), "wobble"
CASES: dict[str, dict[str, Any]] = YAML(typ="safe").load(Path(__file__).with_name("decisions.yaml"))


def config(suffix: str = "parquet", **changes: Any) -> dict[str, Any]:
    output = {"every": 1, "format": suffix}
    return {"name": NAME, "scheme": {"name": "hk"}, "h": 0.1, "N": 100, "output": output, **changes}


def manifest(digest: str = "a", suffix: str = "parquet", **changes: Any) -> dict[str, Any]:
    known = {"name": NAME, "digest": 64 * digest, "code": "code", "outcome": "completed", "files": {REPORT: {}}}
    return {**known, "series": f"series.{suffix}", **changes, "config": config(**changes.get("config", {}))}


def stored(folder: str = NAME, **changes: Any) -> StoredRun:
    return StoredRun(OUT / folder, manifest(**changes))


def part(alive: bool = False, digest: str = "a") -> Part:
    return Part(OUT / f".{NAME}.part-7-00000000", {"pid": 7, "digest": 64 * digest}, alive)


def source(one: Mapping[str, Any]) -> Resumable:
    """What a killed process has left, an interrupted run, or one that was set aside."""
    changes = dict(one)
    done, checkpoint = changes.pop("done"), None if changes.pop("complete", False) else object()
    where: Any = stored() if changes.pop("stopped", False) else part()
    where = stored(f"{NAME}.aaaaaaaa") if changes.pop("set aside", False) else where
    return Resumable(where, done, checkpoint, manifest(**changes))  # type: ignore[arg-type]


def looked_at(there: Mapping[str, Any]) -> Folder:
    found = dict(there)
    if "run" in found:
        found["run"] = stored(**found["run"])
    if "damaged_checkpoint" in found:
        found["damaged_checkpoint"] = Path(found["damaged_checkpoint"])
    if "fault" in found:
        found["fault"] = tuple(found["fault"])
    for key, make in (("parts", lambda one: part(**one)), ("sources", source)):
        found[key] = tuple(map(make, found.get(key, ())))
    return Folder(OUT, NAME, **found)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_decision(case: dict[str, Any]) -> None:
    folder, options = looked_at(case.get("there", {})), RunOptions(**dict.fromkeys(case.get("options", ()), True))
    mine = Identity(config(case.get("format", "parquet")), 64 * "a", "code")
    for verb in {"run", "leave"} & case.keys():
        start = next((left for left in folder.sources if left.done == case.get("step")), None)
        notes = tuple(case.get("notes", ()))
        assert decide(mine, folder, options) == Decision(verb, case[verb], start, notes)  # type: ignore[arg-type]
        return
    with pytest.raises((UsageError, RunError)) as caught:
        decide(mine, folder, options)
    assert case["refused"] in str(caught.value)
    assert isinstance(caught.value, RunError) == ("damaged (" in case["refused"])


def test_a_look_changes_nothing(tmp_path: Path) -> None:
    """Not even in the remains of a killed process, which the next run removes."""
    remains = tmp_path / f".{NAME}.part-999999999-00000000"
    remains.mkdir()
    (remains / "series.parquet").write_bytes(b"half a row group")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    assert Folder.look(tmp_path, NAME).parts == ()
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_a_look_finds_the_unfinished_runs_of_its_name_alone(tmp_path: Path, small_chunks: None) -> None:
    """``wobble.2`` is the name of another run as well as of one that was set aside."""
    longer = f"{resuming.NAME}.2"
    stop = RunOptions(stop=resuming.after(5))
    run_experiment(resuming.small(f"name={longer}"), tmp_path, stop)
    assert Folder.look(tmp_path, resuming.NAME).sources == ()
    (source,) = Folder.look(tmp_path, longer).sources
    assert source.where.folder == tmp_path / longer
    assert source.done > 0
