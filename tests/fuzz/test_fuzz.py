"""Wrong configs, damaged files and killed processes: a message or the right numbers, nothing else.

`make attack` tries a hundred times as many.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import ruamel.yaml
from hypothesis import assume, given
from hypothesis import strategies as st

from conftest import GEN, examples
from faults import HOW, Disk
from injected import in_fork
from mutations import DAMAGES, RUNS, SWEEPS, Damage, damaged, mutants
from resuming import HK, NAME, content, killed, small
from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.config.sweep import load_sweep
from topcli.contracts import Stepper
from topcli.engine.loops import interpreted
from topcli.errors import TopcliError
from topcli.runs.run import RunOptions, run_experiment
from topcli.runs.simulate import trajectory_of
from topcli.store.results import read_result
from topcli.studies.analyse import analyse
from topcli.studies.health import check_all

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_chunks")]
Found = TypeVar("Found")
STEPS = 12
"""Steps of an accepted config that are compared with plain Python."""
MOST_ROWS = 1000
"""Rows of an accepted sweep file that are counted."""


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def accepted(call: Callable[[], Found]) -> Found | None:
    """Result of ``call``; None if it refuses with a message of a few lines. Any other exception passes."""
    try:
        return call()
    except TopcliError as error:
        message = str(error)
    assert 1 <= len(message.splitlines()) <= 4
    return None


# configs


def written(folder: Path, mutant: tuple[str, str]) -> tuple[Path, Path]:
    """Path of a mutated file, and path of a file to write its content again."""
    (folder / mutant[0]).write_text(mutant[1], encoding="utf-8")
    return folder / mutant[0], folder / "again.yaml"


def flat(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested data, each with its path."""
    if isinstance(data, (dict, list)):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from flat(value, f"{path}.{key}")
    else:
        yield path, data


def read_otherwise(path: Path) -> Any:
    """Data of a config by another reader; None if that one refuses."""
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text) if path.suffix == ".toml" else ruamel.yaml.YAML(typ="safe", pure=True).load(text)
    except Exception:  # it may refuse more than topcli does
        return None


def assert_same_meaning(path: Path, experiment: Experiment) -> None:
    """Numbers of the experiment are those that another reader finds in the file."""
    read = dict(flat(read_otherwise(path)))
    for key, value in flat(experiment.resolved()):
        other = read.get(key, value)
        numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in (value, other))
        if numbers and key.startswith((".h", ".N", ".top", ".output", ".initial.omega")):
            assert float(other) == float(value), key


def assert_steps_of_plain_python(experiment: Experiment) -> None:
    """The first steps have the bits of the scheme's step in plain Python."""
    if experiment.precision != "double" or experiment.scheme.adaptive:
        return
    method, top = experiment.method(), experiment.top
    if not isinstance(method, Stepper):
        return
    short = load_experiment(experiment.resolved() | {"N": STEPS, "output": {}})
    run = trajectory_of(short)
    assert tuple(run.states[0]) == short.y0
    if len(run) <= STEPS:
        return
    p, d = np.array(top.constants()), len(top.components)
    loop = interpreted(method, d, len(p))
    work, plain = np.zeros(method.width), np.empty(STEPS * d)
    with np.errstate(all="ignore"):
        loop.enter(np.array(short.y0), work, p, short.h)
        assert loop.drive(work.tolist(), plain, p.tolist(), short.h, STEPS, 1, 1) == STEPS
    assert run.states[1:].tobytes() == plain.tobytes()


@examples(60)
@given(mutant=mutants(RUNS))
def test_a_config_is_refused_or_means_what_it_says(folder: Path, mutant: tuple[str, str]) -> None:
    path, again = written(folder, mutant)
    experiment = accepted(lambda: load(path))
    if experiment is None:
        return
    assert_same_meaning(path, experiment)
    again.write_text(experiment.to_yaml(), encoding="utf-8")
    assert load(again).digest == experiment.digest
    if experiment.ensemble is None and math.isfinite(experiment.h * STEPS):
        assert_steps_of_plain_python(experiment)


@examples(60)
@given(mutant=mutants(SWEEPS))
def test_a_sweep_file_is_refused_or_has_the_rows_that_it_counts(folder: Path, mutant: tuple[str, str]) -> None:
    path, again = written(folder, mutant)
    sweep = accepted(lambda: load_sweep(path))
    if sweep is None or sweep.count_left > MOST_ROWS:
        return
    rows = accepted(lambda: [number for group in sweep.groups() for number in group.numbers.tolist()])
    if rows is not None:
        assert sorted(rows) == list(range(sweep.count_left))
        again.write_text(sweep.to_yaml(), encoding="utf-8")
        assert load_sweep(again).digest == sweep.digest


# series of other programs

ROWS = 40
SERIES = load_experiment(HK, ["h=0.01", "N=100"])
ODD = (np.nan, np.inf, 1e16, -1e16, 0.0, -0.0)
NAMES = ("", "x" * 5000, "<script>", "omega1", "t", "T", " t ", "a,b")
CELLS = ('"', "1e999", "0x10", "1_0", "nan(1)", "9" * 1000, "1;2", "\r", "NULL", "TRUE", "")
TYPES = (pa.string(), pa.bool_(), pa.float16(), pa.int64(), pa.null(), pa.timestamp("ns"), pa.list_(pa.float64()))


