"""``python -m attack [PART...]``: attack topcli, and exit with 1 if something was found.

Without a part all of ``PARTS`` are done. ``--seed`` (``ATTACK_SEED``) repeats an earlier attack, ``--only`` single
cases of one part. ``--configs``, ``--damages`` and so on (``ATTACK_CONFIGS``, ``ATTACK_DAMAGES``, ...) say how many
cases a part has, ``ATTACK_LIMIT`` after how many seconds a call counts as hanging.
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
from pathlib import Path

import topcli.cli.app  # noqa: F401 (imported once, here, and not in every fork)
from attack.command import fork
from attack.damage import damage
from attack.fuzz import fuzz
from attack.judge import Finding
from attack.kills import kills
from attack.odd import odd
from attack.pages import pages
from attack.scenes import COMPILED, Scenes, prepare, small_pieces, wait
from attack.series import series
from attack.sweeps import axes, sweeps
from attack.verified import flips

Result = tuple[dict[str, int], list[Finding]]
Work = Callable[[Scenes, int, list[int], Path], Result]
PARTS: dict[str, tuple[Work, str, int, str]] = {
    "damage": (damage, "damages", 200, "damaged files of runs and of the machine-code cache"),
    "kills": (kills, "kills", 120, "kills, power cuts and full disks at the n-th operation on the disk"),
    "sweeps": (sweeps, "sweeps", 100, "damaged, edited and shared folders of sweeps"),
    "axes": (axes, "axes", 300, "sweep files with hostile values"),
    "flips": (flips, "flips", 200, "flipped bits and cut files that verify must find"),
    "series": (series, "series", 120, "files of other programs for analyse"),
    "pages": (pages, "pages", 60, "results with markup in them, for report"),
    "odd": (odd, "odds", 80, "stored set-ups, animations, rational numbers"),
}
"""Attacks, each with its function, the option that says how many cases it has, and their number."""
ALL = ("fuzz", *PARTS)
NOTES = ("slow",)
"""Kinds that are printed and are no fault: some configs ask for hours of honest work, which a signal ends."""


def _number(name: str, default: int) -> int:
    return int(os.environ.get(name) or default)


def arguments() -> argparse.Namespace:
    """Arguments of the command line, with defaults from the environment."""
    parser = argparse.ArgumentParser(prog="attack", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(ALL)}; all by default")
    parser.add_argument("--seed", type=int, default=_number("ATTACK_SEED", random.SystemRandom().randrange(1, 10**6)))
    for option, count, text in (("configs", 20_000, "mutated configs"), *(one[1:] for one in PARTS.values())):
        parser.add_argument(f"--{option}", type=int, default=_number(f"ATTACK_{option.upper()}", count), help=text)
    parser.add_argument("--only", type=int, nargs="+", metavar="CASE", help="only these cases of a part")
    parser.add_argument("--workers", type=int, default=_number("ATTACK_WORKERS", min(4, os.cpu_count() or 1)))
    parser.add_argument("--folder", type=Path, help="where to work and to keep what is found; a temporary folder")
    asked = parser.parse_args()
    if wrong := [part for part in asked.parts if part not in ALL]:
        parser.error(f"no such part: {wrong[0]}; choose from {', '.join(ALL)}")
    asked.parts = asked.parts or list(ALL)
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


def attack(part: str, asked: argparse.Namespace, scenes: Callable[[], Scenes], folder: Path) -> Result:
    """One part of the attack."""
    kept = folder / "found"
    if part == "fuzz":
        return fuzz(asked.seed, asked.only or list(range(asked.configs)), folder / "fuzz", kept, asked.workers)
    here = scenes()
    work, option, *_ = PARTS[part]
    cases = asked.only or list(range(getattr(asked, option)))
    if part == "damage" and not asked.only:
        for scheme in COMPILED:  # made here, before the work is shared out
            here.code(scheme)
    workers = 1 if asked.only else asked.workers
    return shared_out(lambda share: work(here, asked.seed, share, kept), cases, workers, folder)


def main() -> int:
    """Attack; the exit code."""
    asked = arguments()
    sys.dont_write_bytecode = True
    faulthandler.enable()
    folder = Path(os.path.realpath(asked.folder or tempfile.mkdtemp(prefix="topcli-attack-")))
    folder.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("NUMBA_CACHE_DIR", str(folder / "machine-code"))
    cache = os.environ["NUMBA_CACHE_DIR"]
    print(f"ATTACK_SEED={asked.seed}  ({', '.join(asked.parts)}; findings are kept in {folder / 'found'})", flush=True)
    made: list[Scenes] = []

    def scenes() -> Scenes:
        if not made:
            small_pieces()
            (folder / "runs").mkdir()
            made.append(prepare(folder / "runs"))
        return made[0]

    found = 0
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
