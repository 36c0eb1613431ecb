"""Damaged files of finished and unfinished runs and of the machine-code cache, and the commands that meet them.

A damaged file must never be taken for a good one: whatever ends with exit code 0 has the rows, the report and the
config of a run that was never harmed. Files of others stay, and what could be resumed before a refusal can be after.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from attack.command import Said, call
from attack.judge import Faults, Finding, judged, rows_apart, wrong_content
from attack.mutations import draw_for
from attack.scenes import COMPILED, OTHER, Scene, Scenes
from attack.spoil import DAMAGES, FOREIGN, hostile_header, hostile_json
from topcli.store.series import read_series


@dataclass
class Case:
    """A damage: of which file of which scene, in which way; ``said`` are the calls that met it."""

    label: str
    path: str = ""
    how: str = ""
    said: list[Said] = field(default_factory=list)
    faults: Faults = field(default_factory=list)
    spoilt: bytes = b""


def _hashes(folder: Path) -> dict[str, str]:
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
        elsewhere = _hashes(self.folder / "elsewhere")
        writable = [self.out, self.cache, Path(os.environ["MPLCONFIGDIR"])]
        said = call(argv, self.folder, writable, {"NUMBA_CACHE_DIR": str(self.cache)}, prepare=prepare)
        self.case.said.append(said)
        if said.code != -signal.SIGKILL:
            self.case.faults += judged(said)
        if _hashes(self.folder / "elsewhere") != elsewhere:
            self.fault("touched", f"topcli {' '.join(argv)}: changed files elsewhere")
        return said

    def fault(self, kind: str, text: str) -> None:
        """Note that something is wrong."""
        self.case.faults.append((kind, f"{self.case.label}, {self.case.how}: {text}"))


Tried = Callable[[int, random.Random, Sandbox], None]
"""``tried(index, draw, box)`` tries one case and notes what is wrong in the box."""


def try_all(
    part: str, tried: Tried, base: Path, seed: int, indices: list[int], kept: Path
) -> tuple[dict[str, int], list[Finding]]:
    """Try the cases ``indices`` of a part, each in a sandbox of its own; counts, and what was found."""
    counts: Counter[str] = Counter()
    findings: list[Finding] = []
    for index in indices:
        case = Case("")
        box = Sandbox(base / f"sandbox-{os.getpid()}", case)
        try:
            tried(index, draw_for(seed, part, index), box)
        except Exception as error:  # of this harness: the other cases are tried all the same
            where = traceback.extract_tb(error.__traceback__)[-1]
            box.fault("exception", f"{type(error).__name__} {error} at {Path(where.filename).name}:{where.lineno}")
        counts["cases"] += 1
        counts["calls"] += len(case.said)
        here = str(box.folder) + os.sep
        found = [Finding(kind, f"{part} {index}", text.replace(here, "")) for kind, text in dict.fromkeys(case.faults)]
        if found:
            keep(case, found, box.folder, kept / f"{part}-{index}")
        findings += found
    return dict(counts), findings


def foreign_kept(box: Sandbox, planted: int) -> None:
    """Files of others are moved at most."""
    digest = hashlib.sha256(FOREIGN.encode()).hexdigest()
    left = sum(found == digest for found in _hashes(box.out).values())
    if left < planted:
        box.fault("lost", "a file of somebody else was deleted")


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
    others = [other for other in scenes.runs if other is not scene]
    draw.shuffle(others)
    for other in others:
        there = other.folder(other.before)
        names = sorted(p.name for p in folder.iterdir() if (there / p.name).is_file() and p.name != "report.md")
        names = [name for name in names if (there / name).read_bytes() != (folder / name).read_bytes()]
        if names:
            name = draw.choice(names)
            shutil.copyfile(there / name, folder / name)
            case.label, case.how = f"{scene.kind} {name}", f"swapped with that of {other.kind}"
            case.path, case.spoilt = f"{folder.name}/{name}", (folder / name).read_bytes()
            return name
    return None


def _whole_folder(draw: random.Random, scene: Scene, box: Sandbox, case: Case) -> str:
    """Replace the folder itself, or put something of others into it."""
    folder = scene.folder(box.out)
    kind = draw.randrange(4)
    case.label = f"{scene.kind} folder"
    if kind == 0:
        case.how = "a foreign folder inside"
        (folder / ".ipynb_checkpoints").mkdir()
        (folder / ".ipynb_checkpoints" / "precious.txt").write_text(FOREIGN)
    elif kind == 1:
        case.how = "a foreign dotfile inside"
        (folder / ".precious.txt").write_text(FOREIGN)
    elif kind == 2:
        case.how = "a symlink to the folder elsewhere"
        moved = box.folder / "elsewhere" / folder.name
        folder.rename(moved)
        folder.symlink_to(moved)
    else:
        case.how = "a foreign file instead"
        shutil.rmtree(folder)
        folder.write_text(FOREIGN)
    return ""


def damage_run(scenes: Scenes, scene: Scene, draw: random.Random, box: Sandbox) -> None:
    """Damage a copy of ``scene``, and let the commands meet it."""
    case = box.case
    name = None
    for _ in range(20):
        shutil.rmtree(box.out, ignore_errors=True)
        shutil.copytree(scene.before, box.out)
        kind = draw.random()
        if kind < 0.75:
            name = _spoil(draw, scene, box, case)
        else:
            name = _swapped(draw, scenes, scene, box, case) if kind < 0.85 else _whole_folder(draw, scene, box, case)
        if name is not None:
            break
    planted = sum(text == hashlib.sha256(FOREIGN.encode()).hexdigest() for text in _hashes(box.out).values())
    said = box.call("list", "runs", "--out", "out", *(["--json"] if draw.random() < 0.3 else []))
    if said.code not in (0, 1) or OTHER not in said.out:
        box.fault("lost", f"list runs exits with {said.code} and does not name the whole run beside it")
    verify(scene, box, name or "")
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
    foreign_kept(box, planted)


def plot(scene: Scene, box: Sandbox) -> None:
    """Check that a picture shows the rows of a run that was never harmed."""
    words = ["--results", "out", "--configs", str(scene.config.parent), "--out", "out/figures", "--format", "png"]
    said = box.call("plot", "fig1", *words)
    if said.code == 0:
        drawn = read_series(box.out / "figures" / "fig1.parquet")
        if apart := rows_apart({name: scene.expected.rows[name] for name in drawn}, drawn):
            box.fault("wrong rows", f"plot exits with 0 and draws other ones: {apart}")


def verify(scene: Scene, box: Sandbox, name: str) -> None:
    """``topcli verify`` must name a damaged file of a finished run; of the manifest it only has to survive damage."""
    if not scene.finished and not (box.out / scene.name).exists():
        return
    said = box.call("verify", f"out/{scene.name}")
    if scene.finished and name not in ("", "manifest.json", "lock"):
        if said.code == 0:
            box.fault("taken for good", "verify exits with 0")
        elif Path(name).name not in said.out + said.err:
            box.fault("taken for good", f"verify does not name {name}: {said.err[:200]}")


def meet(scene: Scene, box: Sandbox, options: list[str], resumable: bool) -> None:
    """Run or resume, and compare what is then there with a run that was never harmed."""
    ensemble = scene.name != "kowalevski_hk"
    options = [option for option in options if not (ensemble and option == "--resume")]
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
    return [path for path in _hashes(folder) if Path(path).name.startswith("checkpoint")]


# --- the cache ------------------------------------------------------------------------------------------------------


def _spoil_cache(draw: random.Random, scenes: Scenes, box: Sandbox) -> bool:
    """Damage the machine code of ``hk``, or put another's in its place; True if it must not be loaded at all."""
    case, twin = box.case, draw.choice(COMPILED[1:])
    how = draw.choice(("damage", "damage", "header", "swap", "swap", "symlink", "writable", "owner", "folder"))
    if how == "owner" and os.geteuid() != 0:
        how = "writable"
    case.label, case.how = "cache", how
    path = box.cache / scenes.code("hk")
    other = scenes.cache / scenes.code(twin) if how in ("swap", "symlink") else path
    shutil.copytree(scenes.cache, box.cache, copy_function=shutil.copy2)
    if how == "damage":
        damage = draw.choice(DAMAGES)
        case.how = damage.__name__.strip("_")
        damage(draw, path)
    elif how == "header":
        hostile_header(draw, path)
    elif how == "swap":
        case.how = f"the code of {twin} in the place of that of hk"
        shutil.copyfile(other, path)
    elif how == "symlink":
        moved = box.folder / "elsewhere" / "code.o"
        case.how = f"a symlink to the code of {twin}"
        shutil.copyfile(other, moved)
        path.unlink()
        path.symlink_to(moved)
    elif how == "writable":
        case.how = "writable by others"
        path.chmod(draw.choice((0o666, 0o602)))
    elif how == "owner":
        case.how = "owned by somebody else"
        os.chown(path, 65534, 65534)
    else:
        case.how = "in a folder that others can write to"
        path.parent.chmod(0o777)
    return how in ("symlink", "writable", "owner", "folder")