@st.composite
def columns(draw: st.DrawFn) -> dict[str, np.ndarray]:
    """Columns of a plausible series, perhaps with odd values, times or names."""
    t = 0.01 * np.arange(ROWS)
    found = {"t": t} | {name: np.full(ROWS, value) for name, value in zip(SERIES.top.components, GEN, strict=True)}
    name, kind = (
        draw(st.sampled_from(list(found))),
        draw(st.sampled_from(("none", "value", "order", "numbers", "name"))),
    )
    if kind == "value":
        found[name][draw(st.integers(0, ROWS - 1))] = draw(st.sampled_from(ODD))
    elif kind == "order":
        found["t"] = draw(st.sampled_from((t[::-1].copy(), t * 0.0, t + 1e16)))
    elif kind == "numbers":
        found["n"] = draw(st.sampled_from((np.arange(ROWS)[::-1].copy(), np.full(ROWS, 7), np.arange(ROWS) * 2.0**60)))
    elif kind == "name":
        found[draw(st.sampled_from(NAMES))] = found.pop(name)
    return found


class File(bytes):
    """Content of a file, too long to be printed."""

    __repr__ = object.__repr__


@st.composite
def files(draw: st.DrawFn) -> File:
    """A CSV or Parquet file of such columns, perhaps with odd cells or types, perhaps damaged."""
    found = draw(columns())
    if draw(st.booleans()):
        separator = draw(st.sampled_from((",", ";", "\t")))
        lines = [separator.join(found), *(separator.join(map(str, row)) for row in zip(*found.values(), strict=True))]
        if draw(st.booleans()):
            at = draw(st.integers(0, ROWS))
            lines[at] = lines[at].replace(lines[at].split(separator)[-1], draw(st.sampled_from(CELLS)), 1)
        data = ("\n".join(lines) + "\n").encode()
    else:
        arrays = {name: pa.array(values) for name, values in found.items()}
        if draw(st.booleans()):
            name = draw(st.sampled_from(list(arrays)))
            arrays[name] = pa.nulls(ROWS, draw(st.sampled_from(TYPES)))
        sink = pa.BufferOutputStream()
        pq.write_table(pa.table(arrays), sink, row_group_size=7)
        data = sink.getvalue().to_pybytes()
    damage = draw(st.none() | DAMAGES)
    return File(data if damage is None else damaged(data, damage))


@examples(60)
@given(data=files())
def test_a_series_is_refused_or_has_its_rows(folder: Path, data: bytes) -> None:
    path = folder / f"series.{'parquet' if data[:4] == b'PAR1' else 'csv'}"
    path.write_bytes(data)
    with np.errstate(all="ignore"):
        report = accepted(lambda: analyse(path, config=SERIES.resolved()))
    if report is not None:
        assert 2 <= len(report.columns["t"]) <= ROWS
        assert np.isfinite(report.columns["t"]).all()


# damaged and killed runs


@pytest.fixture(scope="module")
def wholes() -> Iterator[Callable[[str], Path]]:
    """Function that makes, once, the folder of a finished run of a format."""
    with tempfile.TemporaryDirectory() as name:

        def whole(suffix: str) -> Path:
            out = Path(name) / suffix
            return run_experiment(small(f"output.format={suffix}"), out).stored.folder

        yield whole


def copied(source: Path, folder: Path) -> Path:
    """Empty folder of results with a copy of ``source``."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    shutil.copytree(source, out / source.name)
    return out


@examples(60)
@given(suffix=st.sampled_from(("parquet", "csv")), file=st.integers(0, 3), damage=DAMAGES)
def test_a_damaged_run_is_never_taken_for_a_good_one(
    folder: Path, wholes: Callable[[str], Path], suffix: str, file: int, damage: Damage
) -> None:
    whole = wholes(suffix)
    out = copied(whole, folder)
    path = sorted((out / NAME).iterdir())[file]
    before = path.read_bytes()
    path.write_bytes(damaged(before, damage))
    assume(path.read_bytes() != before)
    checked = accepted(lambda: check_all(str(out / NAME), out))
    assert checked is None or checked.damage
    for options in (RunOptions(), RunOptions(force=True)):
        if accepted(lambda options=options: run_experiment(small(f"output.format={suffix}"), out, options)):
            assert content(out / NAME) == content(whole)


@examples(40)
@given(chunks=st.integers(2, 12), file=st.integers(0, 10), damage=DAMAGES)
def test_a_damaged_unfinished_run_is_not_continued_wrongly(
    folder: Path, wholes: Callable[[str], Path], chunks: int, file: int, damage: Damage
) -> None:
    out = folder / "left"
    shutil.rmtree(out, ignore_errors=True)
    names = sorted(path for path in killed(out, small(), chunks).rglob("*") if path.is_file())
    path = names[file % len(names)]
    path.write_bytes(damaged(path.read_bytes(), damage))
    if accepted(lambda: run_experiment(small(), out)):
        assert content(out / NAME) == content(wholes("parquet"))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills forks of this process")
@examples(20)
@given(lives=st.lists(st.tuples(st.integers(1, 60), st.sampled_from(HOW)), min_size=1, max_size=3))
def test_a_killed_run_ends_as_one_that_was_never_killed(
    folder: Path, wholes: Callable[[str], Path], lives: list[tuple[int, str]]
) -> None:
    out, often = folder / "killed", RunOptions(checkpoint_every=0.0)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    for at, how in lives:

        def life(at: int = at, how: str = how) -> None:
            Disk(out, at, how).install()
            run_experiment(small(), out, often)

        assert in_fork(life) in (0, -9, 99)
        if (stored := read_result(out / NAME)) and stored.outcome:
            content(out / NAME)  # a result is whole
    run_experiment(small(), out, often)
    assert content(out / NAME) == content(wholes("parquet"))
    assert not [path for path in out.glob(".*") if path.suffix != ".lock"]
