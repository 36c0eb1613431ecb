"""``topcli check``: true declarations hold, false ones and controls are found by the value that they miss."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from conftest import ROOT, Said
from documentation import read_page
from topcli.analysis.conformance import (
    deviation,
    differing_lanes,
    is_vector_of,
    rate_along,
    reversal_defect,
    states_near,
)
from topcli.contracts import Stepper, Top, invariant_of
from topcli.schemes.registry import all_schemes
from topcli.studies.check_declarations import Found, Subject, exact_rate, random_rate, scheme_rows, top_rows
from topcli.studies.stress.trials import generic_case
from topcli.tops.euler import Euler

FILES = read_page(ROOT / "docs" / "own-scheme.md").files()
HEUN = "    return Stepper(heun, 3)"
COUNTING = """
    def step(y, h, p):
        new = heun(y[:3], h, p)
        return (new[0], new[1], new[2], y[3] + 1.0 / (y[3] - 3.0))  # infinite at the third step
    return Stepper(step, 4, lambda y, h, p: (*y, 3.0), lambda y, h, p: y[:3], counters=("events",))
"""
TRUE, FALSE = "self_adjoint=False", "self_adjoint=False, modified=lambda top, h, options: top.invariants()"
FAULTS = {
    "order": ("order=2", "order=3", 2.0),
    "self-adjoint": ("self_adjoint=False", "self_adjoint=True", 9.7e-4),
    "exact invariants": (TRUE, f"{TRUE}, conserves=['energy']", 2.0e9),
    "modified invariants": (TRUE, FALSE, 2.0e9),
    "counters are finite": (HEUN, COUNTING, 1.0),
}


@pytest.fixture
def check(cli: Callable[..., Said]) -> Callable[..., Said]:
    """Check the file of the page with one text replaced."""

    def call(old: str = "", new: str = "", *options: str) -> Said:
        text = FILES["gyrostat.py"]
        assert not old or text.count(old) == 1
        Path("mine.py").write_text(text.replace(old, new) if old else text)
        Path("rotor.yaml").write_text(FILES["rotor.yaml"])
        said = cli(*(options or ("check", "mine.py", "--json")), *(("--plugin", "mine.py") if options else ()))
        return said

    return call


def rows_of(said: Said) -> dict[str, dict[str, Any]]:
    return {f"{row['subject'].split()[0]}: {row['check']}": row for row in said.json()["rows"]}


def test_true_declarations_hold_with_their_controls(check: Callable[..., Said]) -> None:
    said = check()
    rows = rows_of(said)
    assert said.code == 0
    assert {row["verdict"] for row in rows.values()} == {"holds", "not claimed", "not tried"}
    controls = {name: row["control"] for name, row in rows.items() if row["verdict"] == "holds"}
    assert controls == {
        "gyrostat: field": 20.0,
        "gyrostat: energy: exact rate": 2.0,
        "gyrostat: energy: random states": pytest.approx(0.284, rel=0.01),
        "gyrostat: momentum: exact rate": 2.0,
        "gyrostat: momentum: random states": pytest.approx(0.0643, rel=0.01),
        "heun: order": pytest.approx(2.0, abs=0.1),
        "heun: machine code is the step": 3.0,
        "heun: batch equals single": 9.0,
    }
    assert rows["heun: order"]["measured"] == pytest.approx(2.0, abs=0.1)
    assert rows["heun: self-adjoint"]["verdict"] == "not claimed"
    assert rows["heun: self-adjoint"]["measured"] == pytest.approx(9.7e-4, rel=0.05)


@pytest.mark.parametrize("name", FAULTS)
def test_a_false_declaration_is_found_by_its_value(check: Callable[..., Said], name: str) -> None:
    old, new, value = FAULTS[name]
    said = check(old, new)
    rows = rows_of(said)
    assert said.code == 4
    assert [key for key, row in rows.items() if row["verdict"] == "false"] == [f"heun: {name}"]
    assert rows[f"heun: {name}"]["measured"] == pytest.approx(value, rel=0.1)
    (line,) = said.err.strip().splitlines()[-1:]
    assert line.startswith(f"error: heun (gyrostat): {name}: ")


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (
            "order heun --config rotor.yaml --duration 1",
            "error: heun: does not conserve energy, as it declares: off by",
        ),
        ("stress heun --case one-step", "error: heun (gyrostat), case one-step: breaks without a declared limit"),
    ],
)
def test_order_and_stress_find_an_invariant_that_is_not_conserved(
    check: Callable[..., Said], command: str, words: str
) -> None:
    assert check("", "", *command.split()).code == 0
    said = check(*FAULTS["exact invariants"][:2], *command.split())
    assert said.code == 4
    assert words in said.err


def test_code_that_fails_is_named_once(check: Callable[..., Said]) -> None:
    said = check(HEUN, "    raise KeyError('no')")
    assert said.code == 2
    assert said.err.splitlines()[-1] == "error: heun (gyrostat): mine.py:50: in build: KeyError: 'no'"
    assert said.err.count("KeyError") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nothing to check; give a file, --scheme or --top"),
        (["--scheme", "nosuch"], "unknown scheme 'nosuch'"),
        (["--top", "nosuch"], "unknown top 'nosuch'"),
        (["nowhere.py"], "plugin nowhere.py: no such file"),
        (["euler_hk"], "'euler_hk' is a config, not a Python file; to check its top: topcli check --config euler_hk"),
        *(
            ([name], f"'{name}' is a config, not a Python file; to check its top: topcli check --config {name}")
            for name in ("own.yaml", "own.yml", "own.toml")
        ),
    ],
)
def test_wrong_names_are_refused(cli: Callable[..., Said], arguments: list[str], message: str) -> None:
    for name in ("own.yaml", "own.yml", "own.toml"):
        Path(name).write_text("top: euler\n")
    said = cli("check", *arguments)
    assert (said.code, message in said.err) == (2, True)


def test_a_verdict_follows_its_threshold_and_its_control() -> None:
    cases = [
        (Found(1.0, 1.0, 2.0), "holds"),
        (Found(math.nextafter(1.0, 2.0), 1.0, 2.0), "false"),
        (Found(math.nan, 1.0, 2.0), "false"),
        (Found(0.5, 1.0, math.nan), "holds"),
        (Found(0.5, 1.0, 1.0), "undecided"),
        (Found(0.5, 1.0, None), "undecided"),
        (Found(None, 1.0, 2.0), "not tried"),
        (Found(2.0, None, 2.0, holds=True, caught=True), "holds"),
        (Found(2.0, None, 2.0, holds=False, caught=True), "false"),
        (Found(2.0, None, 2.0, holds=None, caught=True), "undecided"),
        (Found(2.0, None, 2.0, holds=True, caught=False), "undecided"),
    ]
    assert [found.verdict(True) for found, _ in cases] == [verdict for _, verdict in cases]
    assert Found(2.0, 1.0, 3.0).verdict(False) == "not claimed"


class Pendulum(Top):
    """Pendulum by its angle."""

    kind = "angle-pendulum"
    components = ("angle", "speed")
    g: float = 2.0

    @staticmethod
    def field(y, p):
        return (y[1], -p[0] * math.sin(y[0]))

    integrals: ClassVar = {"energy": lambda y, p: y[1] ** 2 / 2 - p[0] * np.cos(y[0])}


def test_an_integral_that_is_no_polynomial_is_judged_on_random_states() -> None:
    """The gradient is (2 sin x, v), the field (v, -2 sin x); with 3 cos x it is (3 sin x, v)."""
    top, states = Pendulum(), states_near((0.4, 1.1), 12)
    (energy,) = top.invariants()
    assert exact_rate(top, energy, 0).measured is None
    assert random_rate(top, energy, states, 0).measured < 1e-10
    false = invariant_of("energy", lambda y, p: y[1] ** 2 / 2 - 3.0 * np.cos(y[0]), top.constants())
    s, v = np.sin(states[:, 0]), states[:, 1]
    expected = np.abs(v * s) / np.hypot(3.0 * s, v) / np.hypot(v, 2.0 * s)
    assert random_rate(top, false, states, 0).measured == pytest.approx(expected.max(), rel=1e-6)


def test_a_false_polynomial_integral_has_a_rate() -> None:
    top = Euler()
    false = invariant_of("sum", lambda y, p: y[0] ** 2 + y[1] ** 2 + y[2] ** 2, top.constants())
    assert exact_rate(top, false, 0).measured == 1.0
    states = states_near((0.7, -0.4, 1.3), 5)
    w1, w2, w3 = states.T
    field = np.stack([w2 * w3 / 3.0, -w3 * w1, w1 * w2])  # A, B, C = 3, 2, 1
    expected = np.abs(w1 * w2 * w3) / 3.0 / np.linalg.norm(states, axis=1) / np.linalg.norm(field, axis=0)
    assert rate_along(top, false.value, states) == pytest.approx(expected.max(), rel=1e-8)


def test_measures_see_what_they_measure() -> None:
    top, y0 = Euler(), (0.7, -0.4, 1.3)
    states = states_near(y0, 9)
    assert states[0].tolist() == list(y0)
    assert len({tuple(y) for y in states.tolist()}) == 9

    def leaning(y, h, p):
        return (y[0] + h, y[1], y[2] * (1.0 + h))

    def halted(y, h, p):
        return (y[0] + 1e308 * h * 1e10, y[1], y[2])

    # there and back, the third component is multiplied by 1 - h²
    assert reversal_defect(top, Stepper(leaning, 3), 0.1, states) == pytest.approx(0.01 * np.abs(states[:, 2]).max())
    assert reversal_defect(top, Stepper(halted, 3), 1.0, states) == math.inf
    assert differing_lanes(top, Stepper(leaning, 3), states, states, 0.1, 7) == 0
    moved = states.copy()
    moved[4, 1] = np.nextafter(moved[4, 1], 2.0)
    assert differing_lanes(top, Stepper(leaning, 3), moved, states, 0.1, 7) == 1
    length = invariant_of("length", lambda y, p: y[0] ** 2, ())
    grown = np.array([[1.0], [np.sqrt(1.0 + 1e-10)]])
    # 1e-10 in units of 50 ulp of 1 times the square root of 4 steps
    assert deviation(grown, [length], 4) == pytest.approx(1e-10 / (50.0 * 2.0**-52 * 2.0), rel=1e-5)
    assert is_vector_of((1.0, 2.0, 3.0), top)
    for wrong in ((1.0, 2.0), [1.0, 2.0, 3.0], (1.0, 2.0, math.nan), None):
        assert not is_vector_of(wrong, top)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["euler", "lagrange", "volterra"])
def test_no_scheme_of_topcli_declares_anything_false(form: str) -> None:
    experiment = generic_case(form).experiment("rk2")
    found = list(top_rows(experiment))
    for scheme in all_schemes():
        if scheme.top == form:
            found += scheme_rows(Subject(scheme, generic_case(form).experiment(scheme.name)))
    wrong = [row for row in found if row["verdict"] in ("false", "undecided") or row["broken"]]
    assert wrong == []
