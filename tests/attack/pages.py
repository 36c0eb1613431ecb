"""Results whose names, messages and files hold markup, or lead elsewhere, for ``topcli report``.

A page holds no script, no element and no attribute that loads something, whatever is in the files that it shows; and
nothing of a file that lies outside the folders that it was asked for.
"""

from __future__ import annotations

import functools
import json
import os
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from attack.command import call
from attack.mutations import TEXTS
from attack.sandbox import Sandbox
from attack.scenes import Scenes
from reading_html import read_html
from topcli.store.files import sealed
from topcli.store.manifest import MANIFEST_SEAL

SECRET = "c2VjcmV0: 7f3a91"
PAYLOADS, ELEMENTS = TEXTS["payloads"], TEXTS["elements"]
_LOADING = ("src", "href", "xlink:href", "srcset", "action", "data", "poster", "background", "formaction", "style")


def wrong_markup(text: str) -> Iterator[str]:
    """Parts of a page that run or load something, or are not HTML."""
    try:
        elements = read_html(text).all()
    except AssertionError as error:
        yield str(error)
        return
    for element in elements:
        if element.name not in ELEMENTS:
            yield f"an element {element.name}"
        for name, value in element.attributes.items():
            value = value.strip().lower()
            local = value.startswith(("#", "data:")) or (name == "style" and "url(" not in value.replace("url(#", ""))
            runs = name.startswith("on") or "javascript:" in value
            if runs or (name in _LOADING and value and not local):
                yield f"{element.name} {name}={value[:60]}"


def poisoned(draw: random.Random, data: Any, share: float) -> Any:
    """``data`` with markup in a share of its texts, names of keys included."""
    if isinstance(data, dict):
        return {
            (draw.choice(PAYLOADS) if draw.random() < share / 8 else key): poisoned(draw, value, share)
            for key, value in data.items()
        }
    if isinstance(data, list):
        return [poisoned(draw, value, share) for value in data]
    if isinstance(data, str) or draw.random() < share / 8:
        return draw.choice((str(data), "")) + draw.choice(PAYLOADS) if draw.random() < share else data
    return data


def _poison(draw: random.Random, path: Path) -> None:
    if path.suffix == ".json":
        data = poisoned(draw, json.loads(path.read_bytes()), draw.choice((0.05, 0.3, 1.0)))
        if path.name == "manifest.json" and draw.random() < 0.8:
            data = sealed(data, MANIFEST_SEAL)
        path.write_text(json.dumps(data), encoding="utf-8")
    elif path.suffix in (".yaml", ".md", ".jsonl"):
        lines = path.read_text(encoding="utf-8").splitlines()
        lines.insert(draw.randrange(len(lines) + 1), f"# {draw.choice(PAYLOADS)}".replace("\0", ""))
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _lead_elsewhere(draw: random.Random, path: Path, elsewhere: Path) -> None:
    """Put a link in the place of a file, to one that holds its content and a secret."""
    target = elsewhere / f"secret{path.suffix}"
    if path.suffix == ".json":
        data = json.loads(path.read_bytes())
        data = {key: SECRET if isinstance(value, str) else value for key, value in data.items()}
        target.write_text(
            json.dumps(sealed(data, MANIFEST_SEAL) if path.name == "manifest.json" else data), encoding="utf-8"
        )
    elif path.suffix in (".yaml", ".md"):
        target.write_text(f"{SECRET}\n{path.read_text(encoding='utf-8')}", encoding="utf-8")
    else:
        shutil.copyfile(path, target)
    path.unlink()
    path.symlink_to(target)


@functools.cache
def places(scenes: Scenes) -> list[Path]:
    """What pages are made of: folders of runs and sweeps, and a stored comparison."""
    path = scenes.base / "comparison.json"
    words = ["compare", "hk", "rk4", "--set", "N=60", "--set", "h=0.01", "--save", str(path)]
    said = call(words, scenes.base, [scenes.base, Path(os.environ["NUMBA_CACHE_DIR"])])
    if said.code != 0:
        raise RuntimeError(f"the attack could not be prepared: {said.err}")
    names = ("finished-parquet", "finished-ensemble", "interrupted-csv", "killed-parquet")
    runs = [one.folder(one.before) for one in map(scenes.run, names)]
    return [*runs, *(one.whole for one in scenes.sweeps[::2]), path]


def page(scenes: Scenes, draw: random.Random, box: Sandbox) -> None:
    """Make a page of something with markup or links in it."""
    place = draw.choice(places(scenes))
    name = draw.choice((place.name, place.name, "<img src=x onerror=alert(1)>", "$x_{$", "a'\"b&c"))
    if place.name.startswith(".") or not place.is_dir():
        name = place.name
    target = box.out / name
    box.out.mkdir()
    shutil.copytree(place, target) if place.is_dir() else shutil.copyfile(place, target)
    files = [path for path in sorted(target.rglob("*")) if path.is_file()] if target.is_dir() else [target]
    links = draw.random() < 0.3 and target.is_dir()
    for path in draw.sample(files, min(len(files), draw.choice((1, 2, 9)))):
        if links:
            _lead_elsewhere(draw, path, box.folder / "elsewhere")
        else:
            _poison(draw, path)
    box.case.label, box.case.how = f"{place.name} as {name}", "links" if links else "markup"
    title = ["--title", draw.choice(PAYLOADS).replace("\0", "")] if draw.random() < 0.5 else []
    said = box.call("report", str(target.relative_to(box.folder)), "--out", "out/page.html", *title)
    if said.code not in (0, 1, 2):
        box.fault("exit code", f"report exits with {said.code}")
    if said.code == 0:
        text = (box.out / "page.html").read_text(encoding="utf-8")
        for wrong in dict.fromkeys(wrong_markup(text)):
            box.fault("markup", wrong)
        if SECRET in text:
            box.fault("markup", "the page shows a file from elsewhere")
