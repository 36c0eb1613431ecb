"""Wrong configs, sweep files and series of other programs: a message or the right numbers, nothing else.

`make attack` tries a hundred times as many.
"""

from __future__ import annotations

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
from hypothesis import given
from hypothesis import strategies as st

from conftest import GEN, examples
from mutations import DAMAGES, PIECES, RUNS, SWEEPS, damaged, mutants
from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.config.sweep import load_sweep
from topcli.errors import TopcliError
from topcli.studies.analyse import analyse

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_chunks")]
Found = TypeVar("Found")
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


KEYS = "h N T name top top.c0 initial.omega scheme scheme.branch output.quantities.q section ensemble.grid"


@examples(150)
@given(text=st.text(max_size=40) | st.tuples(st.sampled_from(KEYS.split()), st.just("="), PIECES).map("".join))
def test_any_override_loads_or_is_refused(text: str) -> None:
    accepted(lambda: load("kowalevski_hybrid", [text]))


@examples(60)
@given(mutant=mutants(SWEEPS))
def test_a_sweep_file_is_refused_or_has_the_rows_that_it_counts(folder: Path, mutant: tuple[str, str]) -> None:
    path, again = written(folder, mutant)
    sweep = accepted(lambda: load_sweep(path))
    if sweep is None or sweep.count > MOST_ROWS:
        return
    rows = accepted(lambda: [number for group in sweep.groups() for number in group.numbers.tolist()])
    if rows is not None:
        assert sorted(rows) == list(range(sweep.count))
        again.write_text(sweep.to_yaml(), encoding="utf-8")
        assert load_sweep(again).digest == sweep.digest


# series of other programs

ROWS = 40
SERIES = load_experiment("kowalevski_hk", ["h=0.01", "N=100"])
CELLS = ('"', "1e999", "0x10", "1_0", "nan(1)", "9" * 1000, "1;2", "\r", "NULL", "TRUE", "", "inf", "-1e16", "<script>")


class File(bytes):
    """Content of a file, too long to be printed."""

    __repr__ = object.__repr__


@st.composite
def files(draw: st.DrawFn) -> File:
    """A CSV or Parquet file with the columns of a series, perhaps with an odd time, cell or name, perhaps damaged."""
    t = 0.01 * np.arange(ROWS)
    times = draw(st.sampled_from((t, t, t[::-1].copy(), t * 0.0, t + 1e16, np.where(t > 0.2, np.nan, t))))
    columns = {"t": times} | dict(zip(SERIES.top.components, (np.full(ROWS, x) for x in GEN), strict=True))
    if draw(st.booleans()):
        sink = pa.BufferOutputStream()
        pq.write_table(pa.table(columns), sink, row_group_size=7)
        content = sink.getvalue().to_pybytes()
    else:
        separator = draw(st.sampled_from((",", ";", "\t")))
        lines = [separator.join(columns)]
        lines += [separator.join(map(str, row)) for row in zip(*columns.values(), strict=True)]
        at = draw(st.integers(0, ROWS))
        lines[at] = lines[at].replace(lines[at].split(separator)[-1], draw(st.sampled_from(CELLS)), 1)
        content = ("\n".join(lines) + "\n").encode()
    damage = draw(st.none() | DAMAGES)
    return File(content if damage is None else damaged(content, damage))


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
