"""Flipped bits and cut files of everything that ``topcli verify`` reads: every one must be found.

Not covered are ``lock``, which holds no result, and tables, pages, pictures and films, which are made from results.
"""

from __future__ import annotations

import os
import random
import shutil
from pathlib import Path

from attack.command import call
from attack.damage import Sandbox, try_all
from attack.judge import Finding
from attack.scenes import Scenes
from attack.studies import SWEEP

COVERED_NOT = ("lock",)


def comparison(scenes: Scenes) -> Path:
    """A stored comparison, made when it is first asked for."""
    path = scenes.base / "comparison.json"
    if not path.exists():
        argv = ["compare", "hk", "rk4", "--set", "N=60", "--set", "h=0.01", "--save", str(path)]
        said = call(argv, scenes.base, [scenes.base, Path(os.environ["NUMBA_CACHE_DIR"])], limit=300.0)
        if said.code != 0:
            raise RuntimeError(f"the attack could not be prepared: {said.err}")
    return path


def targets(scenes: Scenes) -> list[tuple[str, Path]]:
    """Target of the attack: its kind, and the folder or file."""
    runs = [(one.before.name, one.folder(one.before)) for one in scenes.runs if one.kind in ("finished", "interrupted")]
    sweeps = [(one.kind, scenes.base / f"whole-{one.config.stem}" / SWEEP) for one in scenes.sweeps]
    return [*runs, *sweeps, *sweeps, ("comparison", comparison(scenes))]


def flips(scenes: Scenes, seed: int, indices: list[int], kept: Path) -> tuple[dict[str, int], list[Finding]]:
    """Try the cases ``indices``; counts, and what was found."""
    places = targets(scenes)

    def one(index: int, draw: random.Random, box: Sandbox) -> None:
        kind, place = places[index % len(places)]
        target = box.out / place.name
        if place.is_dir():
            shutil.copytree(place, target)
            files = [path for path in sorted(target.rglob("*")) if path.is_file() and path.name not in COVERED_NOT]
            path = draw.choice(files)
        else:
            box.out.mkdir()
            path = Path(shutil.copy(place, target))
        data = bytearray(path.read_bytes())
        box.case.label = f"{kind} {path.relative_to(box.out)}"
        if box.call("verify", f"out/{place.name}").code != 0:
            box.fault("lost", "verify refuses what is whole")
        if draw.random() < 0.7 and data:
            at, bit = draw.randrange(len(data)), draw.randrange(8)
            box.case.how = f"bit {bit} of byte {at} of {len(data)} flipped"
            data[at] ^= 1 << bit
        else:
            cut = draw.choice((0, len(data) - 1, draw.randrange(max(1, len(data)))))
            box.case.how = f"cut to {cut} of {len(data)} bytes"
            del data[cut:]
        path.write_bytes(data)
        said = box.call("verify", f"out/{place.name}")
        if said.code != 1:
            box.fault("taken for good", f"verify exits with {said.code}: {(said.out + said.err)[:200]}")
        elif path.name not in said.err:
            box.fault("taken for good", f"verify does not name {path.name}: {said.err[:200]}")

    return try_all("flips", one, scenes.base, seed, indices, kept)
