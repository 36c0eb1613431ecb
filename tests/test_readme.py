"""The README says what is so: its code runs, its output is real."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from conftest import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def topcli(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "topcli", *arguments], capture_output=True, text=True, cwd=cwd, check=False
    )


def test_the_python_example_runs(tmp_path: Path) -> None:
    example = blocks("python")[0]
    assert "simulate" in example
    done = subprocess.run([sys.executable, "-c", example], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert "verdict" in done.stdout
    assert "exact" in done.stdout


def test_the_run_is_real(tmp_path: Path) -> None:
    done = topcli("run", str(ROOT / "configs" / "kowalevski_hk.yaml"), cwd=tmp_path)
    assert done.returncode == 0
    for line in (done.stderr + done.stdout).splitlines():
        assert f"    {line}\n" in README


def test_the_comparison_is_real(tmp_path: Path) -> None:
    """All but what belongs to the machine (times) and to round-off."""
    done = topcli("compare", "hk", "bohlin-A", "hybrid", cwd=tmp_path)
    assert done.returncode == 0
    stable = ("outcome", "max error", "  verdict", "  its order in h", "spacing", "E max", "2l max")
    lines = [line for line in done.stdout.splitlines() if line.startswith(stable)]
    assert len(lines) == 10
    for line in lines:
        assert f"    {line}\n" in README


def test_the_config_is_the_shipped_one(tmp_path: Path) -> None:
    (tmp_path / "kowalevski_hk.yaml").write_text(blocks("yaml")[0])
    ours = topcli("show", "kowalevski_hk.yaml", cwd=tmp_path).stdout
    assert ours == topcli("show", str(ROOT / "configs" / "kowalevski_hk.yaml"), cwd=tmp_path).stdout


def test_the_scheme_of_the_readme_can_be_compared(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(blocks("python")[1])
    done = topcli(
        "compare", "hk", "euler-rule", "--scheme-file", "mine.py", "--set", "N=2000", "--set", "h=0.01", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "euler-rule" in done.stdout


@pytest.mark.parametrize("target", re.findall(r"\]\(([^)#]+)\)", README))
def test_links_lead_somewhere(target: str) -> None:
    assert (ROOT / target).exists()
