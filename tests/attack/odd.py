"""Set-ups of closed forms on disk, animations of odd sizes and times, and rational numbers that grow without limit."""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
from pathlib import Path
from typing import Any

from attack.command import call
from attack.damage import Sandbox, try_all
from attack.judge import Finding, content, wrong_content
from attack.scenes import NAME, SHORT, Scenes
from attack.spoil import DAMAGES, HOSTILE
from topcli.config.text import to_yaml

EXACT = ["--set", "scheme=exact", "--set", "N=20", "--name", NAME]
DIGITS = 2000
"""Digits at which the rational runs stop."""


def _prepared(scenes: Scenes) -> Path:
    """A folder with a stored set-up, and runs of the closed form; made when it is first asked for."""
    base = scenes.base / "set-ups"
    if not base.exists():
        cache = {"NUMBA_CACHE_DIR": str(base / "cache")}
        for name, more in (("one", []), ("other", ["--set", "initial.omega=[0.7, -0.4, 1.3]"])):
            argv = ["run", str(scenes.base / "configs" / "parquet" / f"{NAME}.yaml"), "--out", str(base / name)]
            said = call([*argv, *EXACT, *more], scenes.base, [base], cache, limit=300.0)
            if said.code != 0:
                raise RuntimeError(f"the attack could not be prepared: {said.err}")
            if name == "one":
                (first,) = (base / "cache").rglob("*.setup")
                (base / "first").write_text(first.name, encoding="utf-8")
    return base


def _hostile(draw: random.Random, value: Any) -> Any:
    """A stored value with something else in one place."""
    if isinstance(value, dict) and value and draw.random() < 0.9:
        key = draw.choice(sorted(value))
        if draw.random() < 0.1:
            return {name: one for name, one in value.items() if name != key}
        return {**value, key: _hostile(draw, value[key])}
    if isinstance(value, list) and len(value) > 1 and draw.random() < 0.9:
        at = draw.randrange(len(value))
        return [*value[:at], _hostile(draw, value[at]), *value[at + 1 :]]
    kinds = (
        ["object", "Pendulum", [1]],
        ["array", "<f8", [-1, 7], "AAAA"],
        ["complex", 10**400, 0],
        ["fraction", 1, 0],
    )
    return draw.choice((*HOSTILE, *kinds, ["object", "Path", {}], ["array", "|O", [1], "AAAAAAAAAAA="], ["x"]))


