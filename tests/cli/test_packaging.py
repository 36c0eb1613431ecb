"""Distributions: a wheel from the source distribution holds the scenes, and runs far from any checkout."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from dataclasses import replace
from importlib.metadata import Distribution, distribution, distributions
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from conftest import ROOT
from documentation import difference, read_page, run, sessions
from topcli.studies.bench.peers import PEERS, missing

SUFFIXES = {".py", ".pyi", ".yaml", ".toml", ".mplstyle", ".bib", ".jinja", ".css"}


def build(source: Path, target: str, into: Path) -> Path:
    """Build a distribution without a network, in a process of its own."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", str(into)]
    subprocess.run(command, cwd=source, check=True, capture_output=True, text=True)
    (made,) = into.glob("*.tar.gz" if target == "sdist" else "*.whl")
    return made


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that is built from the source distribution."""
    folder = tmp_path_factory.mktemp("dist")
    with tarfile.open(build(ROOT, "sdist", folder)) as archive:
        assert not [member.name for member in archive if member.issym() or member.islnk()]
        archive.extractall(folder / "unpacked", filter="data")
    (source,) = (folder / "unpacked").iterdir()
    return build(source, "wheel", folder)


def run_python(python: Path, where: Path, *arguments: str, **environment: str) -> str:
    """Standard output of a Python process in the folder ``where``, which knows nothing of this checkout."""
    cleared = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [str(python), *arguments], cwd=where, env={**cleared, **environment}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def use(python: Path, where: Path, package: Path, **environment: str) -> None:
    """Run a scene of each file format and list the schemes with the topcli in ``package``, in the folder ``where``."""
    short = ("run", "kowalevski-hk", "--set", "name=short", "--set", "N=100", "-q")
    run_python(python, where, "-m", "topcli", *short, **environment)
    assert (where / "results" / "short" / "series.parquet").exists()
    asked = (
        "import topcli; print(topcli.__file__); print(len(topcli.simulate('kowalevski_generic_hk', N=100).states));"
        "from topcli.schemes.registry import all_schemes; print({scheme.name for scheme in all_schemes()})"
    )
    place, rows, schemes = run_python(python, where, "-c", asked, **environment).splitlines()
    assert Path(place).resolve().parent == package.resolve()
    assert rows == "101"
    assert "'hybrid'" in schemes


@pytest.mark.slow
def test_the_wheel_holds_the_package_and_the_scenes_and_no_more(wheel: Path) -> None:
    package = ROOT / "src" / "topcli"
    source = {path.relative_to(package).as_posix() for path in package.rglob("*") if path.is_file()}
    wanted = {f"topcli/{name}" for name in source if "__pycache__" not in name}
    configs = ROOT / "configs"
    wanted |= {f"topcli/scenes/{path.relative_to(configs)}" for path in configs.rglob("*.*")}
    names = set(zipfile.ZipFile(wheel).namelist())
    about = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    assert names - about == wanted
    assert {Path(name).suffix for name in wanted - {"topcli/py.typed"}} == SUFFIXES
    assert {name.split("/", 1)[1] for name in about} == {
        "METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"
    }  # fmt: skip


@pytest.mark.slow
def test_the_wheel_runs_in_an_environment_of_its_own(wheel: Path, tmp_path: Path) -> None:
    """Its dependencies are those of this environment, which is on the path behind it."""
    venv.create(tmp_path / "env", symlinks=True)
    scripts = "Scripts" if os.name == "nt" else "bin"
    python = tmp_path / "env" / scripts / "python"
    packages = Path(
        run_python(python, tmp_path, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    )
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (tmp_path / "elsewhere").mkdir()
    use(python, tmp_path / "elsewhere", packages / "topcli")


@pytest.mark.slow
def test_a_plain_checkout_finds_its_scenes(tmp_path: Path) -> None:
    """Also one that was copied or unpacked by what knows no symbolic links."""
    for name in ("src", "configs"):
        linked = [path for path in (ROOT / name).rglob("*") if path.is_symlink()]
        assert not linked
        shutil.copytree(ROOT / name, tmp_path / "clone" / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "elsewhere").mkdir()
    source = tmp_path / "clone" / "src"
    use(Path(sys.executable), tmp_path / "elsewhere", source / "topcli", PYTHONPATH=str(source))


def test_an_editable_install_points_to_the_checkout_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No copy of a scene that would not follow the checkout."""
    from hatchling.build import build_editable

    monkeypatch.chdir(ROOT)
    archive = zipfile.ZipFile(tmp_path / build_editable(str(tmp_path)))
    (path,) = (name for name in archive.namelist() if ".dist-info/" not in name)
    assert path.endswith(".pth")
    assert archive.read(path).decode().strip() == str(ROOT / "src")


SCRIPTS = "Scripts" if os.name == "nt" else "bin"
KEPT = ("LANG", "LC_ALL", "TMPDIR")
"""Settings of a machine that a new user's shell has too."""


def required(by: Distribution) -> dict[str, Distribution]:
    """The distributions here that one requires without extras, directly or not, by their names."""
    found: dict[str, Distribution] = {}
    left = [by]
    while left:
        for wanted in map(Requirement, left.pop().requires or ()):
            if wanted.name not in found and (wanted.marker is None or wanted.marker.evaluate({"extra": ""})):
                found[wanted.name] = distribution(wanted.name)
                left.append(found[wanted.name])
    return found


