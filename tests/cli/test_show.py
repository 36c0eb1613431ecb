"""``topcli show`` of tops, and the code of generated schemes."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import Said
from topcli.config.sweep import load_sweep
from topcli.contracts import Block
from topcli.schemes.registry import all_schemes
from topcli.sweeps.store import write_manifest
from topcli.tops import BUILT_IN, TOPS


def test_a_top_is_described_by_what_it_declares_and_what_its_field_says(cli: Callable[..., Said]) -> None:
    said = cli("show", "weierstrass").out
    for line in (
        "v' = 6*x**2 - 1.5",
        "degree of the equations: 2",
        "divergence: 0 (the flow preserves volume)",
        "time reversal: change the signs of v",
    ):
        assert line in said.splitlines()
    shown = cli("show", "Euler", "--json").json()["tops"]
    assert [top["form"] for top in shown] == [form for form in BUILT_IN if TOPS.kind(form) == "euler"]
    for top in shown:
        assert top["parameters"]["A"]["value"] == 3.0
        assert (top["further_integrals"], top["integrals_sought"]) == ([], 4)
        assert {"hk", "midpoint"} <= set(top["schemes"])


def test_integrals_that_hold_on_a_level_are_listed_with_it(cli: Callable[..., Said]) -> None:
    assert "; conserved where m_gamma = 0" in " ".join(cli("show", "goryachev-chaplygin").out.split())


def test_generated_code_can_be_read_and_run(cli: Callable[..., Said]) -> None:
    """The code of Kahan's step of v' = 6 x^2 - g2/2, x' = v, against its defining equations."""
    said = cli("show", "hk", "--top", "weierstrass", "--source").out
    scope: dict = {"fma": lambda a, b, c: a * b + c}
    exec(said, scope)
    h, x, v = 0.1, 0.3, -0.2
    p = [3.0, *(eval(line.partition(" = ")[2]) for line in said.splitlines() if line.startswith("# p["))]
    new_x, new_v = scope["step"]((x, v), h, p)
    assert (new_x - x) / h == pytest.approx((v + new_v) / 2, rel=1e-14)
    assert (new_v - v) / h == pytest.approx(6 * x * new_x - 1.5, rel=1e-14)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("exact", "--top", "kowalevski", "--source"),
            "'exact' of the top 'kowalevski' is not made from the field; see ",
        ),
        (("hk", "--top", "eule"), "unknown top 'eule'; did you mean 'euler'"),
        (("dmv", "--top", "clebsch"), "scheme 'dmv' does not fit top 'clebsch'"),
        (("kowalevski_hk", "--source"), "--source: needs the name of a scheme, not 'kowalevski_hk'"),
        (("clebsch", "--top", "euler"), "--top: needs the name of a scheme, not 'clebsch'"),
    ],
)
def test_what_has_no_code_is_refused(cli: Callable[..., Said], arguments: tuple[str, ...], words: str) -> None:
    said = cli("show", *arguments)
    assert said.code == 2
    assert words in said.err


@pytest.mark.slow
@pytest.mark.parametrize("top", [*BUILT_IN, *sorted({TOPS.kind(form) for form in BUILT_IN} - set(BUILT_IN))])
def test_each_pair_of_scheme_and_top_is_shown_or_refused(cli: Callable[..., Said], top: str) -> None:
    """A scheme fits a top if it fits one of its forms; the code of these is shown if it is generated."""
    kinds = [form for form in BUILT_IN if TOPS.kind(form) == top] or [top]
    for name in sorted({scheme.name for scheme in all_schemes()}):
        fits = [scheme for scheme in all_schemes() if scheme.name == name and scheme.top in kinds]
        said = cli("show", name, "--top", top, "--json")
        code = cli("show", name, "--top", top, "--source")
        if not fits:
            assert (said.code, code.code) == (2, 2)
            assert f"scheme '{name}' does not fit top '" in said.err
            continue
        assert [each["top"] for each in said.json()["schemes"]] == [scheme.top for scheme in fits]
        methods = {scheme.top: scheme.build(TOPS[scheme.top].new(), scheme.options()) for scheme in fits}
        made = [form for form, method in methods.items() if isinstance(method, Block) or getattr(method, "source", 0)]
        assert re.findall(r"(?m)^# [\w-]+ \((.*)\)$", code.out) == made
        assert code.code == 2 * (not made)
        assert bool(made) or "is not made from the field; see " in code.err


def test_a_scheme_is_described_once_for_tops_for_which_it_is_the_same(cli: Callable[..., Said]) -> None:
    shown = " ".join(cli("show", "hk").out.split())
    forms = [scheme.top for scheme in all_schemes() if scheme.name == "hk"]
    assert f"hk ({', '.join(forms)}): Hirota-Kimura scheme" in shown
    assert "option compensated (default false): compensated summation" in shown
    assert "option project (default 0): " in shown
    assert "m·e₃, modified integrals (lagrange, lagrange-gyrostat); " in shown
    assert cli("show", "bs").out.count("order: 1") == 2


@pytest.mark.slow
def test_runs_are_listed_with_sweeps_also_unfinished_ones(cli: Callable[..., Said]) -> None:
    cli("run", "euler_hk", "--set", "N=50", "--set", "name=one", "--quiet")
    cli(
        "sweep",
        "heavy_drift",
        "--set",
        "random.count=2",
        "--set",
        "base.N=100",
        "--set",
        "exclude=[{scheme: rk4}]",
        "--quiet",
    )
    whole = {item["name"]: item for item in cli("list", "runs", "--json").json()["runs"]}
    keys = ("kind", "outcome", "step", "N")
    assert [whole["one"][key] for key in keys] == ["run", "completed", 50, 50]
    assert [whole["heavy_drift"][key] for key in keys] == ["sweep", "completed", 8, 8]
    write_manifest(Path("results/heavy_drift"), load_sweep("heavy_drift"))
    item = {item["name"]: item for item in cli("list", "runs", "--json").json()["runs"]}["heavy_drift"]
    assert [item[key] for key in ("outcome", "step", "N")] == ["killed", None, None]
