"""Damaged files of finished and unfinished runs, of machine code and of set-ups, and the commands that meet them.

A damaged file must never be taken for a good one: whatever ends with exit code 0 has the rows, the report and the
config of a run that was never harmed. Files of others stay, and what could be resumed before a refusal can be after.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import random
import shutil
from dataclasses import dataclass
from pathlib import Path

from attack.command import Said, call
from attack.judge import Content, content, judged, rows_apart, wrong_content
from attack.sandbox import Case, Sandbox, hashes
from attack.scenes import ENSEMBLE, NAME, OTHER, Scene, Scenes
from attack.spoil import DAMAGES, FOREIGN, hostile_json, hostile_value
from topcli.store.series import read_series


def _spoil(draw: random.Random, scene: Scene, box: Sandbox, case: Case) -> str | None:
    """Damage a file of the copy; its name, None when the damage changed nothing."""
    folder = scene.folder(box.out)
    files = sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file() and p.name != "report.md")
    name = draw.choice(files)
    if draw.random() < 0.3:  # the file that all hangs on
        name = next((one for one in files if one.startswith(("series", "checkpoint"))), name)
    path = folder / name
    before = path.read_bytes()
    json_file = name.endswith(".json") or name == "lock"
    damage = hostile_json if json_file and draw.random() < 0.6 else draw.choice(DAMAGES)
    case.label, case.how, case.path = f"{scene.kind} {name}", damage.__name__.strip("_"), f"{folder.name}/{name}"
    damage(draw, path)
    if path.is_file() and not path.is_symlink():
        case.spoilt = path.read_bytes()
        return None if case.spoilt == before else name
    return name


def _swapped(draw: random.Random, scenes: Scenes, scene: Scene, box: Sandbox, case: Case) -> str | None:
    """Put a file of another scene of the same name in the place of one of this."""
    folder = scene.folder(box.out)
    others = [
        (other, path)
        for other in scenes.runs
        for path in sorted(other.folder(other.before).iterdir())
        if (here := folder / path.name).is_file() and path.is_file() and path.read_bytes() != here.read_bytes()
    ]
    other, path = draw.choice([one for one in others if one[1].name != "report.md"])
    shutil.copyfile(path, folder / path.name)
    case.label, case.how = f"{scene.kind} {path.name}", f"swapped with that of {other.kind}"
    case.path, case.spoilt = f"{folder.name}/{path.name}", path.read_bytes()
    return path.name


def _whole_folder(draw: random.Random, scene: Scene, box: Sandbox, case: Case) -> str:
    """Replace the folder itself, or put something of others into it."""
    folder = scene.folder(box.out)
    kinds = ("a foreign folder inside", "a foreign dotfile inside", "a symlink to the folder elsewhere")
    case.label, case.how = f"{scene.kind} folder", draw.choice((*kinds, "a foreign file instead"))
    if case.how == kinds[0]:
        (folder / ".ipynb_checkpoints").mkdir()
        (folder / ".ipynb_checkpoints" / "precious.txt").write_text(FOREIGN)
    elif case.how == kinds[1]:
        (folder / ".precious.txt").write_text(FOREIGN)
    elif case.how == kinds[2]:
        moved = box.folder / "elsewhere" / folder.name
        folder.rename(moved)
        folder.symlink_to(moved)
    else:
        shutil.rmtree(folder)
        folder.write_text(FOREIGN)
    return ""


def damage_run(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Damage a copy of a folder of runs, and let the commands meet it."""
    scene, case, name = draw.choice(scenes.runs), box.case, None
    while name is None:
        shutil.rmtree(box.out, ignore_errors=True)
        shutil.copytree(scene.before, box.out)
        kind = draw.random()
        if kind < 0.75:
            name = _spoil(draw, scene, box, case)
        else:
            name = _swapped(draw, scenes, scene, box, case) if kind < 0.85 else _whole_folder(draw, scene, box, case)
    planted = box.planted
    said = box.call("list", "runs", "--results", "out", *(["--json"] if draw.random() < 0.3 else []))
    if said.code not in (0, 1) or OTHER not in said.out:
        box.fault("lost", f"list runs exits with {said.code} and does not name the whole run beside it")
    verify(scene, box, name)
    if draw.random() < 0.3:
        box.call("show", f"out/{scene.name}/config.yaml")
    if scene.finished and scene.config.parent.name == "parquet" and draw.random() < 0.3:
        plot(scene, box)
    # a plain run would start again beside an unfinished one: --resume is what may be misled
    calls = [[], ["--json"]] if scene.finished else [["--resume"], ["--resume", "--json"]]
    draw.shuffle(calls)
    for options in (*calls, ["--force"]):
        wrong = len(case.faults)
        meet(scene, box, options, resumable=name == "" and "instead" not in case.how)
        if len(case.faults) > wrong:
            break  # the next calls would only repeat it
    box.foreign_kept(planted)