def setups(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Damage, forge, swap or expose a stored set-up; the run must have the rows of one that was never stored."""
    base = _prepared(scenes)
    box.cache = box.folder / "cache"
    shutil.copytree(base / "cache", box.cache, copy_function=shutil.copy2)
    box.out.mkdir()
    (path,) = box.cache.rglob((base / "first").read_text(encoding="utf-8"))
    (other,) = (one for one in box.cache.rglob("*.setup") if one.name != path.name)
    how = draw.choice(("damage", "damage", "forged", "forged", "forged", "swap", "link", "writable", "owner", "folder"))
    if how == "owner" and os.geteuid() != 0:
        how = "writable"
    box.case.label, box.case.how = "stored set-up", how
    if how == "damage":
        damage = draw.choice(DAMAGES)
        box.case.how = damage.__name__.strip("_")
        damage(draw, path)
    elif how == "forged":  # with a right checksum, as the user alone could write it
        key, _, data = path.read_bytes().partition(b"\n")[2].partition(b"\n")
        text = json.dumps(_hostile(draw, json.loads(data))).encode()
        if draw.random() < 0.1:
            text = b"[" * 100_000
        rest = key + b"\n" + text
        path.write_bytes(hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest)
    elif how == "swap":
        shutil.copyfile(other, path)
    elif how == "link":
        target = box.folder / "elsewhere" / "code.setup"
        shutil.move(other, target)
        path.unlink()
        path.symlink_to(target)
    elif how == "writable":
        path.chmod(draw.choice((0o666, 0o620)))
    elif how == "owner":
        os.chown(path, 65534, 65534)
    else:
        path.parent.chmod(0o777)
    config = scenes.base / "configs" / "parquet" / f"{NAME}.yaml"
    expected = content(base / "one" / NAME)
    for _ in range(2):
        said = box.call("run", str(config), "--out", "out", "--force", "--json", *EXACT)
        if how == "forged":
            if said.code not in (0, 1):
                box.fault("exit code", f"a forged set-up makes the run exit with {said.code}: {said.err[-200:]}")
        elif said.code != 0:
            box.fault("cache", f"a damaged set-up makes the run fail: {said.code} {said.err[-200:]}")
        elif wrong := wrong_content(expected, box.out / NAME):
            box.fault("wrong rows", wrong)


def film(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Animate with odd sizes and times."""
    finished = next(one for one in scenes.runs if one.before.name == "finished-parquet")
    shutil.copytree(finished.before, box.out)
    t = str(draw.choice((0, 0.5, 1, 2, 1.9999999999, -1, "nan", "inf", "1e308", 5e-324, 1e-9)))
    options = {
        "--size": str(draw.choice((240, 241, 243, 359, 0, -1, 10**9, "x", 3840))),
        "--fps": str(draw.choice((1, 1.5, 3, 120, "nan", "inf", 0, 33.3, 50))),
        "--seconds": str(draw.choice((0.1, 0.1, 0.11, 1, "nan", "1e300", 601))),
        draw.choice(("--start", "--stop")): t,
    }
    if options["--size"] == "3840" and options["--seconds"] == "1":
        options["--seconds"] = "0.1"
    chosen = [word for name in draw.sample(sorted(options), draw.choice((2, 3, 4))) for word in (name, options[name])]
    if "--seconds" not in chosen:
        chosen += ["--seconds", "0.1"]
    path = f"out/film.{draw.choice(('gif', 'gif', 'GIF', 'mp4', 'png', ''))}"
    box.case.label, box.case.how = "animation", " ".join(chosen)
    said = box.call("animate", f"out/{NAME}", "--out", path, "--json", *chosen)
    if said.code not in (0, 1, 2):
        box.fault("exit code", f"animate exits with {said.code}")
    elif said.code == 0:
        about = json.loads(said.out)
        if about["width"] % 2 or about["height"] % 2 or about["frames"] < 2:
            box.fault("wrong rows", f"{about}")
        if path.lower().endswith("gif"):
            from PIL import Image

            with Image.open(box.folder / path) as picture:
                if picture.size != (about["width"], about["height"]):
                    box.fault("wrong rows", f"the picture has {picture.size}, said {about}")
    elif (box.folder / path).is_file():
        box.fault("wrong rows", f"animate exits with {said.code} and leaves a file")


def rational(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Run in rational numbers; the run ends, and no number that it keeps is longer than the limit."""
    box.out.mkdir()
    scheme = draw.choice(("hk", "rk2", "rk4", "hk+kahan-li8", "hk+suzuki4", "rk4", "hk+yoshida4", "hk+kahan-li6"))
    long = draw.choice((1, 20, 400, 900, 5000))
    numbers = ("1/3", "0.1", f"1/{'7' * long}", f"0.{'3' * long}", "1e-300", f"{'9' * min(long, 300)}", 2)
    data = {
        **SHORT,
        "name": NAME,
        "scheme": scheme,
        "h": draw.choice(("1/10", "0.1", -0.1, f"1/{'3' * min(long, 300)}", f"0.{'1' * long}")),
        "initial": {
            "omega": [draw.choice(numbers) for _ in range(3)],
            "gamma": draw.choice(([0.6, 0, 0.8], ["2/7", "3/7", "6/7"])),
        },
        "precision": draw.choice(("rational", "rational", 40)),
        "N": draw.choice((3, 50)),
    }
    if data["precision"] == "rational":
        data["max_digits"] = draw.choice((1, DIGITS))
    else:
        data["N"] = 3
    (box.folder / "long.yaml").write_text(to_yaml(data), encoding="utf-8")
    box.case.label, box.case.how = "rational", f"{scheme}, {long} digits, N = {data['N']}"
    said = box.call("run", "long.yaml", "--out", "out", "--json")
    if said.code not in (0, 1, 2):
        box.fault("exit code", f"run exits with {said.code}")
    if (box.out / NAME).exists():
        report = content(box.out / NAME).report
        grown = (report.get("digits") or report.get("growth") or {}) if isinstance(report, dict) else {}
        box.case.how += f"; {report.get('outcome')}, {str(grown)[:80]}"


KINDS = (setups, rational, setups, film)


def odd(scenes: Scenes, seed: int, indices: list[int], kept: Path) -> tuple[dict[str, int], list[Finding]]:
    """Try the cases ``indices``; counts, and what was found."""

    def one(index: int, draw: random.Random, box: Sandbox) -> None:
        KINDS[index % len(KINDS)](scenes, draw, box)

    return try_all("odd", one, scenes.base, seed, indices, kept)
