"""Animations of odd sizes and times, and rational numbers that grow without limit."""

from __future__ import annotations

import json
import random
import shutil

from attack.judge import content
from attack.sandbox import Sandbox
from attack.scenes import NAME, SHORT, Scenes
from topcli.config.text import to_yaml

DIGITS = 2000
"""Digits at which the rational runs stop."""


def film(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Animate with odd sizes and times."""
    shutil.copytree(scenes.run("finished-parquet").before, box.out)
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
