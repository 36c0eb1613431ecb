"""Checks of the ledger on explicit equations and on the roots of w² = z."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from topcli.paper import printed
from topcli.paper.algebra import Draws, Gauss, dot
from topcli.paper.claim import FAILS, HOLDS, MISPRINT
from topcli.paper.kinds import identity, roots
from topcli.paper.ledger import LEDGER

NAMED = {claim.id: claim for claim in LEDGER}


@pytest.mark.parametrize("name", ["method-b-explicit", "method-c-explicit", "bohlin-explicit"])
def test_explicit_equations_are_linear_in_their_unknown(name: str) -> None:
    assert NAMED[name].decide().figure == 0.0


def test_implicit_forms_of_the_methods_are_found() -> None:
    """The rate of z at the new z, a rotation about an axis that depends on the new gamma, the root as the unknown."""

    def rate(new: Any, draws: Draws) -> Sequence[Any]:
        w = draws.vector()
        return [Gauss(new[0], new[1]) - printed.stereographic_rate(Gauss(w[0], w[1]), w[2], Gauss(new[0], new[1]))]

    def axis(new: Any, draws: Draws) -> Sequence[Any]:
        (c, s), old = draws.circle(), draws.vector()
        return [x - dot(row, old) for x, row in zip(new, printed.rotation(new, c, s), strict=True)]

    def root(new: Any, draws: Draws) -> Sequence[Any]:
        old, gamma, turn = (*draws.vector(), *draws.vector()), draws.vector(), Gauss(*draws.circle())
        return [printed.bohlin(draws.number(), turn, old, (*new, 0, *gamma))]

    for residual, width in ((rate, 2), (axis, 3), (root, 2)):
        assert identity.linear_in_new(residual, width).verdict == FAILS


def test_angles_modulo_two_pi_miss_one_root() -> None:
    """z = 4i has the roots ±sqrt(2) (1 + i), at pi/4 and at pi/4 - pi; Phi/2 = pi/4 mod 2 pi gives the first alone."""
    finding = NAMED["bohlin-angle"].decide()
    assert (finding.verdict, finding.figure) == (MISPRINT, pytest.approx(2.0, rel=1e-12))
    assert finding.corrected is not None
    assert finding.corrected < 1e-15
    angle = math.atan2(4.0, 0.0) / 2.0
    wanted = {1.0 + 1.0j, -1.0 - 1.0j}
    for period, found in ((2.0 * math.pi, 1), (math.pi, 2)):
        listed = [2.0 * complex(math.cos(a), math.sin(a)) for a in (angle + k * period for k in range(-2, 3))]
        hit = {w for w in wanted if min(abs(math.sqrt(2.0) * w - x) for x in listed) < 1e-12}
        assert len(hit) == found
    assert roots.both_roots(0.5, math.pi).verdict == HOLDS
    assert roots.both_roots(0.5, 4.0 * math.pi, math.pi).verdict == MISPRINT


@pytest.mark.slow
def test_choice_by_sign_is_right_in_figure_2_and_wrong_elsewhere() -> None:
    assert NAMED["branch-by-sign-fig2"].decide().figure == 0.0
    finding = NAMED["branch-by-sign"].decide()
    assert (finding.figure, finding.verdict) == (13.0, FAILS)
    assert finding.note == "6 of 200 states next to the negative real axis, in a step of 0.001"


def test_a_wrong_root_at_the_papers_step_by_plain_complex_numbers() -> None:
    """(A), then Bohlin's equation, then the sign: one of the states, computed here, gets the root -omega'."""
    h, wrong = 0.001, 0
    for one in roots.next_to_axis(h)["ensemble"]["states"]:
        w, g = np.array(one["omega"]), np.array(one["gamma"])
        W = 0.5 * h * np.array([[0, w[2], -w[1]], [-w[2], 0, w[0]], [w[1], -w[0], 0]])
        new = np.linalg.solve(np.eye(3) - W, (np.eye(3) + W) @ g)
        omega3 = w[2] - 0.5 * h * (new[1] + g[1])
        xi = complex(w[0], w[1]) ** 2 - complex(g[0], g[1])
        root = (np.exp(-0.5j * h * (w[2] + omega3)) * xi + complex(new[0], new[1])) ** 0.5
        predicted = complex(w[0], w[1]) - 0.5j * h * (w[2] * complex(w[0], w[1]) - g[2])
        chosen = root if (root.imag > 0.0) == (predicted.imag > 0.0) else -root
        wrong += abs(chosen - predicted) > abs(chosen + predicted)
    assert wrong == 6
