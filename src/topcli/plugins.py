"""Plugins: Python files that ``--plugin`` names, entry points of installed packages, and the places of their errors."""

from __future__ import annotations

import hashlib
import inspect
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from topcli.contracts import Scheme, Top
from topcli.errors import SchemeCodeError, TopcliError, UsageError

_GROUPS = ("topcli.tops", "topcli.schemes", "topcli.figures")
"""Groups of entry points in which installed packages declare plugins; each may bring anything."""
PLUGIN_FILE = "topcli_plugin_"
"""Start of the names of the modules of plugin files; a digest of the path follows."""

FILES: dict[Path, str] = {}
"""Plugin files that have been loaded, by absolute path, in that order, as they were named."""
FAILURES: dict[str, str] = {}
"""Messages about plugins of installed packages that could not be imported so far, by the name of the entry point."""
REGISTERED: list[Any] = []
"""Functions and classes from outside topcli that were registered: tops, schemes, measures and figures."""


def own_sources(top: type[Top], scheme: Scheme) -> dict[str, str]:
    """``sources_of`` a top and a scheme, as far as they are not topcli's own."""
    return sources_of(value for value in (top, scheme.maker) if not is_built_in(value))


def is_built_in(value: Any) -> bool:
    """True if a function or class belongs to topcli, not to a user's file or another package."""
    return value.__module__.partition(".")[0] == "topcli"


