"""Page of the reference on all commands, written from the commands themselves."""

from __future__ import annotations

import re
from typing import Any

from descriptor_pages import Page, table

from topcli.cli.app import all_commands, parameter_rows
from topcli.cli.commands import GROUPS

EVERY = ("--plugin", "--help")
"""Options of every command, described once."""
CODE = (
    r"((?<![\w-])--[a-z-]+|\btopcli list [a-z]+|\btopcli plot (?:section|sweep)\b|\btopcli [a-z]+|pip install '[^']+')"
)
"""Options and commands in a help text."""


def plain(text: str) -> str:
    """Text of a help in Markdown: options and commands as code, and nothing else as markup."""
    parts = re.split(CODE, text)
    escaped = [re.sub(r"([\\`*_\[\]<>$])", r"\\\1", part) for part in parts]
    return "".join(f"`{part}`" if i % 2 else escaped[i] for i, part in enumerate(parts))


def description(command: Any) -> Page:
    """Paragraphs of the help of a command."""
    paragraphs = re.split(r"\n\s*\n", (command.help or "").strip())
    return [line for part in paragraphs for line in (plain(" ".join(part.split())), "")]


def split(text: str) -> tuple[str, str]:
    """A help text and what it says in brackets: the default, bounds, whether the option may be repeated."""
    found = re.fullmatch(r"(.*?)(?:  \[(.*)\])?", text, re.DOTALL)
    return (found[1], found[2] or "") if found else (text, "")


def parameters(context: Any) -> Page:
    """Table of the arguments and options of a command, without those of every command."""
    rows = []
    for found in parameter_rows(context.command, context).values():
        for name, text in found:
            if not any(option in name for option in EVERY):
                meaning, extra = split(text)
                rows.append((f"`{name}`", plain(meaning), plain(extra)))
    return table(("argument or option", "meaning", "default and limits"), rows) if rows else []


def section(path: str, context: Any, level: str) -> Page:
    """Section on one command."""
    usage = " ".join([context.command_path, *context.command.collect_usage_pieces(context)])
    return [
        f"{level} topcli {path}",
        "",
        *description(context.command),
        "```text",
        usage,
        "```",
        "",
        *parameters(context),
    ]


def commands_page() -> Page:
    """All commands in the groups of ``topcli --help``: usage and options."""
    contexts = all_commands()
    lines = [
        "An option means the same in every command that has it: `--out` "
        "is where results are written, `--results` is the folder in which stored results are found by name, and "
        "`--set KEY=VALUE` overrides a key of the config (in `topcli sweep`, of the sweep file). A stored result is "
        "given by its path or by its name in the folder of `--results`.",
        "",
        "Every command has `--help`, and `--plugin FILE` (or `--scheme-file FILE`), which loads tops, schemes, "
        "measures, figures and hard cases [of your own](own-scheme.md). Options marked as repeatable may be given "
        "several times.",
        "",
        "If an output file exists already, the command exits with 2 and names the file; with `--force`, it replaces "
        "the file. Files with a fixed name that topcli itself wrote earlier, such as the pictures of `topcli plot`, "
        "are replaced without `--force`. `topcli run --force` and `topcli bench` rename an earlier, different result "
        "instead of replacing it.",
        "",
        "The page [Exit codes](exit-codes.md) lists the codes with which commands exit.",
        "",
    ]
    for title, group in GROUPS.items():
        lines += [f"## {title}", ""]
        for path, context in contexts.items():
            first, _, rest = path.partition(" ")
            if first in group:
                lines += section(path, context, "####" if rest else "###")
    return lines
