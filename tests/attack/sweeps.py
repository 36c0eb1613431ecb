"""Sweeps under attack: damaged and forged files, two processes in one folder, an edited file."""

from __future__ import annotations

import json
import os
import random
import shutil
import tempfile
import zlib
from pathlib import Path
from typing import Any

from attack.command import call
from attack.faults import HOW, Disk
from attack.sandbox import Sandbox
from attack.scenes import Scenes
from attack.spoil import DAMAGES, hostile_json, hostile_value
from attack.studies import DATA, SWEEP, SweepContent, SweepScene, sweep_content
from topcli.config.sweep import load_sweep


def sweep(box: Sandbox, config: Path | str, *more: str, **options: Any) -> int | None:
    """Call ``topcli sweep`` in the sandbox; its exit code."""
    return box.call("sweep", str(config), "--out", "out", "--threads", "1", *more, **options).code


def compare(box: Sandbox, expected: SweepContent, what: str) -> None:
    """Compare the sweep in the sandbox with one that was never harmed."""
    if wrong := expected.differs(sweep_content(box.out / SWEEP)):
        box.fault("wrong rows", f"{what}, and then: {wrong}")


def damaged(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Damage a file of a finished sweep; read it, and call the sweep again."""
    scene = draw.choice((scenes.sweeps[0], scenes.sweeps[2]))
    shutil.copytree(scene.whole.parent, box.out)
    names = ("journal.jsonl", "journal.jsonl", "rows.parquet", "rows.parquet", "manifest.json", "sweep.yaml", "lock")
    path = box.out / SWEEP / draw.choice(names)
    damage = hostile_json if path.suffix == ".json" and draw.random() < 0.6 else draw.choice(DAMAGES)
    box.case.label, box.case.how = f"{scene.kind} {path.name}", damage.__name__.strip("_")
    before = path.read_bytes()
    damage(draw, path)
    same = path.is_file() and not path.is_symlink() and path.read_bytes() == before
    planted = box.planted
    read(scene, box, intact=same)
    if path.name != "lock" and not same:
        said = box.call("verify", f"out/{SWEEP}")
        if not path.exists() and path.name == "manifest.json":
            named = "unfinished" in said.out  # as a sweep is whose process ended before it wrote the manifest
        else:
            named = said.code not in (0, 1) or (said.code == 1 and path.name in said.out + said.err)
        if not named:
            box.fault(
                "taken for good", f"verify exits with {said.code} and does not name {path.name}: {said.err[:200]}"
            )
    for more in ([], ["--json"]):
        code = sweep(box, scene.config, *more)
        if code in (0, 3):
            compare(box, scene.expected, f"sweep exits with {code}")
        elif code not in (1, 2):
            return
    box.foreign_kept(planted)


def read(scene: SweepScene, box: Sandbox, intact: bool) -> None:
    """A table and a page are made of the right rows or refused."""
    words = ["--rows", "scheme", "--columns", "h", "--value", "max_deviation.energy", "--json"]
    said = box.call("table", f"out/{SWEEP}", *words)
    if said.code == 0:
        whole = call(["table", str(scene.whole), *words], box.folder, [])
        found, wanted = (json.loads(one.out) for one in (said, whole))
        if any(found.get(key) != wanted[key] for key in wanted if key not in ("folder", "path", "file")):
            box.fault("wrong rows", "table exits with 0 and shows other numbers")
    elif intact:
        box.fault("lost", f"table of an intact sweep exits with {said.code}")
    box.call("report", f"out/{SWEEP}", "--out", "out/page.html", "--force")
    box.call("show", f"out/{SWEEP}", "--row", "3")


def forged(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Give the journal a line whose checksum is right and whose content no sweep has written."""
    scene = scenes.sweeps[0]
    shutil.copytree(scene.whole.parent, box.out)
    path = box.out / SWEEP / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    at = draw.randrange(len(lines))
    text = json.dumps(hostile_value(draw, json.loads(lines[at][9:]))).encode()
    if draw.random() < 0.1:
        text = draw.choice((b"[", b'{"a":')) * 100_000
    lines[at] = b"%08x %s\n" % (zlib.crc32(text), text)
    path.write_bytes(b"".join(lines))
    box.case.label, box.case.how = "forged journal", f"line {at}"
    code = sweep(box, scene.config)
    if code not in (0, 1, 2, 3):
        box.fault("exit code", f"sweep exits with {code}")


def together(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Start a second process while the first is at its n-th operation."""
    scene = draw.choice(scenes.sweeps[:2])
    shutil.copytree(scene.before, box.out)
    argv = ["sweep", str(scene.config), "--out", "out", "--threads", "1", "--json"]
    with tempfile.TemporaryFile() as answer:

        def meanwhile() -> None:
            tempfile.tempdir = str(box.out)  # where the first process may write
            said = call(argv, box.folder, [box.out])
            os.write(answer.fileno(), json.dumps([said.code, said.err[-300:]]).encode())

        disk = Disk(box.out, draw.randint(1, 60), "meanwhile", meanwhile)
        box.case.label, box.case.how = f"{scene.kind}, two processes", f"at {disk.at}"
        code = sweep(box, scene.config, "--json", prepare=disk.install)
        answer.seek(0)
        text = answer.read()
    codes = [code] if not text else [code, json.loads(text)[0]]
    if not any(one in (0, 3) for one in codes) or any(one not in (0, 2, 3) for one in codes):
        box.fault("exit code", f"two sweeps at once exit with {codes}: {text[:300]!r}")
        return
    compare(box, scene.expected, "two sweeps at once")
    digests = scene.finished(box.out)
    if len(digests) != len(set(digests)):
        box.fault("wrong rows", "a row ran twice")


H = DATA["grid"]["h"]
EDITS: tuple[dict[str, Any], ...] = (
    {"grid": {**DATA["grid"], "h": [*H[1:8:2], 0.03]}},
    {"measure": ["drift.k_sq"]},
    {"measure": ["max_deviation.energy", "max_deviation.k_sq", "swings"]},
    {"base": {**DATA["base"], "N": 61}},
    {"grid": {"h": H[:3], "scheme": ["rk4", "rk2", "hk"]}},
    {"include": None, "exclude": [{"scheme": "hk", "h": 0.002}]},
    {"grid": {**DATA["grid"], "scheme": [{"name": "hk", "compensated": True}, "hk"]}},
)


def edited(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Disturb a sweep, edit its file, and run it; it must hold what the edited file gives in an empty folder."""
    edit = draw.randrange(len(EDITS))
    data = {key: value for key, value in {**DATA, **EDITS[edit]}.items() if value is not None}
    config = box.folder / "edited.yaml"
    config.write_text(load_sweep(data).to_yaml(), encoding="utf-8")
    shutil.copytree(scenes.sweeps[0].before, box.out)
    disk = Disk(box.out, draw.randint(1, 70), draw.choice(HOW))
    box.case.label, box.case.how = f"edited file ({edit})", f"{disk.how} at {disk.at}"
    sweep(box, scenes.sweeps[0].config, prepare=disk.install)
    sweep(box, config)
    box.call("sweep", str(config), "--out", "out/fresh", "--threads", "1")
    found, wanted = sweep_content(box.out / SWEEP), sweep_content(box.out / "fresh" / SWEEP)
    if isinstance(found, str) or isinstance(wanted, str):
        box.fault("wrong rows", f"{found if isinstance(found, str) else wanted}")
        return
    current = [row for row in found.rows if row["current"]]
    left = SweepContent(current, found.file, found.outcomes, found.series)
    if wrong := wanted.differs(left):
        box.fault("wrong rows", f"after the edit: {wrong}")
