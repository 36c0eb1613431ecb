"""Constants of orbits: synthetic orbits, schemes with known integrals, negative controls, and the command."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import topcli
from topcli.analysis.constants import Level, constants, null_dimension
from topcli.runs.simulate import simulate
from topcli.studies import find_study

TOLERANCE = 1e-11


def torus(radius: float = 3.0, noise: float = 0.0, rows: int = 500) -> Any:
    """Orbit with x^2 + y^2 = 1 and z^2 + w^2/radius^2 = 1."""
    t = np.arange(float(rows))
    states = np.stack([np.cos(t), np.sin(t), np.cos(2**0.5 * t), radius * np.sin(2**0.5 * t)], axis=1)
    return states + noise * np.random.default_rng(1).normal(size=states.shape)


def counts(levels: Sequence[Level]) -> list[tuple[int, int, int]]:
    return [(level.null, level.products, len(level.constants)) for level in levels]


@pytest.mark.parametrize(
    ("singular", "found"),
    [
        ([1.0, 1e-3, 1e-15], 1),
        ([1.0, 1e-3, 1e-15, 1e-15], 2),
        ([1.0, 1e-3, 1e-12, 1e-15], 2),
        ([1.0, 0.9e-11, 1e-16], 2),
        ([1.0, 1.1e-11, 1e-16], 1),
        ([1.0, 1.1e-7, 0.9e-11], 1),
        ([1.0, 0.8e-7, 0.9e-11], 0),
        ([1.0, 0.5], 0),
        ([1e3, 1.0, 0.9e-8], 1),
    ],
)
def test_null_space_needs_the_tolerance_and_a_gap(singular: list[float], found: int) -> None:
    """Of a factor of 1e4."""
    assert null_dimension(np.array(singular), TOLERANCE) == found


def test_constants_of_a_torus() -> None:
    """Their formulas and values; noise hides them, unless the tolerance allows it."""
    levels = constants([torus()], 2, TOLERANCE)
    assert counts(levels) == [(0, 0, 0), (2, 0, 2)]
    for one in levels[1].constants:
        x = {m: float(c) for m, c in one.polynomial.terms.items()}
        assert x.keys() in ({(0, 0), (1, 1)}, {(2, 2), (3, 3)})
        ratio = x.get((1, 1), 0.0) / x[0, 0] if (0, 0) in x else 9.0 * x[3, 3] / x[2, 2]
        assert ratio == pytest.approx(1.0, rel=1e-10)
        assert one.values[0] == pytest.approx(x.get((0, 0), x.get((2, 2))), rel=1e-10)
        assert min(x.values()) > 0.0  # the first term is positive
        assert one.deviation < 1e-14
    assert counts(constants([torus(noise=1e-9)], 2, TOLERANCE))[1] == (0, 0, 0)
    noisy = constants([torus(noise=1e-9)], 2, 1e-6)[1]
    assert len(noisy.constants) == 2
    assert all(1e-10 < one.deviation < 1e-7 for one in noisy.constants)


def test_products_of_constants_are_not_counted_again() -> None:
    """On one orbit (F - c) times each monomial, also of degree 0; on several F G."""
    assert counts(constants([torus()], 4, TOLERANCE)) == [(0, 0, 0), (2, 0, 2), (10, 10, 0), (29, 29, 0)]
    several = [torus(radius) * size for radius, size in ((3.0, 1.0), (3.0, 2.0), (3.0, 0.7))]
    equal = constants(several, 4, TOLERANCE)  # both have the same value on each orbit, so that F - G is zero
    assert counts(equal) == [(0, 0, 0), (2, 0, 2), (6, 6, 0), (17, 17, 0)]
    for orbit, size in zip(several, (1.0, 0.6, 1.3), strict=True):
        orbit[:, :2] *= size
    assert counts(constants(several, 4, TOLERANCE)) == [(0, 0, 0), (2, 0, 2), (2, 2, 0), (5, 5, 0)]
    apart = [torus(radius) for radius in (3.0, 2.0)]
    assert counts(constants(apart, 2, TOLERANCE))[1] == (1, 0, 1)


def test_a_constant_component_is_a_constant_of_degree_one() -> None:
    orbit = np.column_stack([torus(), np.full(500, 0.3), np.zeros(500)])
    levels = constants([orbit], 2, TOLERANCE)
    assert counts(levels) == [(2, 0, 2), (15, 13, 2)]


SCHEMES = [
    ("lagrange_hk", "hk", 1, 10),
    ("euler_gamma_hk", "hk", 0, 4),
    ("euler_hk", "hk", 0, 2),
    ("kowalevski_generic_hk", "hk", 0, 0),
    ("heavy_hk", "hk", 0, 0),
    ("kowalevski_generic_hk", "backlund", 0, 3),
    ("heavy_hk", "midpoint", 0, 3),
    ("lagrange_hk", "rk2", 1, 7),
]
"""Relations up to degrees 1 and 2 on an orbit: those of an HK basis, or the quadratic integrals of a scheme."""


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "scheme", "first", "second"), SCHEMES)
def test_relations_of_schemes(scene: str, scheme: str, first: int, second: int) -> None:
    states = simulate(scene, scheme=scheme, h=0.1, N=4000).states
    linear, quadratic = constants([np.asarray(states)], 2, TOLERANCE)
    assert (linear.null, quadratic.null) == (first, second)
    assert quadratic.products == 7 * first  # omega3 - c times 1 and the six components
    assert all(one.deviation < 1e-13 for one in (*linear.constants, *quadratic.constants))


@pytest.mark.slow
def test_the_fourth_integral_of_kowalevski_is_discovered() -> None:
    """From orbits of ``backlund``, up to products of the quadratic integrals."""
    random = np.random.default_rng(5)
    orbits = []
    for _ in range(4):
        omega, gamma = random.normal(size=(2, 3))
        initial = {"omega": omega.tolist(), "gamma": (gamma / np.linalg.norm(gamma)).tolist()}
        config = {"top": "kowalevski", "initial": initial, "scheme": "backlund", "h": 0.1, "N": 2000}
        orbits.append(np.asarray(simulate(config).states))
    levels = constants(orbits, 4, TOLERANCE)
    assert [len(level.constants) for level in levels] == [0, 3, 0, 1]
    assert (levels[2].null, levels[2].products) == (9, 9)  # the three, and (gamma^2 - 1) times the six components
    y = random.normal(size=(60, 6))
    w1, w2, w3, g1, g2, g3 = y.T
    quadratic = np.stack([w1**2 + w2**2 + w3**2 / 2 + g1, 2 * (w1 * g1 + w2 * g2) + w3 * g3, g1**2 + g2**2 + g3**2])
    K = (w1**2 - w2**2 - g1) ** 2 + (2 * w1 * w2 - g2) ** 2
    zero = (quadratic[2] - 1) * np.stack([y[:, i] * y[:, k] for i in range(6) for k in range(i, 6)])
    products = [a * b for i, a in enumerate(quadratic) for b in quadratic[i:]]
    terms = np.stack([K, *quadratic, *products, *(quadratic[2] - 1) * y.T, *zero], axis=1)
    found = [float(levels[3].constants[0].polynomial.value(state)) for state in y.tolist()]
    coefficients, *_ = np.linalg.lstsq(terms, found)
    assert np.abs(terms @ coefficients - found).max() < 1e-6 * np.abs(found).max()
    assert abs(coefficients[0]) > 0.01


# the command


def write(path: Path, states: Any, names: str = "x,y,z,w") -> str:
    rows = np.column_stack([0.1 * np.arange(len(states)), states])
    np.savetxt(path, rows, delimiter=",", header=f"t,{names}", comments="", fmt="%.17g")
    return str(path)


def test_files_and_runs(cli: Any, in_tmp: Path) -> None:
    """The data of the command are those of the function."""
    one, other = write(in_tmp / "one.csv", torus()), write(in_tmp / "other.csv", 2.0 * torus())
    said = cli("discover", one, "--json").json()
    assert said == topcli.discover(one).as_dict()
    assert (said["relations"], said["rows"], said["columns"]) == (2, 500, ["x", "y", "z", "w"])
    assert {row["polynomial"] for row in said["constants"]} == {"x**2 + y**2", "z**2 + 0.111111*w**2"}
    assert cli("discover", one, other, "--json").json()["relations"] == 2
    assert [row["polynomial"] for row in cli("discover", one, "--component", "x,y", "--json").json()["constants"]] == [
        "x**2 + y**2"
    ]
    run = topcli.run("euler_hk", in_tmp, N=300, h=0.1, progress=False)
    assert topcli.discover(run.folder).study["relations"] == 2
    assert topcli.discover(run.folder, columns=["omega1,omega2"]).study["relations"] == 1


def test_all_of_a_long_orbit_is_used(cli: Any, in_tmp: Path) -> None:
    """At most 20,000 rows, from beginning to end."""
    states = torus(rows=30_000)
    said = cli("discover", write(in_tmp / "long.csv", states), "--json").json()
    assert (said["rows"], said["relations"]) == (15_000, 2)
    states[21_000:] *= 2.0
    levels = cli("discover", write(in_tmp / "long.csv", states), "--json").json()["relations"]
    assert levels == 1  # the difference of both, which stays zero


MISTAKES = {
    "few.csv": "few.csv: 20 rows are too few for the 14 monomials of degree 2; at least 24 are needed",
    "one.csv --degree 12": "--degree 12: 4 components have 1819 monomials, and at most 500 are tried",
    "one.csv --component v": "--component v: one.csv has no component 'v'; known: w, x, y, z",
    "one.csv --component x,x": "--component x: given twice",
    "one.csv three.csv": "three.csv: has the components a, b, c, and one.csv has x, y, z, w; they must be the same",
    "still.csv": "still.csv: the state is the same in all rows",
    "one.csv --tolerance 2": "--tolerance 2: must be between 0 and 1, such as 1e-11",
    "nothing": "'nothing': no such file or folder, and no run of this name in results",
}


@pytest.mark.parametrize("command", MISTAKES)
def test_mistakes(cli: Any, in_tmp: Path, command: str) -> None:
    write(in_tmp / "one.csv", torus())
    write(in_tmp / "few.csv", torus()[:20])
    write(in_tmp / "three.csv", torus()[:, :3], "a,b,c")
    write(in_tmp / "still.csv", np.ones((100, 4)))
    said = cli("discover", *command.split())
    assert said.code == 2
    assert said.err.startswith(f"error: {MISTAKES[command]}")
    assert said.err.count("\n") == 1


def test_every_cell_is_the_value_of_its_field() -> None:
    keys = ("degree", "monomials", "null", "products", "found", "kept", "left")
    levels = [dict(zip(keys, (2, 27, 10, 7, 3, 1.5e-15, 0.25), strict=True))]
    one = {"polynomial": "x**2", "values": [1.25], "deviation": 3.5e-15, "degree": 2}
    data = {
        "levels": levels,
        "constants": [one, {**one, "values": [1.0, 2.0]}],
        "sources": ["a"],
        "rows": 50,
        "degree": 2,
    }
    shown = [table.cells(data) for table in find_study("discover").tables_of(data)]
    assert shown[0].header == ["constant", "value", "deviation"]
    assert shown[0].lines == [["x**2", "1.25", "3.5e-15"], ["x**2", "–", "3.5e-15"]]
    heads = ["degree", "monomials", "null space", "products", "new", "largest below the gap", "smallest above"]
    assert shown[1].header == heads
    assert shown[1].lines == [["2", "27", "10", "7", "3", "1.5e-15", "0.25"]]
    assert find_study("discover").tables_of(data)[1].title_of(data) == "null spaces by degree"
