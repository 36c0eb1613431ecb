"""``python -m attack [PART...]``: attack topcli, and exit with 1 if something was found.

Without a part all of ``PARTS`` are done. ``--seed`` (``ATTACK_SEED``) repeats an earlier attack, ``--only`` single
cases of one part; ``--cases`` says how many cases each part has. ``ATTACK_LIMIT`` is after how many seconds a call
counts as hanging.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import topcli.cli.app  # noqa: F401 (imported once, here, and not in every fork)
from attack.command import fork
from attack.damage import damage_cache, damage_run, stored
from attack.fuzz import fuzz
from attack.judge import Finding
from attack.kills import kill, starts
from attack.pages import page, places
from attack.sandbox import Tried, try_all
from attack.scenes import Scenes, prepare, small_pieces, wait
from attack.series import bomb, csv, parquet, series
from attack.sweeps import damaged, edited, forged, together

Result = tuple[dict[str, int], list[Finding]]


@dataclass(frozen=True)
class Part:
    """Kinds of cases that take turns, their number, and what is made before the cases are shared out."""

    kinds: tuple[Tried, ...]
    cases: int
    needs: Callable[[Scenes], object] = lambda scenes: None


PARTS = {
    "fuzz": Part((fuzz,), 20_000),
    "damage": Part((damage_run, damage_cache, damage_run), 240, stored),
    "kills": Part((kill,), 120, starts),
    "sweeps": Part((damaged, forged, together, edited, damaged), 100),
    "series": Part(tuple(map(series, (csv, parquet, csv, parquet, bomb))), 120),
    "pages": Part((page,), 60, places),
}
NOTES = ("slow",)
"""Kinds that are printed and are no fault: some configs ask for hours of honest work, which a signal ends."""


def arguments() -> argparse.Namespace:
    """Arguments of the command line, with the seed from the environment."""
    seed = int(os.environ.get("ATTACK_SEED") or random.SystemRandom().randrange(1, 10**6))
    parser = argparse.ArgumentParser(prog="attack", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all by default")
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--cases", type=int, help="cases of each part")
    parser.add_argument("--only", type=int, nargs="+", metavar="CASE", help="only these cases of a part")
    parser.add_argument("--workers", type=int, default=min(4, os.cpu_count() or 1))
    parser.add_argument("--folder", type=Path, help="where to work and to keep what is found; a temporary folder")
    asked = parser.parse_args()
    if wrong := [part for part in asked.parts if part not in PARTS]:
        parser.error(f"no such part: {wrong[0]}; choose from {', '.join(PARTS)}")
    asked.parts = asked.parts or list(PARTS)
    if asked.only and len(asked.parts) != 1:
        parser.error("--only wants a single part, whose cases it names")
    return asked


def shared_out(work: Callable[[list[int]], Result], indices: list[int], workers: int, folder: Path) -> Result:
    """Do ``work`` in several processes, each with a share of the cases."""

    def one(number: int) -> int:
        counts, findings = work(indices[number::workers])
        found = [[finding.kind, finding.case, finding.text] for finding in findings]
        (folder / f"share-{number}.json").write_text(json.dumps([counts, found]), encoding="utf-8")
        return 0

    pids = [fork(lambda number=number: one(number)) for number in range(workers)]
    counts: Counter[str] = Counter()
    findings: list[Finding] = []
    for number, pid in enumerate(pids):
        if code := wait(pid):
            findings.append(Finding("exception", f"share {number}", f"this process of the attack exited with {code}"))
            continue
        counted, found = json.loads((folder / f"share-{number}.json").read_text(encoding="utf-8"))
        counts.update(counted)
        findings += [Finding(*one) for one in found]
    return dict(counts), sorted(findings, key=lambda finding: int(finding.case.split()[1]))


def attack(name: str, asked: argparse.Namespace, scenes: Scenes, folder: Path) -> Result:
    """One part of the attack."""
    part = PARTS[name]
    part.needs(scenes)
    indices = asked.only or list(range(asked.cases or part.cases))
    workers = min(asked.workers, len(indices))
    tried = lambda share: try_all(name, part.kinds, scenes, asked.seed, share, folder / "found")  # noqa: E731
    return shared_out(tried, indices, workers, folder)


def main() -> int:
    """Attack; the exit code."""
    asked = arguments()
    sys.dont_write_bytecode = True
    faulthandler.enable()
    folder = Path(os.path.realpath(asked.folder or tempfile.mkdtemp(prefix="topcli-attack-")))
    (folder / "runs").mkdir(parents=True)
    cache = os.environ.setdefault("NUMBA_CACHE_DIR", str(folder / "machine-code"))
    print(f"ATTACK_SEED={asked.seed}  ({', '.join(asked.parts)}; findings are kept in {folder / 'found'})", flush=True)
    small_pieces()
    scenes, found = prepare(folder / "runs"), 0
    for part in asked.parts:
        began = time.monotonic()
        counts, findings = attack(part, asked, scenes, folder)
        for finding in findings:
            print(finding)
        kinds = ", ".join(f"{count} {kind}" for kind, count in Counter(finding.kind for finding in findings).items())
        numbers = ", ".join(f"{count} {what}" for what, count in counts.items())
        print(f"{part}: {numbers} in {time.monotonic() - began:.0f} s; found: {kinds or 'nothing'}", flush=True)
        found += sum(finding.kind not in NOTES for finding in findings)
    if found:
        print(f"{found} findings in {folder / 'found'}; repeat with ATTACK_SEED={asked.seed}")
    for left in folder.iterdir():
        if left.name != "found" and str(left) != cache:
            shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink()
    if not found and asked.folder is None:
        shutil.rmtree(folder, ignore_errors=True)
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
