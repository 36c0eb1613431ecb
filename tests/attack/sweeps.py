"""Sweeps under attack: damaged and forged files, two processes in one folder, an edited file, hostile values."""

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
from attack.damage import Sandbox, foreign_kept, try_all
from attack.faults import HOW, Disk
from attack.judge import Finding
from attack.scenes import Scenes
from attack.spoil import DAMAGES, FOREIGN, HOSTILE, hostile_json
from attack.studies import DATA, SWEEP, SweepContent, SweepScene, sweep_content
from topcli.config.sweep import load_sweep

MOST_RUN = 60
"""Rows of an accepted file that is also run."""


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
    shutil.copytree(scenes.base / f"whole-{scene.config.stem}", box.out)
    names = ("journal.jsonl", "journal.jsonl", "rows.parquet", "rows.parquet", "manifest.json", "sweep.yaml", "lock")
    path = box.out / SWEEP / draw.choice(names)
    damage = hostile_json if path.suffix == ".json" and draw.random() < 0.6 else draw.choice(DAMAGES)
    box.case.label, box.case.how = f"{scene.kind} {path.name}", damage.__name__.strip("_")
    before = path.read_bytes()
    damage(draw, path)
    same = path.is_file() and not path.is_symlink() and path.read_bytes() == before
    planted = sum(one.is_file() and one.read_bytes() == FOREIGN.encode() for one in box.out.rglob("*"))
    read(scenes, scene, box, intact=same)
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
    foreign_kept(box, planted)


def read(scenes: Scenes, scene: SweepScene, box: Sandbox, intact: bool) -> None:
    """A table and a page are made of the right rows or refused."""
    words = ["--rows", "scheme", "--columns", "h", "--value", "deviation.energy", "--json"]
    said = box.call("table", f"out/{SWEEP}", *words)
    if said.code == 0:
        whole = call(["table", str(scenes.base / f"whole-{scene.config.stem}" / SWEEP), *words], box.folder, [])
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
    shutil.copytree(scenes.base / f"whole-{scene.config.stem}", box.out)
    path = box.out / SWEEP / "journal.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    at = draw.randrange(len(lines))
    block = json.loads(lines[at][9:])
    key, value = draw.choice(sorted(block)), draw.choice(HOSTILE)
    kind = draw.randrange(4)
    if kind == 0:
        block[key] = value
    elif kind == 1 and isinstance(block[key], list):
        block[key] = [value, *block[key][1:]]
    elif kind == 2 and isinstance(block[key], list):
        block[key] = block[key][: draw.randrange(len(block[key]) + 1)] * draw.choice((1, 3))
    else:
        inner = block[draw.choice(("keys", "values"))]
        inner[draw.choice(sorted(inner))] = draw.choice((value, [value], []))
    text = json.dumps(block).encode()
    if draw.random() < 0.1:
        text = draw.choice((b"[", b'{"a":')) * 100_000
    lines[at] = b"%08x %s\n" % (zlib.crc32(text), text)
    path.write_bytes(b"".join(lines))
    box.case.label, box.case.how = "forged journal", f"{kind} {key} {str(value)[:30]}"
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


