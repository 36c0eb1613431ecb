"""Class of all commands: typer's, with help texts free of Python types."""

from __future__ import annotations

import re
from typing import Any

from typer.core import TyperCommand

_TYPE = re.compile(r" <[^>]*>$")


class Command(TyperCommand):
    """A command whose help lists arguments without types such as ``<list[str]>``."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the options."""
        write = formatter.write_dl
        formatter.write_dl = lambda rows, *args, **kwargs: write(
            [(_TYPE.sub("", name), text) for name, text in rows], *args, **kwargs
        )
        super().format_options(ctx, formatter)
        formatter.write_dl = write
