"""Files of other programs for ``topcli analyse``: wrong, hostile and far too large ones, under a limit of memory."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import lzma
import random
import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from attack.mutations import flip
from attack.sandbox import Sandbox, Tried
from attack.scenes import Scenes

MEMORY = 3 << 29
"""Bytes that a call may take beyond what this process has; what is read may take a small part of it."""
ROWS = 40
COMPONENTS = ("omega1", "omega2", "omega3", "gamma1", "gamma2", "gamma3")

Columns = dict[str, Any]


def motion(rows: int = ROWS) -> Columns:
    """Columns of a plausible series."""
    t = 0.01 * np.arange(rows)
    states = np.outer(np.ones(rows), (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)) + 1e-3 * np.sin(t)[:, None]
    states[0, 3:] /= np.linalg.norm(states[0, 3:])
    return {"t": t, **dict(zip(COMPONENTS, states.T.copy(), strict=True))}


def csv_text(columns: Columns, separator: str = ",") -> str:
    """Columns as CSV."""
    lines = [separator.join(columns)]
    lines += [separator.join(str(value) for value in row) for row in zip(*columns.values(), strict=False)]
    return "\n".join(lines) + "\n"


def _odd_values(draw: random.Random, columns: Columns) -> None:
    for _ in range(draw.choice((1, 1, 3))):
        values = columns[draw.choice(list(columns))]
        at = draw.randrange(len(values))
        values[at] = draw.choice((np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 0.0, -0.0, 1e16, values[at - 1]))


def _unsorted(draw: random.Random, columns: Columns) -> None:
    kind = draw.randrange(4)
    t = columns["t"]
    if kind == 0:
        draw.shuffle(t)
    elif kind == 1:
        t[draw.randrange(1, len(t))] = t[0]
    elif kind == 2:
        columns["t"] = t[::-1].copy()
    else:
        columns["t"] = t * draw.choice((0.0, 1e-320, 1e300, 1e308, 1e16)) + draw.choice((0.0, 1e16, -1e308))


def _numbers(draw: random.Random, columns: Columns) -> None:
    columns["n"] = draw.choice((np.arange(ROWS), np.arange(ROWS)[::-1], np.full(ROWS, 7), np.arange(ROWS) * 2.0**60))


def _names(draw: random.Random, columns: Columns) -> None:
    name = draw.choice(list(columns))
    odd = draw.choice(("", "x" * 5000, "\x1b[31m", "\u202e", "<script>", "omega1", "t", "T", " t ", "\0", "a,b"))
    values = columns.pop(name)
    columns[odd] = values


ODD: tuple[Callable[[random.Random, Columns], None], ...] = (
    _odd_values,
    _unsorted,
    _numbers,
    _names,
    lambda d, c: None,
)


def csv(draw: random.Random, box: Sandbox) -> Path:
    """CSV with odd values, odd cells, and a name that promises something else."""
    columns = motion()
    draw.choice(ODD)(draw, columns)
    text = csv_text(columns, draw.choice((",", ";", "\t", ",")))
    kind = draw.randrange(6)
    if kind == 0:
        lines = text.splitlines()
        lines.insert(draw.randrange(len(lines)), draw.choice(("", "a,b", "1,2", '"', "," * 30_000, "1" * 3_000_000)))
        text = "\n".join(lines)
    elif kind == 1:
        cell = draw.choice(('"', "1e999", "0x10", "1_0", "１", "nan(1)", "9" * 100_000, "1;2", "\r", "NULL", "TRUE"))
        text = text.replace("0.48", cell, draw.choice((1, -1)))
    elif kind == 2:
        lines = text.splitlines()
        text = "\n".join([f"{lines[0]},{lines[0]}", *(f"{line},{line}" for line in lines[1:])])
    data = text.encode("utf-8", "replace")
    if kind == 3:
        data = flip(draw, data)
    elif kind == 4:
        data = draw.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\x1f\x8b", b"# ", b"PAR1", b"\n")) + data
    return _written(
        box, draw.choice(("a.csv", "a.csv.gz", "a.csv.bz2", "a.csv.zst", "a.lz4", "a.parquet", "<b>.csv")), data
    )


def _written(box: Sandbox, name: str, data: bytes) -> Path:
    path = box.folder / name
    path.write_bytes(data)
    return path


TYPES = (
    *(pa.string(), pa.bool_(), pa.float16(), pa.int64(), pa.null(), pa.timestamp("ns"), pa.list_(pa.float64())),
    *(pa.struct([("a", pa.float64())]), pa.dictionary(pa.int32(), pa.string()), pa.float64()),
)


def parquet(draw: random.Random, box: Sandbox) -> Path:
    """Parquet of other types, with repeated names, or damaged."""
    columns = motion()
    draw.choice(ODD)(draw, columns)
    arrays = {name: pa.array(np.asarray(values)) for name, values in columns.items()}
    name = draw.choice(list(arrays))
    if draw.random() < 0.6:
        kind, values = draw.choice(TYPES), arrays[name]
        try:
            arrays[name] = values.cast(kind, safe=False)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            arrays[name] = pa.nulls(len(values), kind)
        if draw.random() < 0.2:
            arrays[name] = pa.array([None, *arrays[name].to_pylist()[1:]], kind)
    names = list(arrays)
    if draw.random() < 0.15:
        names[draw.randrange(len(names))] = draw.choice(names)
    sink = io.BytesIO()
    pq.write_table(pa.Table.from_arrays(list(arrays.values()), names), sink, row_group_size=draw.choice((7, 1000)))
    data = sink.getvalue()
    if draw.random() < 0.4:
        data = flip(draw, data) if draw.random() < 0.6 else data[: draw.randrange(len(data))]
    return _written(box, draw.choice(("a.parquet", "a.csv")), data)


def bomb(draw: random.Random, box: Sandbox) -> Path:
    """A small file of which a program that trusts it makes gigabytes."""
    kind = draw.randrange(6)
    if kind < 2:  # compressed text
        text = (csv_text(motion()) + "0,0,0,0,0,0,0\n" * 1000).encode()
        pack = draw.choice((gzip.compress, bz2.compress, lzma.compress))
        packed = pack(text * 20)
        ending = {gzip.compress: "gz", bz2.compress: "bz2", lzma.compress: "xz"}[pack]
        return _written(box, f"a.csv.{ending}", packed * 200)
    if kind == 2:  # a sparse file
        path = _written(box, "a.csv", csv_text(motion()).encode())
        with path.open("r+b") as file:
            file.truncate(20 << 30)
        return path
    if kind == 3:  # one line without end
        return _written(box, "a.csv", csv_text(motion()).encode() + b"1" * (60 << 20))
    path = box.folder / "a.parquet"
    if kind == 4:  # many equal rows
        piece = pa.table({name: np.full(1 << 20, values[0]) for name, values in motion().items()})
        with pq.ParquetWriter(path, piece.schema, compression="zstd") as writer:
            for _ in range(200):
                writer.write_table(piece)
        return path
    columns: dict[str, Any] = dict(motion(2))  # two rows, of which one column holds gigabytes
    long = pa.ListArray.from_arrays(pa.array([0, 1 << 27, 1 << 27], pa.int32()), pa.array(np.zeros(1 << 27)))
    columns["omega1"] = draw.choice((long, pa.array(["x" * (1 << 28), "y"])))
    pq.write_table(pa.table(columns), path, compression="zstd")
    return path


def _limited() -> None:
    """Limit the memory of this process to what it has and ``MEMORY``."""
    with open("/proc/self/statm", encoding="ascii") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))


def series(make: Callable[[random.Random, Sandbox], Path]) -> Tried:
    """An attack by files that ``make`` writes."""

    def tried(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
        box.out.mkdir()
        path = make(draw, box)
        box.case.label, box.case.how = make.__name__, path.name
        more = ["--json"] if draw.random() < 0.5 else ["--plot", "--out", "out"] if draw.random() < 0.2 else []
        said = box.call("analyse", path.name, "--config", str(scenes.config), *more, prepare=_limited)
        if said.code not in (0, 2):
            box.fault("exit code", f"exits with {said.code}: {said.err[-300:]}")
        elif said.code == 0 and "--json" in more and json.loads(said.out)["rows"] > ROWS:
            box.fault("wrong rows", f"{json.loads(said.out)['rows']} rows of at most {ROWS}")

    return tried
