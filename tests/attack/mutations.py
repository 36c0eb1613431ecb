"""Wrong configs: valid ones, changed at random by a few of the mutations below."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
EXTRA = {
    "columns.yaml": "top: {kind: euler, A: 1.0, B: 2.0, C: 3.0}\ninitial:\n  omega: &w [0.1, 1.0, 0.2]\nscheme: hk\n"
    "h: 0.1\nN: 100\noutput:\n  format: csv\n  every: 5\n  columns: [n, t, omega1, energy]\n",
    "composed.yaml": "name: composed\ntop: kowalevski\ninitial:\n  omega: [2, 0, 0]\n  gamma: [auto, 0, 1e-3]\n"
    "  normalize: true\nscheme: hk+suzuki4\nh: -0.01\nN: 50\n",
    "states.yaml": "top: {kind: kowalevski, c0: 1}\ninitial: {gamma: [0.6, 0.48, 0.64]}\nensemble:\n  states:\n"
    "    - {omega: [1, 0, 0]}\n    - {omega: [0, 1, 0], gamma: [0, 0, 1]}\n  store: final\n"
    "scheme: rk4\nh: 0.01\nN: 50\n",
    "heavy.toml": 'top = {kind = "heavy"}\nscheme = "midpoint"\nh = 0.01\nN = 50\n[initial]\nomega = [0.5, 0.1, 2.0]\n'
    'gamma = [0.0, 0.6, 0.8]\n[output]\nformat = "csv"\n',
}
"""Features absent from the packaged configs."""


def corpus() -> dict[str, str]:
    """Valid configs by file name."""
    files = sorted(path for path in CONFIGS.iterdir() if path.suffix in (".yaml", ".toml"))
    return {**{path.name: path.read_text(encoding="utf-8") for path in files}, **EXTRA}


CORPUS = corpus()
TOKEN = re.compile(r"[\w.+-]+|[^\w\s]")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d.]*(?:[eE][-+]?\d+)?(?!\w)")
VALUE = re.compile(r"(?m)(?<=[:=] )[^\n#]+")
TOKENS = sorted({token for text in CORPUS.values() for token in TOKEN.findall(text)})
LINES = sorted({line for text in CORPUS.values() for line in text.splitlines() if line and not line.startswith("#")})
NUMBERS = (
    *("0", "-0.0", "-1", "1e308", "-1e308", "1e400", "-1e400", "5e-324", "1e-400", "1e155", "1e20", ".nan", "nan"),
    *("inf", "-.inf", "1_000", "0x1F", "0o17", "0b11", "00012", "1e", "1e5", "2.0", "1e16", "9007199254740993"),
    *("2147483648", "9223372036854775808", "1000000000000", "1000001", "0.1e-5", "+1", "1e+3", "12:30:45", "²", "１２"),
)
WRONG = (
    *("[]", "{}", "null", "~", "true", "no", "'text'", '""', "[[1, 2], [3]]", "{a: 1}", "{kind: heavy}", "1979-05-27"),
    *(
        "[1, 2]",
        "[1, 2, 3, 4]",
        "[a, b, c]",
        "[auto, auto, 0]",
        "[.nan, 0, 0]",
        "|\n  block",
        "? x",
        "1979-05-27T07:32Z",
    ),
    *("{sphere: 2}", "{normal: [0, 1]}", "{energy: 1e300}", "{start: 0, stop: 1, count: 3}", "hk+suzuki4+suzuki4"),
    *("name", "kahan", "+", "hk+", "+li8", "HK", "-auto", "omega1", "top.B", "../../x", "/etc/passwd"),
)
CONTROLS = "".join(map(chr, [*range(1, 32), *range(127, 160), 0x202E, 0x2066, 0x200F, 0xFEFF, 0x2028, 0x200B, 0xAD]))
LETTERS = "äßЖ漢あع🌀é\u0301ﬁI\u0130ſ\u00a0\u3000２"
TAGS = (
    "!!python/object/apply:os.system ",
    "!t ",
    "!!binary ",
    "!!float ",
    "!<tag:x> ",
    "!! ",
    "!!set ",
    "!!timestamp ",
)
NAMES = ("../x", "a/b", "CON", ".hidden", "-dash", "x " * 60, "figures", "a\\b", "~", "$(touch x)", "[link=x]y[/link]")

Mutation = Callable[[random.Random, str], str]


def _place(draw: random.Random, text: str, pattern: re.Pattern[str]) -> tuple[int, int]:
    """Place of one of the matches of ``pattern``; an empty place if there is none."""
    found = [match.span() for match in pattern.finditer(text)]
    return draw.choice(found) if found else (len(text), len(text))


def _put(text: str, place: tuple[int, int], new: str) -> str:
    return text[: place[0]] + new + text[place[1] :]


def _size(draw: random.Random, largest: int) -> int:
    """A size from 2 on, each power of ten as likely as the next."""
    return int(2 * (largest / 2) ** draw.random())


def swap_tokens(draw: random.Random, text: str) -> str:
    """Two tokens change places."""
    found = list(TOKEN.finditer(text))
    if len(found) < 2:
        return text
    one, two = sorted(draw.sample(found, 2), key=lambda match: match.start())
    return text[: one.start()] + two[0] + text[one.end() : two.start()] + one[0] + text[two.end() :]


def foreign_token(draw: random.Random, text: str) -> str:
    """A token of another config in the place of one of this."""
    return _put(text, _place(draw, text, TOKEN), draw.choice(TOKENS))


def odd_number(draw: random.Random, text: str) -> str:
    """A number that is huge, tiny, not finite, or written in a strange way."""
    digits = str(draw.randrange(1, 10)) * _size(draw, 20_000)
    return _put(text, _place(draw, text, NUMBER), digits if draw.random() < 0.1 else draw.choice(NUMBERS))


def wrong_type(draw: random.Random, text: str) -> str:
    """A value of another type."""
    return _put(text, _place(draw, text, VALUE), draw.choice(WRONG))


def deep(draw: random.Random, text: str) -> str:
    """Deeply nested brackets, braces, sections or keys."""
    depth = _size(draw, 20_000)
    nest = draw.choice(("[", "{a: ", "- ", "? ", "[{", "(", "a.", "{a = "))
    closing = {"[": "]", "{a: ": "}", "[{": "}]", "{a = ": "}"}.get(nest, "")
    return _put(text, _place(draw, text, VALUE), nest * depth + closing * depth * draw.randrange(2))


def alias(draw: random.Random, text: str) -> str:
    """Anchors and aliases: harmless, unknown, recursive, exploding, with a strange name."""
    place = _place(draw, text, VALUE)
    value = text[slice(*place)]
    kind = draw.randrange(5)
    if kind == 0:
        return _put(_put(text, place, "&a " + value), _place(draw, text, VALUE), "*a")
    if kind == 1:
        return _put(text, place, draw.choice(("*b", "&b *b", "&b [*b]", "&a &b 1", "*", "&", "<<: *a")))
    if kind == 2:
        bomb = "".join(f"x{i}: &x{i} [{', '.join([f'*x{i - 1}'] * 9) if i else '1'}]\n" for i in range(12))
        return bomb + text
    if kind == 3:
        odd = "".join(draw.choice(CONTROLS + LETTERS) for _ in range(draw.randrange(1, 9)))
        return _put(text, place, f"*{odd}")
    return _put(text, place, "*" + "a" * _size(draw, 100_000))


def tag(draw: random.Random, text: str) -> str:
    """Tags, also very many and very long."""
    many = draw.choice(("!", "!!", "!a", "%TAG ! !\n")) * _size(draw, 30_000)
    return _put(
        text, (start := _place(draw, text, VALUE)[0], start), many if draw.random() < 0.2 else draw.choice(TAGS)
    )


def duplicate(draw: random.Random, text: str) -> str:
    """Repeat a line."""
    lines = text.splitlines()
    lines.insert(draw.randrange(len(lines) + 1), draw.choice(lines or [""]))
    return "\n".join(lines) + "\n"


def foreign_lines(draw: random.Random, text: str) -> str:
    """Keys of another top, scheme or ensemble, in the place of the same key or between two lines."""
    lines = text.splitlines()
    for _ in range(draw.randrange(1, 4)):
        new = draw.choice(LINES)
        same = [i for i, line in enumerate(lines) if re.split("[:=]", line)[0] == re.split("[:=]", new)[0]]
        if same and draw.random() < 0.7:
            lines[draw.choice(same)] = new
        else:
            lines.insert(draw.randrange(len(lines) + 1), new)
    return "\n".join(lines) + "\n"


def foreign_section(draw: random.Random, text: str) -> str:
    """A stretch of lines from another config."""
    other = draw.choice(list(CORPUS.values())).splitlines()
    begin = draw.randrange(len(other))
    lines = text.splitlines()
    place = draw.randrange(len(lines) + 1)
    lines[place : place + draw.randrange(3)] = other[begin : begin + draw.randrange(1, 8)]
    return "\n".join(lines) + "\n"


def drop(draw: random.Random, text: str) -> str:
    """A line or a stretch less, or the end cut off."""
    if draw.random() < 0.2:
        return text[: draw.randrange(len(text) + 1)]
    lines = text.splitlines()
    if lines:
        begin = draw.randrange(len(lines))
        del lines[begin : begin + draw.randrange(1, 3)]
    return "\n".join(lines) + "\n"


def indent(draw: random.Random, text: str) -> str:
    """Another indentation, tabs, other line ends."""
    lines = text.splitlines()
    if lines:
        i = draw.randrange(len(lines))
        lines[i] = draw.choice((" ", "   ", "\t", "- ", "? ", ": ", "# ", "")) + lines[i].strip()
    return draw.choice(("\n", "\n", "\r\n", "\r")).join(lines) + "\n"


def control(draw: random.Random, text: str) -> str:
    """Control characters and letters of the whole world, plain and escaped, in keys, values and between."""
    for _ in range(draw.randrange(1, 4)):
        odd = draw.choice(CONTROLS if draw.random() < 0.7 else LETTERS)
        pattern = draw.choice((TOKEN, VALUE, re.compile(r"(?m)^ *\w+")))
        start, end = _place(draw, text, pattern)
        escaped = f'"{text[start:end].strip()}\\u{ord(odd):04x}"' if ord(odd) < 0x10000 else odd
        text = _put(text, (start, end), escaped) if draw.random() < 0.4 else _put(text, (end, end), odd)
    return text


def name(draw: random.Random, text: str) -> str:
    """A strange name of the experiment."""
    odd = "".join(draw.choice(LETTERS + "abc .") for _ in range(_size(draw, 120)))
    chosen = draw.choice(NAMES) if draw.random() < 0.4 else odd
    quoted = draw.choice((chosen, f"'{chosen}'", f'"{chosen}"'))
    lines = [line for line in text.splitlines() if not line.startswith("name")]
    return f"name{'=' if '[initial]' in text else ':'} {quoted}\n" + "\n".join(lines) + "\n"


def long(draw: random.Random, text: str) -> str:
    """Something very long: a name of a scheme, a key, a list, a comment."""
    size = _size(draw, 200_000)
    piece = draw.choice(("x", "漢", "ab", "1, ", "-", "9", '"', "a: 1\n", "# \n", " ", "\n", "\x1b[31m"))
    start, end = _place(draw, text, draw.choice((TOKEN, VALUE)))
    return _put(text, (start, end), (piece * size)[:200_000])


def splice(draw: random.Random, text: str) -> str:
    """Some characters that mean something, in the place of others."""
    pieces = (
        ": ",
        "- ",
        "[",
        "]",
        "{",
        "}",
        ",",
        "#",
        "&a ",
        "*a",
        "|\n",
        ">",
        "'",
        '"',
        "---\n",
        "...",
        "%YAML 1.1\n",
    )
    start = draw.randrange(len(text) + 1)
    new = "".join(draw.choice(pieces) for _ in range(draw.randrange(1, 4)))
    return _put(text, (start, start + draw.randrange(4)), new)


MUTATIONS: tuple[Mutation, ...] = (
    *(swap_tokens, foreign_token, odd_number, odd_number, wrong_type, wrong_type, deep, alias, tag, duplicate),
    *(foreign_lines, foreign_lines, foreign_section, drop, indent, control, control, name, long, splice),
)
GENTLE: tuple[Mutation, ...] = (odd_number, foreign_token, foreign_lines, foreign_section, wrong_type, name, duplicate)
"""Those after which a config is most often still one."""


def flip(draw: random.Random, content: bytes) -> bytes:
    """Some bits changed."""
    changed = bytearray(content)
    for _ in range(draw.randrange(1, 5) if changed else 0):
        changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    return bytes(changed)


@dataclass(frozen=True)
class Mutant:
    """A config to be tried: the name of its file, its content, and the mutations that made it."""

    file: str
    content: bytes
    made_by: str


def draw_for(seed: int, part: str, index: int) -> random.Random:
    """The random numbers of one case: those of no other, and the same wherever and whenever it is tried."""
    return random.Random(f"{seed}/{part}/{index}")


def mutant(seed: int, index: int) -> Mutant:
    """Config ``index`` of the attack with ``seed``."""
    draw = draw_for(seed, "fuzz", index)
    file = draw.choice(sorted(CORPUS))
    text, made_by = CORPUS[file], [file]
    gentle = draw.random() < 0.5
    for _ in range(draw.choice((0, 1, 1, 1, 2, 3))):
        mutation = draw.choice(GENTLE if gentle else MUTATIONS)
        text = mutation(draw, text)[:1_100_000]
        made_by.append(mutation.__name__)
    content = text.encode("utf-8", "surrogatepass")
    if draw.random() < 0.1:
        content = flip(draw, content)
        made_by.append("flip")
    return Mutant(file, content, " ".join(made_by))