@pytest.fixture(scope="module")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """The scripts of an environment of the wheel and what it requires alone, and the variables of a new user.

    What it requires are links to the packages here; make figures in a fresh clone has pip fetch them.
    """
    folder = tmp_path_factory.mktemp("bare")
    (home := folder / "home").mkdir()
    own_pip = find_spec("pip") is not None  # uv makes environments without
    venv.create(folder / "env", symlinks=True, with_pip=not own_pip)
    scripts = folder / "env" / SCRIPTS
    kept = {name: value for name, value in os.environ.items() if name in KEPT}
    environment = {**kept, "HOME": str(home), "PATH": f"{scripts}:/usr/bin:/bin"}
    pip = ("-m", "pip", "--python", str(scripts / "python"), "--disable-pip-version-check", "--quiet")
    install = ("install", "--no-compile", "--no-deps", "--no-index", str(wheel))
    run_python(Path(sys.executable) if own_pip else scripts / "python", home, *pip, *install)
    packages = Path(
        run_python(scripts / "python", home, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip()
    )
    (installed,) = distributions(name="topcli", path=[str(packages)])
    for one in required(installed).values():
        for entry in {Path(file).parts[0] for file in one.files or ()} - {"..", "__pycache__"}:
            if not (packages / entry).exists():
                (packages / entry).symlink_to(one.locate_file(entry))
    assert (packages / "numpy").is_dir()
    assert not (packages / "pytest").exists()
    return scripts, environment


@pytest.mark.slow
def test_the_tutorial_works_on_a_bare_machine(bare: tuple[Path, dict[str, str]], tmp_path: Path) -> None:
    """Every command of it, in one folder, far from any checkout; the code compiled here is known there."""
    scripts, environment = bare
    environment = {**environment, "NUMBA_CACHE_DIR": os.environ["NUMBA_CACHE_DIR"]}
    page = read_page(ROOT / "docs" / "tutorial.md")
    for name, text in page.files().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    commands = [one for block in page.blocks if block.language == "console" for one in sessions(block)]
    assert [command.split()[1] for command, _ in commands] == ["install", "run", "report", "run", "compare", "plot"]
    for command, shown in commands[1:]:  # it is installed
        code, printed = run(command, tmp_path, scripts, environment)
        assert code == 0, (command, printed)
        assert not difference(shown, printed), command
    assert (tmp_path / "results" / "figures" / "fig1.png").stat().st_size > 10_000
    for command in inline_commands(page.path):
        code, printed = run(command, tmp_path, scripts, environment)
        assert code == 0, (command, printed)
    rows = run_python(
        scripts / "python", tmp_path, "-c", "import topcli; print(len(topcli.simulate('top.yaml').to_pandas()))"
    )
    assert rows == "1001\n"


def inline_commands(page: Path) -> list[str]:
    """Commands in the text of a page."""
    return [part for part in page.read_text(encoding="utf-8").split("`")[1::2] if part.startswith("topcli ")]


@pytest.mark.slow
def test_first_steps_work_on_a_bare_machine(bare: tuple[Path, dict[str, str]], tmp_path: Path) -> None:
    """The commands that the help proposes work, and leave nothing beside the folder of work and the user's cache."""
    scripts, environment = bare
    for command in (
        "topcli init",
        "topcli run experiment.yaml",
        "topcli report results/kowalevski_hybrid --out page.html",
        "topcli list sweeps",
    ):
        code, printed = run(command, tmp_path, scripts, environment)
        assert code == 0, (command, printed)
        assert not [line for line in printed if "docs/" in line], command
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "experiment.yaml", "page.html", "results", "topcli.schema.json"
    ]  # fmt: skip
    assert {path.name for path in Path(environment["HOME"]).iterdir()} <= {".cache", ".config", ".local", "Library"}


# peers of the benchmark


def test_every_peer_has_an_extra_that_installs_it() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for peer in PEERS.values():
        if peer.name == "scipy":
            continue
        absent = replace(peer, requires=("no_such_package_of_anybody",))
        assert f"pip install 'topcli[{peer.name}]'" in missing(absent)
        installed = {re.split("[<>=]", requirement)[0] for requirement in extras[peer.name]}
        assert set(peer.requires) - {"numba"} <= installed
        assert peer.name in extras["peers"][0]


def test_make_bench_keeps_the_log_of_an_installation(tmp_path: Path) -> None:
    """A peer that cannot be built costs one line that names the log."""
    make = shutil.which("make")
    if make is None:
        pytest.skip("no make here")
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").split("$(VENV)/.installed-peers:")[1].split("\n\n")[0]
    body = recipe.split("\n", 1)[1]
    (tmp_path / "Makefile").write_text(f"VENV := venv\nPYTHON := python3\npeers:\n{body}\n")
    (tmp_path / "venv").mkdir()
    (tmp_path / "install.sh").write_text('case "$2" in *diffrax*) seq 200; seq 200 >&2; exit 1;; esac; echo fine\n')
    done = subprocess.run(
        [make, "--no-print-directory", "peers"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={name: value for name, value in os.environ.items() if not name.startswith("MAKE")},
    )
    assert done.returncode == 0
    assert done.stdout == ""
    assert done.stderr.splitlines() == [
        "diffrax could not be installed (see venv/install-diffrax.log); topcli bench runs without it"
    ]
    assert len((tmp_path / "venv" / "install-diffrax.log").read_text().splitlines()) == 400
