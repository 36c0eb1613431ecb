"""Taylor series: machine code equals its twin, the motion to round-off, the tolerance kept, any h, its failures."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from conftest import GEN, PAPER, random_states
from plain_vectors import Plain, advance
from topcli.analysis.reference import reference_states
from topcli.contracts import Block, Outcome, Top
from topcli.engine import native
from topcli.engine.driver import Loop, loop_of
from topcli.engine.loop import Run
from topcli.errors import UsageError
from topcli.schemes.any_top import taylor as loop_text
from topcli.schemes.any_top.taylor import ORDERS, Tolerance, build, extended_precision, order_for, quotients
from topcli.schemes.any_top.taylor_series import FREE, GENERAL, SYMMETRIC, Arrangement, arrangement_of, expand
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

TOPS_TRIED: list[Top] = [
    *(top.new() for top in TOPS.values()),
    Kowalevski(c0=-1.5),
    EulerGamma(A=1.0, B=1.0, C=1.0),
    Heavy(A=0.7, B=1.1, C=1.6, x0=-0.4, y0=1.2, z0=0.3),
    Lagrange(A=1.4, C=2.1, mu=-0.8),
]
of_every_top = pytest.mark.parametrize("top", TOPS_TRIED, ids=repr)


def taylor(top: Top, tol: float = 1e-17) -> Block:
    return build(top, Tolerance(tol=tol))


def gen(top: Top) -> np.ndarray:
    return np.array(GEN[: len(top.components)])


def states(run: Run) -> np.ndarray:
    return run.collect().states


def after(top: Top, y0, h: float, N: int, every: int = 1, tol: float = 1e-17) -> np.ndarray:
    """The recorded states, the first one left out."""
    return states(Run(top, taylor(top, tol), y0, h, N, every))[1:]


def prepared(top: Top, y0, h: float, tol: float = 1e-17) -> tuple[Loop, np.ndarray, np.ndarray]:
    p = np.array(top.constants())
    loop = loop_of(taylor(top, tol), len(y0), len(p))
    work = np.zeros(loop.width)
    loop.enter(y0, work, p, h)
    return loop, work, p


def arrangement(top: Top) -> Arrangement:
    return arrangement_of(len(top.components), quotients(top.euler_poisson())[0][2])


def test_every_arrangement_is_tried() -> None:
    assert {arrangement(top) for top in TOPS_TRIED} == {FREE, GENERAL, SYMMETRIC}


def fuses() -> bool:
    """True if this processor has a fused multiply-add; the twin depends on it."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    return features.get("fma", not llvm.get_process_triple().startswith(("x86", "i386", "i686")))


def follow(top: Top, tol: float, work, out, h: float, steps: int, every: int, fuse: bool | None = None) -> int:
    """The twin, executed in plain Python."""
    order, fuse = order_for(tol), fuses() if fuse is None else fuse
    d = len(top.components)
    return advance(
        arrangement(top),
        d,
        order,
        work,
        out,
        h,
        steps,
        every,
        1,
        extended_precision=extended_precision(order),
        fuse=fuse,
    )


