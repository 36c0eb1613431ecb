"""The entry point of ``topcli`` and ``python -m topcli``."""

from __future__ import annotations

import gc
import os
import sys


def main() -> None:
    """Run the command line and leave with its exit code; a user's mistake is told without a traceback."""
    gc.set_threshold(100_000, 50, 50)  # start-up makes many objects and no garbage
    from topcli.cli.app import app
    from topcli.errors import TopcliError

    code: int | str | None = 0
    try:
        app(prog_name="topcli")
    except SystemExit as leaving:
        code = leaving.code
    except TopcliError as error:
        print(f"error: {error}", file=sys.stderr)
        code = error.exit_code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        code = 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except Exception:
        import traceback

        traceback.print_exc()
        print(
            "\ninternal error: this is a bug in topcli, please report it with the lines above",
            file=sys.stderr,
        )
        code = 70
    gc.freeze()  # leave without walking through every object again
    sys.exit(code)


if __name__ == "__main__":
    main()
