"""Results whose names, messages and files hold markup, or lead elsewhere, for ``topcli report``.

A page holds no script, no element and no attribute that loads something, whatever is in the files that it shows; and
nothing of a file that lies outside the folders that it was asked for.
"""

from __future__ import annotations

import json
import random
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from attack.damage import Sandbox, try_all
from attack.judge import Finding
from attack.scenes import Scenes
from attack.studies import SWEEP
from attack.verified import comparison
from topcli.store.files import sealed
from topcli.store.manifest import MANIFEST_SEAL

SECRET = "c2VjcmV0: 7f3a91"
PAYLOADS = (
    *(
        "<script>alert(1)</script>",
        '"><img src=x onerror=alert(1)>',
        "'><svg/onload=alert(1)>",
        "--><script>1</script>",
    ),
    *("</title><script>1</script>", "</style><script>1</script>", "]]><script>1</script>", "javascript:alert(1)"),
    *(
        "$<b>$",
        "$\\frac{",
        "{{ 7 * 7 }}",
        "{% include '/etc/passwd' %}",
        "&lt;script&gt;",
        "<!--",
        "\u202e<i>",
        "\0<i>",
    ),
)
ELEMENTS = frozenset(
    (
        *("html", "head", "meta", "title", "link", "style", "body", "header", "main", "section", "nav", "div", "span"),
        *("h1", "h2", "h3", "p", "a", "ul", "li", "dl", "dt", "dd", "strong", "br", "pre", "figure", "figcaption"),
        *("table", "thead", "tbody", "tr", "th", "td", "svg", "g", "path", "defs", "use", "clippath", "rect", "image"),
    )
)
"""Elements of a page and of its pictures; none of them runs anything."""
_LOADING = ("src", "href", "xlink:href", "srcset", "action", "data", "poster", "background", "formaction", "style")


class Reader(HTMLParser):
    """Actions of a browser on a page that must not happen."""

    def __init__(self) -> None:
        super().__init__()
        self.wrong: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Look at an element."""
        if tag not in ELEMENTS:
            self.wrong.append(f"an element {tag}")
        for name, value in attrs:
            text = (value or "").strip().lower()
            if name.startswith("on") or "javascript:" in text:
                self.wrong.append(f"{tag} {name}={text[:60]}")
            local = text.startswith(("#", "data:")) or (name == "style" and "url(" not in text.replace("url(#", ""))
            if name in _LOADING and text and not local:
                self.wrong.append(f"{tag} loads {name}={text[:60]}")

    handle_startendtag = handle_starttag


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


def pages(scenes: Scenes, seed: int, indices: list[int], kept: Path) -> tuple[dict[str, int], list[Finding]]:
    """Try the cases ``indices``; counts, and what was found."""
    kinds = {one.before.name: one.folder(one.before) for one in scenes.runs}
    places = [kinds["finished-parquet"], kinds["finished-ensemble"], kinds["interrupted-csv"], kinds["killed-parquet"]]
    places += [scenes.base / f"whole-{one.config.stem}" / SWEEP for one in scenes.sweeps[::2]]
    places.append(comparison(scenes))

    def one(index: int, draw: random.Random, box: Sandbox) -> None:
        place = places[index % len(places)]
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
            page = (box.out / "page.html").read_text(encoding="utf-8")
            reader = Reader()
            reader.feed(page)
            for wrong in dict.fromkeys(reader.wrong):
                box.fault("markup", wrong)
            if SECRET in page:
                box.fault("markup", "the page shows a file from elsewhere")

    return try_all("pages", one, scenes.base, seed, indices, kept)
