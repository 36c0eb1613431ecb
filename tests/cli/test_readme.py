"""The README says what is so: its code runs, its output is real."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conftest import PAPER, ROOT
from topcli.analysis.reference import reference_states
from topcli.engine.loop import Run
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


def topcli(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "topcli", *arguments], capture_output=True, text=True, cwd=cwd, check=False
    )


@pytest.mark.slow
def test_the_python_example_runs(tmp_path: Path) -> None:
    example = blocks("python")[0]
    assert "simulate" in example
    done = subprocess.run([sys.executable, "-c", example], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert "verdict" in done.stdout
    assert "exact" in done.stdout


@pytest.mark.slow
def test_the_run_is_real(tmp_path: Path) -> None:
    done = topcli("run", str(ROOT / "configs" / "kowalevski_hk.yaml"), cwd=tmp_path)
    assert done.returncode == 0
    for line in (done.stderr + done.stdout).splitlines():
        assert f"    {line}\n" in README


@pytest.mark.slow
def test_the_comparison_is_real(tmp_path: Path) -> None:
    """All but what belongs to the machine (times) and to round-off."""
    done = topcli("compare", "hk", "bohlin-A", "hybrid", cwd=tmp_path)
    assert done.returncode == 0
    stable = ("outcome", "max error", "  verdict", "  its order in h", "spacing", "E max", "2l max")
    lines = [line for line in done.stdout.splitlines() if line.startswith(stable)]
    assert len(lines) == 10
    for line in lines:
        assert f"    {line}\n" in README


@pytest.mark.slow
def test_the_config_is_the_shipped_one(tmp_path: Path) -> None:
    (tmp_path / "kowalevski_hk.yaml").write_text(blocks("yaml")[0])
    ours = topcli("show", "kowalevski_hk.yaml", cwd=tmp_path).stdout
    assert ours == topcli("show", str(ROOT / "configs" / "kowalevski_hk.yaml"), cwd=tmp_path).stdout


@pytest.mark.slow
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


def block_after(command: str) -> list[str]:
    """The lines of the README's block that shows ``$ command``."""
    found = re.search(rf"    \$ {re.escape(command)}\n((?:    .*\n)+)", README)
    assert found, command
    return [line[4:] for line in found.group(1).splitlines()]


def agrees(shown: str, now: str) -> bool:
    """True if two lines of a table have equal labels and words, and numbers within a factor of 2.

    That is what round-off differs by between machines; a deviation typically moves by 1.2.
    """
    pieces = [re.split(r"\s{2,}", line.strip()) for line in (shown, now)]
    if len(pieces[0]) != len(pieces[1]):
        return False
    for one, other in zip(*pieces, strict=True):
        try:
            a, b = float(one), float(other)
        except ValueError:
            if one != other:
                return False
        else:
            if not (a == b or 0.5 <= a / b <= 2.0):
                return False
    return True


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "labels"),
    [
        ("topcli run euler_hk", ("invariant", "max deviation", "verdict")),
        ("topcli compare hk bohlin-A hybrid", ("γ² max deviation", "k² max deviation", "  model", "  verdict")),
    ],
)
def test_the_numbers_shown_are_what_the_program_prints(command: str, labels: tuple[str, ...], tmp_path: Path) -> None:
    """Deviations of the size of round-off too, which are in no test of equality."""
    done = topcli(*command.split()[1:], cwd=tmp_path)
    assert done.returncode == 0
    shown, now = (
        [line for line in text if line.startswith(labels)] for text in (block_after(command), done.stdout.splitlines())
    )
    assert len(shown) == len(now) >= 3
    for one, other in zip(shown, now, strict=True):
        assert agrees(one, other), f"README: {one!r}, now {other!r}"


def test_agreement_can_fail() -> None:
    assert agrees("max deviation    1.5e-13  exact", "max deviation  1.1e-13   exact")
    assert not agrees("max deviation  3.6e-14", "max deviation  1.5e-13")
    assert not agrees("verdict  exact", "verdict  bounded")
    assert not agrees("verdict  exact", "verdict  exact  exact")


BEYOND = re.findall(r"\| `([a-z0-9-]+)`.* \| [0-9.]+ \| ([0-9.e-]+) \|", README)


def test_the_table_of_schemes_beyond_the_paper() -> None:
    """The largest component of the error at t = 50 of the paper's scene with h = 0.05."""
    assert len(BEYOND) == 8
    top = Kowalevski()
    exact = reference_states(top, PAPER, np.array([50.0]))[0]
    for name, shown in BEYOND:
        scheme = find_scheme(name, "kowalevski")
        *_, last = Run(top, scheme.build(top, scheme.options()), PAPER, 0.05, 1000, 1000)
        assert float(np.abs(last.states[-1] - exact).max()) == pytest.approx(float(shown), rel=0.05), name
