"""Distributions: a wheel from the source distribution holds the scenes, and runs in an environment of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

from conftest import ROOT
from topcli.studies.bench import PEERS

SUFFIXES = {".html", ".txt", ".py", ".pyi", ".yaml", ".toml", ".mplstyle", ".bib", ".ll", ".css"}


def build(source: Path, target: str, into: Path) -> Path:
    """Build a distribution without a network, in a process of its own."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", str(into)]
    subprocess.run(command, cwd=source, check=True, capture_output=True, text=True)
    (path,) = into.glob("*.tar.gz" if target == "sdist" else "*.whl")
    return path


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that is built from the source distribution."""
    folder = tmp_path_factory.mktemp("dist")
    with tarfile.open(build(ROOT, "sdist", folder)) as archive:
        assert not [member.name for member in archive if member.issym() or member.islnk()]
        archive.extractall(folder / "unpacked", filter="data")
    (source,) = (folder / "unpacked").iterdir()
    return build(source, "wheel", folder)


def run_python(python: Path, where: Path, *arguments: str) -> str:
    """Standard output of a Python process in the folder ``where``, which knows nothing of this checkout."""
    cleared = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([str(python), *arguments], cwd=where, env=cleared, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_wheel_holds_the_package_and_the_scenes_and_no_more(wheel: Path) -> None:
    package = ROOT / "src" / "topcli"
    source = {path.relative_to(package).as_posix() for path in package.rglob("*") if path.is_file()}
    expected = {f"topcli/{name}" for name in source if "__pycache__" not in name}
    configs = ROOT / "configs"
    expected |= {f"topcli/scenes/{path.relative_to(configs)}" for path in configs.rglob("*.*")}
    names = set(zipfile.ZipFile(wheel).namelist())
    about = {name for name in names if name.split("/")[0].endswith(".dist-info")}
    assert names - about == expected
    assert {Path(name).suffix for name in expected - {"topcli/py.typed"}} == SUFFIXES
    assert {name.split("/", 1)[1] for name in about} == {
        "METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"
    }  # fmt: skip


@pytest.mark.slow
def test_the_wheel_runs_in_an_environment_of_its_own(wheel: Path, tmp_path: Path) -> None:
    """Its dependencies are those of this environment, which is on the path behind it."""
    venv.create(tmp_path / "env", symlinks=True)
    python = tmp_path / "env" / "bin" / "python"
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    packages = Path(run_python(python, tmp_path, "-c", code).strip())
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    where = tmp_path / "elsewhere"
    where.mkdir()
    run_python(python, where, "-m", "topcli", "run", "kowalevski-hk", "--set", "name=short", "--set", "N=100", "-q")
    assert (where / "results" / "short" / "series.parquet").exists()
    code = "import topcli; print(topcli.__file__); print(len(topcli.simulate('kowalevski_generic_hk', N=100).states))"
    place, rows = run_python(python, where, "-c", code).splitlines()
    assert (Path(place).resolve().parent, rows) == ((packages / "topcli").resolve(), "101")


# peers of the benchmark


def test_every_peer_has_an_extra_that_installs_it() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for package in {peer.package for peer in PEERS.values()} - {"scipy"}:
        assert package in {re.split("[<>=]", requirement)[0] for requirement in extras[package]}
        assert package in extras["peers"][0]