def damage_cache(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Damage a copy of the machine-code cache, and run with it."""
    box.cache = box.folder / "cache"
    scene = next(scene for scene in scenes.runs if scene.kind == "finished" and scene.config.parent.name == "parquet")
    shutil.copytree(scene.before, box.out)
    distrusted = _spoil_cache(draw, scenes, box)
    for _ in range(2):  # the second time with what the first one left
        said = box.call("run", str(scene.config), "--out", "out", "--force", "--json")
        if said.code is None or said.code < 0:
            break  # judged already
        if said.code != 0:
            box.fault("cache", f"a damaged cache makes the run fail: {said.code} {said.err[-200:]}")
        elif wrong := wrong_content(scene.expected, box.out / scene.name):
            box.fault("wrong rows", wrong)
            break
        elif distrusted and json.loads(said.out)["runs"][0]["seconds"]["compile_cached"] and not _replaced(box, scenes):
            box.fault("cache", "it was loaded")


def _replaced(box: Sandbox, scenes: Scenes) -> bool:
    """True if the file in question has been rewritten and may be loaded."""
    path = box.cache / scenes.code("hk")
    status = path.lstat()
    own = status.st_uid == os.geteuid() and not path.is_symlink() and not status.st_mode & 0o002
    return own and not path.parent.stat().st_mode & 0o002


def damage(scenes: Scenes, seed: int, indices: list[int], kept: Path) -> tuple[dict[str, int], list[Finding]]:
    """Try the damages ``indices``; counts, and what was found."""

    def one(index: int, draw: random.Random, box: Sandbox) -> None:
        if index % 4 == 3:
            damage_cache(scenes, draw, box)
        else:
            damage_run(scenes, scenes.runs[(index - index // 4) % len(scenes.runs)], draw, box)

    return try_all("damage", one, scenes.base, seed, indices, kept)


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