def plot(scene: Scene, box: Sandbox) -> None:
    """Check that a picture shows the rows of a run that was never harmed."""
    words = ["--results", "out", "--configs", str(scene.config.parent), "--out", "out/figures", "--format", "png"]
    said = box.call("plot", "fig1", *words)
    if said.code == 0:
        drawn = read_series(box.out / "figures" / "fig1.parquet")
        if apart := rows_apart({name: scene.expected.rows[name] for name in drawn}, drawn):
            box.fault("wrong rows", f"plot exits with 0 and draws other ones: {apart}")


def verify(scene: Scene, box: Sandbox, name: str) -> None:
    """``topcli verify`` must name a damaged file of a finished run, unless it was rewritten."""
    if not scene.finished and not (box.out / scene.name).exists():
        return
    said = box.call("verify", f"out/{scene.name}")
    rewritten = name == "manifest.json" and box.case.how not in ("bit", "bits", "truncate")
    if scene.finished and name not in ("", "lock") and not rewritten:
        if said.code == 0:
            box.fault("taken for good", "verify exits with 0")
        elif Path(name).name not in said.out + said.err:
            box.fault("taken for good", f"verify does not name {name}: {said.err[:200]}")


def meet(scene: Scene, box: Sandbox, options: list[str], resumable: bool) -> None:
    """Run or resume, and compare what is then there with a run that was never harmed."""
    options = [option for option in options if not (scene.name == ENSEMBLE and option == "--resume")]
    checkpoint = _checkpoints(box.folder)
    said = box.call("run", str(scene.config), "--out", "out", *options)
    if said.code == 0:
        if wrong := wrong_content(scene.expected, box.out / scene.name):
            box.fault("wrong rows", f"run {' '.join(options)} exits with 0, and then: {wrong}")
        elif "--json" in options and (reported := _reported(said, scene)):
            box.fault("wrong rows", f"run {' '.join(options)} reports another {reported}")
        elif "(up to date)" in said.out + said.err and box.case.path.endswith(("parquet", "csv")):
            name = Path(box.case.path).name
            if (box.out / scene.name / name).read_bytes() != scene.expected.files.get(name):
                box.fault("taken for good", f"{name} is damaged, and the run is up to date")
    elif resumable and checkpoint and not _checkpoints(box.folder):
        box.fault("lost", f"run {' '.join(options)} exits with {said.code}, and the checkpoint is gone")


def _reported(said: Said, scene: Scene) -> str:
    """The first key of the report in ``--json`` that is not as expected."""
    report = json.loads(said.out)["runs"][0]
    return next((key for key, value in scene.expected.report.items() if report.get(key) != value), "")


def _checkpoints(folder: Path) -> list[str]:
    return [path for path in hashes(folder) if Path(path).name.startswith("checkpoint")]


@dataclass(frozen=True)
class Stored:
    """A file of a cache: machine code or a set-up, one of another scheme or start, and a run that loads the first."""

    cache: Path
    path: Path
    others: tuple[Path, ...]
    words: tuple[str, ...]
    expected: Content


COMPILED = (("scheme=hk",), ("scheme=rk2",), ("scheme=bohlin-a",))
SET_UP = (("scheme=exact", "N=20"), ("scheme=exact", "N=20", "initial.omega=[0.7, -0.4, 1.3]"))


