"""The sweeps that are attacked: their files, and what is in their folders."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from attack.command import call
from attack.judge import content, rows_apart
from sweeping import BASE
from sweeping import DATA as SMALL
from topcli.config.sweep import load_sweep
from topcli.sweeps.journal import Journal

SWEEP = SMALL["name"]
DATA: dict[str, Any] = {
    **SMALL,
    "base": {key: value for key, value in BASE.items() if key != "scheme"},
    "grid": {"scheme": ["hk", "rk4"], "h": [0.002 * k for k in range(1, 11)]},
    "include": [{"scheme": "rk2", "h": 1e150}],
    "measure": ["max_deviation.energy", "drift.k_sq"],
}
"""Twenty rows, and one that blows up."""


@dataclass(frozen=True)
class SweepContent:
    """A folder of a sweep apart from times and from the processor: its rows, its file, its outcomes, its series."""

    rows: list[dict[str, Any]]
    file: str
    outcomes: dict[str, int]
    series: dict[str, Any]

    def differs(self, found: SweepContent | str) -> str:
        """Difference of another sweep from this one; empty if there is none."""
        if isinstance(found, str):
            return found
        for name in ("file", "outcomes"):
            if getattr(self, name) != getattr(found, name):
                return f"another {name}: {getattr(found, name)}"
        if (rows := list(map(repr, found.rows))) != list(map(repr, self.rows)):
            apart = [one for one, other in zip(rows, map(repr, self.rows), strict=False) if one != other]
            return f"{len(rows)} rows, {len(apart)} differ, first {apart[:1]}"
        if self.series.keys() != found.series.keys():
            return f"series of {sorted(found.series)}"
        return next((text for name, rows in self.series.items() if (text := rows_apart(rows, found.series[name]))), "")


def sweep_content(folder: Path) -> SweepContent | str:
    """Content of a finished sweep; the reason why it cannot be read."""
    try:
        manifest = json.loads((folder / "manifest.json").read_bytes())
        rows = pq.read_table(folder / "rows.parquet").to_pylist()
        series = {path.name: content(path).rows for path in sorted((folder / "series").glob("[!.]*"))}
        for row in rows:
            del row["cpu"]
        rows.sort(key=lambda row: (not row["current"], row["row"], row["digest"]))
        return SweepContent(rows, (folder / "sweep.yaml").read_text(), manifest["outcomes"], series)
    except (OSError, ValueError, KeyError) as error:
        return f"cannot be read: {error}"


@dataclass
class SweepScene:
    """A sweep file, a folder ``before`` with what an earlier life left, the sweep at its end and its content."""

    kind: str
    config: Path
    before: Path
    whole: Path
    expected: SweepContent
    name: str = SWEEP

    def finished(self, out: Path) -> list[str]:
        """Digests of the rows in the journal."""
        with Journal(out / SWEEP) as journal:
            index = journal.index()
            return [
                str(journal.block(int(b)).digest[p])
                for b, p in zip(index.rows["block"], index.rows["place"], strict=True)
            ]


SHORTER = {**DATA, "grid": {"scheme": ["hk"], "h": [0.01, 0.02]}, "include": [{"scheme": "rk4", "h": 0.03}]}
KINDS = {
    "new-sweep": (DATA, None),
    "edited-sweep": (DATA, {**DATA, "grid": {**DATA["grid"], "h": [*DATA["grid"]["h"][2:7], 0.05]}}),
    "sweep-with-series": ({**SHORTER, "store": "series"}, None),
}
"""A new sweep, one whose file was edited after it had finished, and one that stores series."""


def sweep_scenes(base: Path, configs: Path) -> list[SweepScene]:
    """The sweeps of ``KINDS``."""
    found = []
    for kind, (data, earlier) in KINDS.items():
        config, before, whole = configs / f"{kind}.yaml", base / "before" / kind, base / f"whole-{kind}"
        before.mkdir(parents=True)
        for out, given in ((before, earlier), (whole, data)):
            if given is not None:
                config.write_text(load_sweep(given).to_yaml(), encoding="utf-8")
                if out == whole:
                    shutil.copytree(before, whole)
                said = call(["sweep", str(config), "--threads", "1", "--out", str(out)], base, [base])
                if said.code not in (0, 3):
                    raise RuntimeError(f"the attack could not be prepared: {said.err}")
        expected = sweep_content(whole / SWEEP)
        if isinstance(expected, str):
            raise RuntimeError(f"the attack could not be prepared: {expected}")
        found.append(SweepScene(kind, config, before, whole / SWEEP, expected))
    return found