def edited(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Disturb a sweep, edit its file, and run it; it must hold what the edited file gives in an empty folder."""
    data = json.loads(json.dumps(DATA))
    edit = draw.randrange(6)
    if edit == 0:
        data["grid"]["h"] = [*draw.sample(data["grid"]["h"], 4), 0.03]
    elif edit == 1:
        data["measure"] = draw.choice(
            (["drift.k_sq"], ["deviation.energy", "deviation.k_sq"], ["drift.k_sq", "swings"])
        )
    elif edit == 2:
        data["base"]["N"] = draw.choice((30, 61))
    elif edit == 3:
        data["grid"] = {"h": data["grid"]["h"][:3], "scheme": ["rk4", "rk2", "hk"]}
    elif edit == 4:
        del data["include"]
        data["exclude"] = [{"scheme": "hk", "h": 0.002}]
    else:
        data["grid"]["scheme"] = [{"name": "hk", "compensated": True}, "hk"]
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


KINDS = (damaged, forged, damaged, together, damaged, edited)


def sweeps(scenes: Scenes, seed: int, indices: list[int], kept: Path) -> tuple[dict[str, int], list[Finding]]:
    """Try the cases ``indices``; counts, and what was found."""

    def one(index: int, draw: random.Random, box: Sandbox) -> None:
        KINDS[index % len(KINDS)](scenes, draw, box)

    return try_all("sweeps", one, scenes.base, seed, indices, kept)


# --- hostile values ---------------------------------------------------------------------------------------------------

NUMBERS = (
    *(0, -0.0, 1, 1.0, -1, 0.01, 1e-3, 5e-324, 1e-300, 1e150, 1e308, 1.7976931348623157e308, -1.7e308, 10**30, 2**63),
    *(float("nan"), float("inf"), -float("inf"), True, None, "x", "", "0.01", "1/3", [], [1], {}, {"a": 1}, 10**13),
)
KEYS = (
    *("h", "N", "T", "scheme", "top", "top.c0", "initial", "initial.omega", "initial.omega1", "initial.gamma"),
    *("initial.gamma3", "initial.normalize", "output.every", "sample", "seed", "scheme.compose", "scheme.compensated"),
    *("", ".", "h.", "top.", "base", "<b>", "x" * 3000, "\x1b[31m", "\u202e"),
)
VALUES = (
    *("hk", "rk4", "HK", "<script>", {"name": "hk"}, {"name": "rk4", "compose": "x"}, "kowalevski", "euler", "heavy"),
    *({"kind": "kowalevski", "c0": 2}, [1, 0, 0], [0.6, 0, 0.8], ["auto", 0, 1], [float("nan")] * 3, "sphere"),
)


def _number(draw: random.Random) -> Any:
    return draw.choice(NUMBERS if draw.random() < 0.7 else VALUES)


def _range(draw: random.Random) -> Any:
    keys = [key for key in ("from", "to", "count", "spacing") if draw.random() < 0.85]
    made = {key: draw.choice((1, 2, 3, 10**7, 10**12, _number(draw))) for key in keys}
    if "spacing" in made:
        made["spacing"] = draw.choice(("log", "linear", "log", 1))
    return made


def _axis(draw: random.Random) -> Any:
    kind = draw.random()
    if kind < 0.35:
        return _range(draw)
    if kind < 0.45:
        return _number(draw)
    values = [_number(draw) for _ in range(draw.choice((0, 1, 2, 3)))]
    return values * draw.choice((1, 1, 1, 2, 300))


def _section(draw: random.Random) -> Any:
    if draw.random() < 0.1:
        return _number(draw)
    return {draw.choice(KEYS): _axis(draw) for _ in range(draw.choice((1, 1, 2, 3)))}


def hostile_file(draw: random.Random) -> dict[str, Any]:
    """A sweep file of which some sections are no sections of a sweep file."""
    data = json.loads(json.dumps(DATA))
    data["measure"] = ["deviation.energy"]
    for _ in range(draw.choice((1, 1, 2, 3))):
        part = draw.choice(("grid", "grid", "zip", "include", "exclude", "random", "base", "measure", "store", "name"))
        if part in ("grid", "zip"):
            data[part] = _section(draw)
        elif part in ("include", "exclude"):
            data[part] = [{draw.choice(KEYS): _number(draw)} for _ in range(draw.choice((0, 1, 2)))]
        elif part == "random":
            drawn = {"count": draw.choice((1, 2, 10**8, _number(draw))), "omega": {"sphere": _number(draw)}}
            drawn |= {draw.choice(("gamma", "top.c0", "omega", "seed")): draw.choice((_range(draw), _number(draw)))}
            data[part] = drawn
            data["base"].pop("initial" if draw.random() < 0.5 else "T", None)
        elif part == "base":
            data["base"][draw.choice(("h", "N", "T", "top", "initial", "output", "scheme", "name"))] = _number(draw)
        else:
            data[part] = draw.choice((_number(draw), [_number(draw)], ["swings"], "series", "x" * 2000, "../x"))
    return data


def _yaml(data: Any) -> str:
    """YAML of plain data, with its own words for infinities and nan."""
    text = json.dumps(data, ensure_ascii=True)
    for word, own in (("-Infinity", "-.inf"), ("Infinity", ".inf"), ("NaN", ".nan")):
        text = text.replace(word, own)
    return text + "\n"


def axes(scenes: Scenes, seed: int, indices: list[int], kept: Path) -> tuple[dict[str, int], list[Finding]]:
    """Plan the sweep files ``indices``, and run those that are accepted and short; counts, and what was found."""

    def one(index: int, draw: random.Random, box: Sandbox) -> None:
        box.out.mkdir()
        text = _yaml(hostile_file(draw))
        (box.folder / "hostile.yaml").write_text(text, encoding="utf-8")
        box.case.label, box.case.how, box.case.spoilt = "hostile sweep", f"{len(text)} characters", text.encode()
        said = box.call("sweep", "hostile.yaml", "--dry-run", "--json", "--out", "out")
        if said.code not in (0, 2):
            box.fault("exit code", f"--dry-run exits with {said.code}")
        elif said.code == 0 and (plan := json.loads(said.out))["rows"] <= MOST_RUN:
            code = sweep(box, "hostile.yaml", "--time-limit", "2", "--quiet")
            rows = sweep_content(box.out / plan["name"])
            if code not in (0, 1, 3):
                box.fault("exit code", f"an accepted sweep exits with {code}")
            elif isinstance(rows, str) or len(rows.rows) != plan["rows"]:
                box.fault(
                    "wrong rows", f"{plan['rows']} rows planned, then {rows if isinstance(rows, str) else 'fewer'}"
                )

    return try_all("axes", one, scenes.base, seed, indices, kept)