@functools.cache
def stored(scenes: Scenes) -> tuple[Stored, ...]:
    """What is stored by runs that find an empty cache."""
    found = []
    for suffix, kinds in ((".o", COMPILED), (".setup", SET_UP)):
        base = scenes.base / f"cache-of{suffix}"
        cache, made, runs = base / "cache", list[Path](), list[tuple[str, ...]]()
        for number, sets in enumerate(kinds):
            known = set(cache.rglob(f"*{suffix}"))
            words = ("run", str(scenes.config), "--name", NAME, *(word for one in sets for word in ("--set", one)))
            said = call(
                [*words, "--out", str(base / str(number))], base.parent, [base], {"NUMBA_CACHE_DIR": str(cache)}
            )
            if said.code or judged(said):
                raise RuntimeError(f"the attack could not be prepared: {said.code} {said.err}")
            made.append(max(set(cache.rglob(f"*{suffix}")) - known, key=lambda path: path.stat().st_size))
            runs.append(words)
        names = [path.relative_to(cache) for path in made]
        found.append(Stored(cache, names[0], tuple(names[1:]), runs[0], content(base / "0" / NAME)))
    return tuple(found)


def _forge(draw: random.Random, path: Path) -> None:
    """Something else in one place of what is stored; a set-up has a right checksum, as the user could give it."""
    first, second, rest = path.read_bytes().split(b"\n", 2)
    if path.suffix == ".o":
        second = json.dumps(hostile_value(draw, json.loads(second))).encode()
    else:
        rest = b"[" * 100_000 if draw.random() < 0.1 else json.dumps(hostile_value(draw, json.loads(rest))).encode()
        first = hashlib.sha256(second + b"\n" + rest).hexdigest().encode()
    path.write_bytes(b"\n".join((first, second, rest)))


def _expose(draw: random.Random, how: str, path: Path, other: Path, elsewhere: Path) -> None:
    """Put another's file in the place of ``path``, or let others write to it."""
    if how == "swap":
        shutil.copyfile(other, path)
    elif how == "symlink":
        shutil.copyfile(other, elsewhere / path.name)
        path.unlink()
        path.symlink_to(elsewhere / path.name)
    elif how == "owner" and os.geteuid() == 0:
        os.chown(path, 65534, 65534)
    elif how == "folder":
        path.parent.chmod(0o777)
    else:
        path.chmod(draw.choice((0o666, 0o602)))


def damage_cache(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Damage, forge, swap or expose stored machine code or a set-up: no row of the run may change."""
    one = draw.choice(stored(scenes))
    box.cache = box.folder / "cache"
    shutil.copytree(one.cache, box.cache, copy_function=shutil.copy2)
    path, other = box.cache / one.path, box.cache / draw.choice(one.others)
    how = draw.choice(("damage", "damage", "forged", "forged", "swap", "symlink", "writable", "owner", "folder"))
    box.case.label, box.case.how = f"cached {path.suffix}", how
    if how == "damage":
        damage = draw.choice(DAMAGES)
        box.case.how = damage.__name__.strip("_")
        damage(draw, path)
    elif how == "forged":
        _forge(draw, path)
    else:
        _expose(draw, how, path, other, box.folder / "elsewhere")
    for _ in range(2):  # the second time with what the first one left
        said = box.call(*one.words, "--out", "out", "--force", "--json")
        if said.code is None or said.code < 0:
            break  # judged already
        if how == "forged" and path.suffix == ".setup":
            if said.code not in (0, 1):
                box.fault("exit code", f"a forged set-up makes the run exit with {said.code}: {said.err[-200:]}")
        elif said.code != 0:
            box.fault("cache", f"a damaged cache makes the run fail: {said.code} {said.err[-200:]}")
        elif wrong := wrong_content(one.expected, box.out / NAME):
            box.fault("wrong rows", wrong)
            break
        elif how not in ("damage", "forged", "swap") and path.suffix == ".o" and _loaded(said, path):
            box.fault("cache", "it was loaded")


def _loaded(said: Said, path: Path) -> bool:
    """True if machine code was loaded, from a file that has not been made again and that is not this user's alone."""
    status = path.lstat()
    own = status.st_uid == os.geteuid() and not path.is_symlink() and not status.st_mode & 0o002
    trusted = own and not path.parent.stat().st_mode & 0o002
    return json.loads(said.out)["runs"][0]["seconds"]["compile_cached"] and not trusted
