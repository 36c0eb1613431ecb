"""Cases of the attack, each in a copy of what is attacked, with files of others beside it."""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from attack.command import Said, call
from attack.judge import Faults, Finding, judged
from attack.mutations import draw_for
from attack.spoil import FOREIGN


@dataclass
class Case:
    """A damage: of which file of which scene, in which way; ``said`` are the calls that met it."""

    label: str
    path: str = ""
    how: str = ""
    said: list[Said] = field(default_factory=list)
    faults: Faults = field(default_factory=list)
    spoilt: bytes = b""


def hashes(folder: Path) -> dict[str, str]:
    """The content of every regular file under ``folder`` by name."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


class Sandbox:
    """A copy of what is attacked in ``folder``, with files of others beside it that must stay as they are."""

    def __init__(self, folder: Path, case: Case) -> None:
        self.folder, self.case = folder, case
        shutil.rmtree(folder, ignore_errors=True)
        (folder / "elsewhere").mkdir(parents=True)
        (folder / "elsewhere" / "precious.txt").write_text(FOREIGN)
        self.out, self.cache = folder / "out", Path(os.environ["NUMBA_CACHE_DIR"])

    def call(self, *argv: str, prepare: Callable[[], object] = lambda: None) -> Said:
        """Call the command, and judge what it says and which files it touches; ``prepare`` may put faults into it."""
        elsewhere = hashes(self.folder / "elsewhere")
        writable = [self.out, self.cache, Path(os.environ["MPLCONFIGDIR"])]
        said = call(argv, self.folder, writable, {"NUMBA_CACHE_DIR": str(self.cache)}, prepare=prepare)
        self.case.said.append(said)
        if said.code != -signal.SIGKILL:
            self.case.faults += judged(said)
        if hashes(self.folder / "elsewhere") != elsewhere:
            self.fault("touched", f"topcli {' '.join(argv)}: changed files elsewhere")
        return said

    @property
    def planted(self) -> int:
        """Number of files of others among the results."""
        digest = hashlib.sha256(FOREIGN.encode()).hexdigest()
        return sum(found == digest for found in hashes(self.out).values())

    def foreign_kept(self, planted: int) -> None:
        """Files of others are moved at most."""
        if self.planted < planted:
            self.fault("lost", "a file of somebody else was deleted")

    def fault(self, kind: str, text: str) -> None:
        """Note that something is wrong."""
        self.case.faults.append((kind, f"{self.case.label}, {self.case.how}: {text}"))


Tried = Callable[[Any, random.Random, Sandbox], None]
"""``tried(scenes, draw, box)`` tries one case and notes what is wrong in the box."""


def try_all(
    part: str, kinds: Sequence[Tried], scenes: Any, seed: int, indices: list[int], kept: Path
) -> tuple[dict[str, int], list[Finding]]:
    """Try the cases ``indices`` of a part, of its ``kinds`` in turn, each in a sandbox of its own; what was found."""
    counts: Counter[str] = Counter()
    findings: list[Finding] = []
    for index in indices:
        case = Case("")
        box = Sandbox(scenes.base / f"sandbox-{os.getpid()}", case)
        try:
            kinds[index % len(kinds)](scenes, draw_for(seed, part, index), box)
        except Exception as error:  # of this harness: the other cases are tried all the same
            where = traceback.extract_tb(error.__traceback__)[-1]
            box.fault("exception", f"{type(error).__name__} {error} at {Path(where.filename).name}:{where.lineno}")
        counts["cases"] += 1
        counts["calls"] += len(case.said)
        counts["good ends"] += sum(said.code == 0 for said in case.said)
        here = str(box.folder) + os.sep
        found = [Finding(kind, f"{part} {index}", text.replace(here, "")) for kind, text in dict.fromkeys(case.faults)]
        if found:
            keep(case, found, box.folder, kept / f"{part}-{index}")
        findings += found
    return dict(counts), findings


def keep(case: Case, findings: list[Finding], sandbox: Path, folder: Path) -> None:
    """Keep what a damage left, the damaged file as it was before the commands, and what they said."""
    folder.mkdir(parents=True)
    about = {
        "case": f"{case.label}: {case.how}",
        "file": case.path,
        "findings": [asdict(finding) for finding in findings],
        "calls": [asdict(said) for said in case.said],
    }
    (folder / "case.json").write_text(json.dumps(about, indent=1)[:1_000_000], encoding="utf-8")
    if case.spoilt:
        (folder / "damaged-file").write_bytes(case.spoilt)
    sandbox.rename(folder / "left")