@pytest.mark.slow
@of_every_top
@pytest.mark.parametrize(("tol", "h", "steps"), [(1e-16, 0.25, 12), (1e-4, -1.7, 3), (1e-7, 1e-3, 900)])
def test_machine_code_equals_plain_python(top: Top, tol: float, h: float, steps: int) -> None:
    """Bit for bit: all that is recorded, and all that the loop keeps."""
    y0, every = gen(top), max(1, steps // 4)
    loop, work, p = prepared(top, y0, h, tol)
    mine, d = work.copy(), len(y0)
    out, plain = np.zeros((2, 12 * d))
    assert loop.drive(work, out, p, h, steps, every, 1) == steps
    assert follow(top, tol, mine, plain, h, steps, every) == steps
    assert (out == plain).all()
    assert (work == mine).all()
    assert np.count_nonzero(out)


@pytest.mark.slow
@pytest.mark.parametrize(("cpu", "fuse"), [("x86-64", False), ("x86-64-v3", True), ("x86-64-v4", True)])
@pytest.mark.parametrize("top", [Kowalevski(), Heavy(), Euler()], ids=repr)
def test_other_processors_give_the_same_bits(cpu: str, fuse: bool, top: Top, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled for narrower vectors, and without fused multiply-add, as far as this processor runs that."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    needs = {"x86-64": (), "x86-64-v3": ("avx2", "fma"), "x86-64-v4": ("avx512f", "avx512dq", "avx512vl")}[cpu]
    if not llvm.get_process_triple().startswith("x86_64") or not all(features.get(word) for word in needs):
        pytest.skip(f"this processor does not run code for {cpu}")
    native._machine()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=cpu, opt=3, jit=True, reloc="static", codemodel="jitdefault"
    )
    monkeypatch.setattr(native, "_target_machine", lambda: machine)
    monkeypatch.setattr(native, "stored_code", lambda words, signature: None)
    monkeypatch.setattr(native, "store_code", lambda *stored: None)
    y0, h = gen(top), 0.4
    loop, work, p = prepared(top, y0, h, 1e-9)
    mine, d = work.copy(), len(y0)
    out, plain = np.zeros((2, 8 * d))
    assert loop.drive(work, out, p, h, 8, 1, 1) == 8
    assert follow(top, 1e-9, mine, plain, h, 8, 1, fuse) == 8
    assert (out == plain).all()
    assert (work == mine).all()


@of_every_top
def test_coefficients_are_the_derivatives(top: Top) -> None:
    """The recurrence against sums of products formed one by one."""
    alpha, beta, delta = quotients(top.euler_poisson())
    a, d = arrangement(top), len(top.components)
    pad = (0.0,) * (a.lanes - 3)
    o = Plain(a.lanes)
    ones = (1.0, 1.0, 1.0, 0.0, 0.0) if d == 6 else (0.0,)
    y0 = a.to_lanes(gen(top))
    expand(o, a, 12, (y0, None), ((*alpha, *ones), (*beta, *pad), (*delta, *pad)), -40.0)
    y = [list(map(float, gen(top))) + [0.0] * (6 - d)]
    for m in range(12):
        new = [0.0] * 6
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for n in range(m + 1):
                new[i] += alpha[i] * y[n][j] * y[m - n][k] / (m + 1)
                new[3 + i] += (y[n][3 + j] * y[m - n][k] - y[n][3 + k] * y[m - n][j]) / (m + 1)
            new[i] += (beta[i] * y[m][3 + j] + delta[i] * y[m][3 + k]) / (m + 1)
        y.append(new)
        assert o.load("a", m + 1) == pytest.approx(a.to_lanes(new[:d]), rel=1e-12, abs=1e-14)


@pytest.mark.slow
@of_every_top
@pytest.mark.parametrize(("h", "N"), [(0.01, 2000), (20.0, 1), (-0.7, 30), (math.pi, 7)])
def test_taylor_follows_the_reference_to_round_off(top: Top, h: float, N: int) -> None:
    """Against the reference: a random walk of ulps, amplified by the motion no more than its own length."""
    y0 = gen(top)
    mine = after(top, y0, h, N, max(1, N // 50))
    n = np.arange(1, N + 1)[:: max(1, N // 50)] if N < 50 else np.arange(N // 50, N + 1, N // 50)
    exact = reference_states(top, y0, n * h)
    chaos = 50.0 if top.kind == "heavy" else 1.0
    assert np.abs(mine - exact).max() < 4e-14 * chaos * (1.0 + abs(N * h) / 10.0)


def test_a_coarse_tolerance_fails_the_same_test() -> None:
    top = Kowalevski()
    exact = reference_states(top, GEN, np.array([20.0]))
    assert np.abs(after(top, GEN, 20.0, 1, tol=1e-8) - exact).max() == pytest.approx(3e-09, rel=0.05)


@pytest.mark.parametrize("top", [Euler(), EulerGamma(), LagrangeInertial(), Lagrange(A=1.4, C=2.1, mu=-0.8)], ids=repr)
def test_taylor_agrees_with_closed_forms(top: Top) -> None:
    exact = find_scheme("exact", top.form)
    for y0 in random_states(3, seed=2)[:, : len(top.components)]:
        closed = states(Run(top, exact.build(top, exact.options()), y0, 0.5, 60))
        assert np.abs(states(Run(top, taylor(top), y0, 0.5, 60)) - closed).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("top", [Kowalevski(), Heavy(), EulerGamma(), Lagrange(), Euler()], ids=repr)
def test_the_error_follows_the_tolerance(top: Top) -> None:
    y0, tolerances = gen(top), 10.0 ** -np.arange(3.0, 16.0)
    exact = reference_states(top, y0, np.array([5.0]))[0]
    errors = np.array([np.abs(after(top, y0, 5.0, 1, tol=tol)[0] - exact).max() for tol in tolerances])
    assert (errors < 300.0 * tolerances + 1e-13).all()
    assert 5e-5 < errors[0] < 0.0012  # a loose one is made use of
    counts = []
    for tol in tolerances:
        run = Run(top, taylor(top, tol), y0, 5.0, 1)
        list(run)
        assert run.ending is not None
        counts.append(run.ending.counters["expansions"])
    assert counts[-1] < 50
    per_order = [counts[i] for i in range(len(counts)) if order_for(tolerances[i]) == ORDERS[0]]
    assert sorted(per_order) == per_order


def test_order_grows_with_the_digits() -> None:
    orders = [order_for(10.0**-k) for k in range(20)]
    assert orders == sorted(orders)
    assert {*orders} <= {*range(ORDERS[0], ORDERS[1] + 1, 4)}
    assert order_for(0.0) == ORDERS[1]


@pytest.mark.slow
@of_every_top
def test_dense_output_is_where_other_steps_lead(top: Top) -> None:
    """Values of the series between its centres equal those of a run with another h at the same time."""
    y0 = gen(top)
    fine = after(top, y0, 0.0078125, 1280, 128)
    for h, N in ((1.0, 10), (0.25, 40)):
        assert np.abs(after(top, y0, h, N, round(1.0 / h)) - fine).max() < 4e-13


def test_recording_less_changes_nothing() -> None:
    top = Heavy()
    every = after(top, GEN, 0.03, 1001)
    assert (after(top, GEN, 0.03, 1001, 13) == every[12::13]).all()


def test_resumed_equals_whole() -> None:
    """Calls of any length go on where the last one stopped: the same bits as one call."""
    top, h = Kowalevski(), 0.37
    loop, work, p = prepared(top, np.array(GEN), h)
    whole, parts = np.zeros((100, 6)), np.zeros((100, 6))
    other = work.copy()
    assert loop.drive(work, whole.reshape(-1), p, h, 100, 1, 1) == 100
    done = 0
    for steps in itertools.cycle((1, 7, 2, 30)):
        steps = min(steps, 100 - done)
        loop.drive(other, parts[done:].reshape(-1), p, h, steps, 1, 1)
        done += steps
        if done == 100:
            break
    assert (parts == whole).all()
    assert (work == other).all()


def test_a_long_step_is_left_and_taken_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step of more expansions than the budget returns in between, so that an interrupt is heard."""
    top, h = Kowalevski(), 50.0
    loop, work, p = prepared(top, np.array(GEN), h)
    whole = np.zeros(12)
    assert loop.drive(work, whole, p, h, 2, 1, 1) == 2
    monkeypatch.setattr(loop_text, "MAX_EXPANSIONS", 9)
    loop, work, p = prepared(top, np.array(GEN), h)
    part = np.zeros(6)
    returned = []
    while sum(returned) < 1:
        returned.append(loop.drive(work, part, p, h, 1, 1, 1))
    assert len(returned) > 5
    assert (part == whole[:6]).all()
    assert np.array_equal(states(Run(top, taylor(top), GEN, h, 2))[1:].ravel(), whole)


@pytest.mark.parametrize("scale", [1e-90, 1e-8, 1e8, 1e90])
def test_units_of_time_do_not_matter(scale: float) -> None:
    """A faster top is the same top in other units of time: powers of two give the same bits."""
    factor = 2.0 ** round(math.log2(scale))
    slow, fast = Heavy(), Heavy(x0=1.0 * factor**2, y0=0.5 * factor**2, z0=0.8 * factor**2)
    assert (slow.x0, slow.y0, slow.z0) == (1.0, 0.5, 0.8)
    y0 = np.array(GEN)
    quick = y0.copy()
    quick[:3] *= factor
    found = after(fast, quick, 0.3 / factor, 40)
    found[:, :3] /= factor
    assert (found == after(slow, y0, 0.3, 40)).all()


@pytest.mark.slow
def test_the_first_coefficient_is_to_more_than_a_double(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounded, as the others, it would make twice the error."""
    top, y0 = Lagrange(), random_states(24, seed=3)
    exact = [reference_states(top, y, np.array([100.0]))[0] for y in y0]

    def error() -> float:
        errors = [np.abs(after(top, y, 100.0, 1)[0] - true).max() for y, true in zip(y0, exact, strict=True)]
        return float(np.exp(np.mean(np.log(errors))))

    carefully = error()
    monkeypatch.setattr("topcli.schemes.any_top.taylor.extended_precision", lambda order: False)
    assert carefully < 0.7 * error()


def test_taylor_on_the_papers_scene() -> None:
    top = Kowalevski()
    n = np.arange(1, 51)
    exact = reference_states(top, PAPER, n * 1.0)
    assert np.abs(after(top, PAPER, 0.001, 50_000, 1000) - exact).max() < 5e-8  # round-off, amplified a million times


@pytest.mark.parametrize("top", [Kowalevski(), Heavy(), EulerGamma()], ids=repr)
def test_integrals_stay_at_round_off(top: Top) -> None:
    """Over t = 2e4, some 5e4 series: 50 ulp times the square root of their number is 2.5e-12; seen are 2e-14."""
    found = after(top, GEN, 0.5, 40_000, 10)
    for invariant in top.invariants():
        values = invariant.value(found)
        assert np.abs(values - values[0]).max() < 8e-14 * invariant.scale(found).max()


def test_coarse_tolerance_loses_the_integrals() -> None:
    top = Kowalevski()
    found = after(top, GEN, 0.5, 40_000, 10, tol=1e-12)
    values = top.invariants()[0].value(found)
    assert np.abs(values - values[0]).max() == pytest.approx(3.14e-11, rel=0.05)


def test_equilibria_rest() -> None:
    assert (after(Euler(), (0.0, 0.0, 0.0), 1e3, 3) == 0.0).all()
    upright = (0.0, 0.0, 1.3, 0.0, 0.0, 1.0)
    assert (after(Lagrange(), upright, 7.0, 5) == upright).all()
    hanging = (0.0, 0.0, 0.0, -1.0, 0.0, 0.0)
    assert (after(Kowalevski(), hanging, 7.0, 5) == hanging).all()


def ending(top: Top, y0, h: float, N: int):
    run = Run(top, taylor(top), y0, h, N)
    list(run)
    return run.ending


@pytest.mark.slow
@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("top", TOPS_TRIED[:6], ids=repr)
def test_a_state_that_is_not_finite_ends_the_run(top: Top, bad: float) -> None:
    y0 = gen(top)
    y0[1] = bad
    assert (ending(top, y0, 0.1, 5).outcome, ending(top, y0, 0.1, 5).step) == (Outcome.BLEW_UP, 1)


def test_immense_step_is_refused() -> None:
    assert ending(Kowalevski(), GEN, 1e16, 2).outcome is Outcome.NO_CONVERGENCE


def test_taylor_cannot_be_composed() -> None:
    with pytest.raises(UsageError, match="'taylor' cannot be composed: it is not self-adjoint"):
        find_scheme("taylor+suzuki4", "kowalevski")