def line_of(function: Callable[..., Any]) -> str:
    """``file:line`` of the definition of a function; its module for anything else."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return f"{code.co_filename}:{code.co_firstlineno}" if code else function.__module__


def origin_of(value: Any) -> str:
    """``topcli``, the installed package, or the file of a function or class, which is noted as registered."""
    if is_built_in(value):
        return "topcli"
    REGISTERED.append(value)
    with suppress(SchemeCodeError):  # without a file; refused where a result is stored
        _texts(value.__module__)  # as they are at this moment
    file = str(getattr(sys.modules.get(value.__module__), "__file__", None) or value.__module__)
    return value.__module__.partition(".")[0] if _is_installed(file) else file


def _is_installed(file: str) -> bool:
    return not {"site-packages", "dist-packages"}.isdisjoint(Path(file).parts)


def load_plugin_file(path: Path) -> None:
    """Run a Python file, which may import modules beside it, and so register what it declares.

    Raises UsageError if the file cannot be read or run, or registers nothing.
    """
    where = path.resolve()
    if where in FILES:
        return
    if not path.is_file():
        raise UsageError(f"plugin {path}: no such file")
    if path.suffix != ".py":
        raise UsageError(f"plugin {path}: not a Python file (expected a name ending in .py)")
    # a module of its own for each path: two files of one name do not meet
    _texts.cache_clear()
    module = ModuleType(PLUGIN_FILE + hashlib.sha256(str(where).encode()).hexdigest()[:12])
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    count = len(REGISTERED)
    sys.path.insert(0, str(where.parent))
    bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True  # it would miss an edit within one second
    try:
        _require_own_modules(where)
        exec(compile(path.read_bytes(), str(path), "exec"), module.__dict__)
    except Exception as error:
        reason = str(users_error(error) or reason_of(error))
        raise UsageError(reason if reason.startswith(str(path)) else f"plugin {path}: {reason}") from error
    finally:
        sys.path.remove(str(where.parent))
        sys.dont_write_bytecode = bytecode
    if len(REGISTERED) == count:
        raise UsageError(
            f"plugin {path}: registers nothing; decorate a class with @topcli.top, or a function with "
            "@topcli.scheme(...) or @topcli.measure(...)"
        )
    FILES[where] = str(path)


def _require_own_modules(path: Path) -> None:
    """Raise UsageError if a module beside a file, which it imports, has the name of one that is loaded already."""
    for file in _with_modules_beside(path)[1:]:
        name = file.relative_to(path.parent).parts[0].removesuffix(".py")
        other = getattr(sys.modules.get(name), "__file__", None)
        if other and path.parent not in Path(other).resolve().parents:
            raise UsageError(f"a module {name!r} is loaded already, from {other}; rename {name}")


@cache
def installed_plugins() -> tuple[EntryPoint, ...]:
    """Entry points of plugins, by name."""
    entries = {(entry.name, entry.value): entry for group in _GROUPS for entry in entry_points(group=group)}
    return tuple(entries[key] for key in sorted(entries))


@cache
def plugin_failures() -> dict[str, str]:
    """Import the plugins of installed packages; one that fails stops nothing else. Return ``FAILURES``."""
    for entry in installed_plugins():
        try:
            entry.load()
        except (KeyboardInterrupt, MemoryError):
            raise
        except BaseException as error:  # including SystemExit: a plugin must not end the program
            reason = (users_error(error) if isinstance(error, Exception) else None) or reason_of(error)
            origin = entry.dist.name if entry.dist else entry.name
            FAILURES[entry.name.lower()] = f"plugin {entry.name!r} of {origin} failed: {reason}"
    return FAILURES


def require_plugin(name: str, what: str) -> list[str]:
    """Raise SchemeCodeError if the plugin called ``name`` has failed. Return messages about others that have."""
    failures = plugin_failures()
    if name in failures:
        raise SchemeCodeError(f"{what} {name!r}: {failures[name]}")
    return list(failures.values())[:2]


@lru_cache
def _texts(name: str) -> dict[str, str]:
    """Texts of a user's module and of those that it needs, by the names of their copies in a run folder.

    Of a package these are all its files, of a file those beside it that it imports. Raises SchemeCodeError for a module
    without a file.
    """
    place = getattr(sys.modules.get(name), "__file__", None)
    if not place or not Path(place).is_file():  # of a prompt, or a script read from a pipe
        raise SchemeCodeError(
            f"what is defined in {name} has no file, and only the text of a file can tell results apart; "
            "write it into a file, or use topcli.simulate, which stores nothing"
        )
    file, package = Path(place), name.partition(".")[0]
    files, folder = [file], file.parent
    if package != name or file.name == "__init__.py":
        root = next((parent for parent in file.parents if parent.name == package), folder)
        files, folder = sorted(root.rglob("*.py")), root.parent
    elif not _is_installed(str(file)):
        files = _with_modules_beside(file)
    return {
        f"source.{re.sub(r'[^A-Za-z0-9_.-]', '.', str(path.relative_to(folder)))}": path.read_text("utf-8", "replace")
        for path in files
    }


def _with_modules_beside(path: Path) -> list[Path]:
    """A file, and those of the modules and packages beside it that it may import, also inside its functions."""
    files = [path]
    for file in files:  # which grows
        imports = re.findall(r"^\s*(?:from|import)\s(.*)", file.read_text("utf-8", "replace"), re.MULTILINE)
        words = set(re.findall(r"\w+", " ".join(imports))) - sys.stdlib_module_names - {"topcli"}
        for word in sorted(words):
            beside = [file.with_name(f"{word}.py"), *sorted((file.parent / word).rglob("*.py"))]
            files += [other for other in beside if other.is_file() and other not in files]
    return files


def sources_of(values: Iterable[Any]) -> dict[str, str]:
    """Texts of the modules of users' functions and classes and of those that they need, by the names of their copies.

    It is the text at the time when they were registered. Raises SchemeCodeError for what has no file.
    """
    return {name: text for value in values for name, text in _texts(value.__module__).items()}


TOPCLI = str(Path(__file__).parent)
STANDARD = sysconfig.get_path("stdlib")


def users_place(error: BaseException) -> str:
    """``file:line: in function`` of the innermost line of a user's code that an error passed; empty for none.

    An installed package that registers plugins is the user's as well.
    """
    for frame, line in reversed(list(traceback.walk_tb(error.__traceback__))):
        file, name = frame.f_code.co_filename, frame.f_code.co_name
        package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
        plugin = any(package == entry.module.partition(".")[0] for entry in installed_plugins())
        if file.startswith(("<", TOPCLI)) or (not plugin and (_is_installed(file) or file.startswith(STANDARD))):
            continue
        return f"{file}:{line}" + ("" if name == "<module>" else f": in {name}")
    return ""


def users_error(error: Exception) -> SchemeCodeError | None:
    """An error that a user's code raised, as one line that names the place; None for an error of topcli's own code."""
    if isinstance(error, TopcliError):
        return None
    place = users_place(error)
    return SchemeCodeError(f"{place}: {reason_of(error)}") if place else None


@contextmanager
def without_users_errors() -> Iterator[None]:
    """Leave the block at an error of a user's code, which is reported where that code is used."""
    try:
        yield
    except Exception as error:
        if not (isinstance(error, SchemeCodeError) or users_error(error)):
            raise


def reason_of(error: BaseException) -> str:
    """Type and first line of the message of an error."""
    if isinstance(error, TopcliError):
        return error.lines[0]
    return (f"{type(error).__name__}: {error}".splitlines() or [type(error).__name__])[0][:400]
