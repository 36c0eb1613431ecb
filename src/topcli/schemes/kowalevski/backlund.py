"""Integrable discretization of the Kowalevski top: two Bäcklund transformations at once, in rational form.

The step (``backlund_step``) maps each torus of the continuous top to itself and is a translation on it: it conserves
gamma², 2l, E and k², is Poisson, commutes with the flow and with steps of other lengths, and has a discrete Lax pair
(``analysis.lax``). Its parameter tau depends on h and the four integrals (``backlund_parameters``).

**Constants.** Frozen, tau is computed once, from the initial state. On the surface tau(y) = tau this is the same map;
off it, a deviation of the integrals by round-off contracts, because the surface attracts. Recomputed from the current
state, the map is Poisson everywhere, but nothing contracts, and deviations of the integrals grow linearly.

**Exact nodes.** Steps commute, and each is a flow of E and of k² for times that its length determines. Forward steps
and one backward step are therefore the motion itself if their lengths satisfy two equations (``backlund_parameters``,
``backlund_step``).

**Working states.** A run of steps of one length carries tau itself, which costs nothing. Compositions, whose stages
have different lengths, and substeps carry the constants from which each stage computes its own tau, off the critical
path.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from pydantic import Field, model_validator

from topcli.arithmetic.vectors import dot, subtract
from topcli.contracts import Floats, Integrability, StepFunction, Stepper, Top
from topcli.schemes.kowalevski.backlund_parameters import (
    SHORTEST,
    admits,
    frozen_constants,
    longest_composition,
    longest_step,
    rounded_tau,
    tau_at,
    tau_of,
)
from topcli.schemes.kowalevski.backlund_step import (
    NODES,
    PARTS,
    physical_change,
    physical_step,
    scaled_change,
    scaled_step,
    substeps_of,
)
from topcli.schemes.kowalevski.four_integrals import INTEGRALS, sizes, target_values
from topcli.schemes.kowalevski.projected import COUNTERS, project
from topcli.schemes.layout import CompensatedOption, stepper
from topcli.schemes.registry import scheme

PROJECTED_NODES = 16
"""Steps with exact nodes from one projection to the next: without it deviations grow for some states."""
Tau = Callable[[Floats, float, float], float]
Advance = Callable[[Floats, float, float, float], Floats]
DOMAIN = "h is longer than round-off allows, and is refused before the run."


class BacklundOptions(CompensatedOption):
    """Options: compensated sums, integrals in the step, exact nodes, projection, substeps."""

    constants: Literal["frozen", "recomputed"] = Field(
        default="frozen",
        description="integrals that the step depends on: those of the initial state, so that deviations contract, or "
        "those of the current state (recomputed), so that the map is Poisson everywhere",
    )
    nodes: Literal["plain", "exact"] = Field(
        default="plain",
        description="one step of length h, or three or four forward steps and one backward step whose lengths make h "
        "the motion itself, without discretization error (exact)",
    )
    project: int | None = Field(
        default=None,
        ge=0,
        description="steps from one projection onto all four integrals of the initial state to the next; 0: none; "
        "if not given, 16 with exact nodes and otherwise none",
    )
    substeps: Literal[1, "auto"] = Field(
        default=1,
        description="equal steps per h; auto: as few as the longest admissible step allows (1 refuses a longer h)",
    )

    @model_validator(mode="after")
    def _compatible(self) -> BacklundOptions:
        if self.nodes == "exact" and self.constants != "frozen":
            raise ValueError("nodes: exact needs constants: frozen")
        if self.nodes == "exact" and self.compensated:
            raise ValueError("nodes: exact has no compensated form; its steps are projected instead")
        return self

    @property
    def period(self) -> int:
        """Steps from one projection to the next; 0 for none."""
        if self.project is None:
            return PROJECTED_NODES if self.nodes == "exact" else 0
        return self.project


def frozen_step(s: Floats, h: float, p: Floats) -> Floats:
    """One step of a run with steps of one length: scaled omega, gamma; tau; the status."""
    z = (s[0], s[1], s[2], s[3], s[4], s[5])
    return (*scaled_step(z, (0.125 * p[0]) * (h * h), s[6]), s[6], s[7])


def enter_frozen(y: Floats, h: float, p: Floats) -> Floats:
    """Scaled omega, gamma; tau; the status: 0.0, or nan if the step is too long or too short."""
    low, high, weight, moment, size = frozen_constants(y, p)
    fits = abs(h) >= SHORTEST and admits(h, low, high, weight, moment)
    tau = rounded_tau(tau_of(h, low, high, weight, moment), h * h * size) if fits else math.nan
    k = -0.5 * h
    return (k * y[0], k * y[1], (0.5 * k) * y[2], y[3], y[4], y[5], tau, 0.0 if fits else math.nan)


def leave_frozen(s: Floats, h: float, p: Floats) -> Floats:
    """Physical state; divided, because the error of a factor 1/h would be the same in every row."""
    k = -0.5 * h
    return (s[0] / k, s[1] / k, s[2] / (0.5 * k), s[3], s[4], s[5])


def enter_stage(y: Floats, h: float, p: Floats) -> Floats:
    """Physical state; the frozen constants and the longest step."""
    constants = frozen_constants(y, p)
    return (*y, *constants, longest_step(*constants[:4]))


def stage_tau(s: Floats, h: float, c: float) -> float:
    """Parameter of a step of any length, from the frozen constants."""
    return rounded_tau(tau_of(h, s[6], s[7], s[8], s[9]), h * h * s[10])


def enter_recomputed(y: Floats, h: float, p: Floats) -> Floats:
    """Physical state; the longest step."""
    return (*y, longest_step(*frozen_constants(y, p)[:4]))


def recomputed_tau(s: Floats, h: float, c: float) -> float:
    """Parameter of a step of any length, from the current state."""
    return tau_at(s[:6], h, c)


def of_any_length(tau: Tau, longest: int, advance: Advance) -> StepFunction:
    """Image of omega and gamma under ``advance`` with the parameter ``tau``, and the status: nan for a step too long.

    ``longest`` is the slot of the longest step.
    """

    def advanced(s: Floats, h: float, p: Floats) -> Floats:
        fits = SHORTEST <= abs(h) <= s[longest]
        parameter = tau(s, h, p[0]) if fits else math.nan
        status = 0.0 if fits else math.nan
        return (*advance(s[:6], h, p[0], parameter), status)

    return advanced


def frozen_change(s: Floats, h: float, p: Floats) -> Floats:
    """Change of scaled omega and gamma, which tau follows; the status."""
    status = 0.0 if s[6] == s[6] else math.nan
    return (*scaled_change(s[:6], (0.125 * p[0]) * (h * h), s[6]), status)


def enter_changed(y: Floats, h: float, p: Floats) -> Floats:
    """Scaled omega, gamma; tau."""
    return enter_frozen(y, h, p)[:7]


def made(
    step: StepFunction, kept: int, enter: StepFunction, leave: StepFunction | None = None, compensated: bool = False
) -> Stepper:
    """Stepper of new states, or of their changes if ``compensated``: then it carries the rounding errors of the sums.

    The changes are of size h, and so are their rounding errors. After 1e6 steps, deviations of the integrals are
    smaller by a factor of 32 at h = 0.01 and of 2.1 at h = 0.1 (``benchmarks/documented.py compensated``); at h = 0.5
    the changes are as large as the state, and nothing is gained. A step takes 1.16 times as long.
    """
    lost, adds = range(6 * compensated), compensated
    return stepper(step, 6, kept, lost=lost, adds=adds, iterative=True, checked=6, enter=enter, leave=leave)


FROZEN_LONGEST, RECOMPUTED_LONGEST, NODES_LONGEST = 11, 6, 19
"""Slot of the longest step in the working states."""
STAGE = made(of_any_length(stage_tau, FROZEN_LONGEST, physical_step), 6, enter_stage)
CHANGED_STAGE = made(of_any_length(stage_tau, FROZEN_LONGEST, physical_change), 6, enter_stage, compensated=True)
FROZEN = Stepper(frozen_step, 8, enter_frozen, leave_frozen, iterative=True, checked=6, composable=STAGE)
COMPENSATED = replace(made(frozen_change, 1, enter_changed, leave_frozen, True), composable=CHANGED_STAGE)
RECOMPUTED = made(of_any_length(recomputed_tau, RECOMPUTED_LONGEST, physical_step), 1, enter_recomputed)
COMPENSATED_RECOMPUTED = made(
    of_any_length(recomputed_tau, RECOMPUTED_LONGEST, physical_change), 1, enter_recomputed, compensated=True
)


def substepped(method: Stepper, longest: int) -> Stepper:
    """Stepper that divides h into the least number of equal steps within the domain, ``substeps_of``.

    ``longest`` is the slot of the longest step.
    """
    step = method.step

    def divided(s: Floats, h: float, p: Floats) -> Floats:
        count = substeps_of(h, s[longest])
        part = h / count
        for _ in range(count):
            s = step(s, part, p)
        return s

    return replace(method, step=divided)


def projected(method: Stepper, period: int) -> Stepper:
    """Stepper that restores the four integrals of the initial state after every ``period`` steps.

    Adds the target values, the number of steps to the next projection, and the counters of ``projected_step``.
    """
    step, inner, first = method.step, method.width - 1, method.enter

    def restoring(s: Floats, h: float, p: Floats) -> Floats:
        w = step((*s[:inner], s[inner + 5]), h, p)
        t = (s[inner], s[inner + 1], s[inner + 2], s[inner + 3])
        left = s[inner + 4] - 1.0
        y = (w[0], w[1], w[2], w[3], w[4], w[5])
        corrections, short, unmet = s[inner + 6], s[inner + 7], s[inner + 8]
        if left <= 0.0:
            left = float(period)
            change = subtract(y, s)
            reach = min(1.0, (h * h) * sizes(y, p[0])[2])
            z, more, cut, missed = project(y, (reach * reach) * dot(change, change), p[0], t)
            y = (z[0], z[1], z[2], z[3], z[4], z[5])
            corrections += more
            short += cut
            unmet += missed
        return (*y, *w[6:inner], *t, left, w[inner], corrections, short, unmet)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        assert first is not None
        *begun, status = first(y, h, p)
        return (*begun, *target_values(y, p), float(period), status, 0.0, 0.0, 0.0)

    return replace(method, step=restoring, width=method.width + 8, enter=enter, counters=COUNTERS)


def domain(top: Top, y0: Floats, options: BacklundOptions) -> float:
    """Length of the longest step from ``y0``; substeps remove the limit unless there is no step at all."""
    constants = frozen_constants(y0, top.constants())[:4]
    longest = longest_composition(constants) if options.nodes == "exact" else longest_step(*constants)
    return math.inf if options.substeps == "auto" and longest > 0.0 else longest


@scheme(
    "backlund",
    top="kowalevski",
    title="Bäcklund transformation, an integrable map",
    order=2,
    explicit=True,
    self_adjoint=True,
    conserves=INTEGRALS,
    citation="after Kuznetsov, Vanhaecke 2000 (Bäcklund transformations); Bobenko, Reyman, Semenov-Tian-Shansky 1989 "
    "(Lax pair)",
    integrable=Integrability("5x5, L' U = U L", "Lie-Poisson bracket of e(3)", "lie-poisson"),
    formula=r"""
L'(\lambda)\,U(\lambda) = U(\lambda)\,L(\lambda), \qquad
(a, b, n) = -\tfrac h2\,(\omega_1, \omega_2, \tfrac12\omega_3), \quad d = \tfrac18 c h^2\,\gamma, \quad t = 2 - \tau

\begin{aligned}
(t - d_1)\,x - d_2\,y - a\,z &= b - d_3\\
-d_2\,x + (t + d_1)\,y - (b + d_3)\,z &= -a\\
a\,x + (b - d_3)\,y + (2 + t - d_1)\,z &= 2n + d_2
\end{aligned}
\qquad e = (1;\ y, -x, -z), \qquad \gamma' \text{ and } \omega' \text{ rational in } e
""",
    equations="L' U = U L with the 5x5 Lax matrix L, U the product of two dressing matrices with poles at ±2/h",
    options=BacklundOptions,
    limits={
        "resonance": DOMAIN,
        "singular-step": DOMAIN,
        "long steps": "h is refused before the run if it exceeds 5/sqrt(2E + 2k) or 5/sqrt|c gamma|, or if, for it or "
        "a shorter step, 1 - S + P (see An integrable discrete Kowalevski top) is below 1/32. Up to "
        "there round-off is safe; the map itself exists for some longer steps too. For tops with energies large "
        "against gravity this is 0.98 of 4/sqrt(2E + 2k) or less. A member of an ensemble ends as `no_convergence` at "
        "step 1.",
        "compositions": "Backward stages let deviations grow. With kahan-li8 the integrals of some motions, 1 to 2 of "
        "12 random ones, are lost within 2e4 steps of a third of the longest or more. `project: 16` prevents it.",
        "tiny steps": "A step below 1e-290 in size ends as `no_convergence`: omega times h would lose digits.",
        "spin about the third axis": "With k between about E/30 and E/8, where the spin about the third axis prevails, "
        "deviations grow instead of contracting for |h omega3| between about 2.9 and 3.3, and all integrals are lost "
        "within 1e5 steps: 1 of 300 random states at 0.8 of the longest step, 2 at 0.9, none at the longest. `project: "
        "16` prevents it.",
        "hanging top": "Within about 1e-2 of the hanging equilibrium deviations hardly contract: with h beyond "
        "0.1/sqrt(c) the small 2l deviates by more than round-off after 1e5 steps. `project: 16` prevents it.",
        "no gravity": "With c0 = 0 omega rotates uniformly, and the rounding errors of gamma recur with it: after 1e5 "
        "steps gamma² deviates by up to 15 times the bound of round-off. `project: 16` prevents it.",
        "exact nodes": "The longest h is 0.8 to 2.2 times that of a plain step, 1.6 in the median. Setting up an "
        "initial state takes 3 to 20 ms, also for each member of an ensemble. If the first step differs from the "
        "motion by more than 1e-12, or E or k² later deviates by more than 1e-11 of the size of its terms, the run "
        "ends as `no_convergence`. Without projection (`project: 0`), members of an ensemble are three times as fast, "
        "but the integrals of some motions with long steps deviate within 1e5 steps.",
        "recomputed constants": "Deviations of the integrals by round-off do not contract and grow linearly; with long "
        "steps they are visible after 1e5 steps.",
    },
    longest_step=domain,
    order_with=lambda options: None if options.nodes == "exact" else 2,
)
def build(top: Top, options: BacklundOptions) -> Stepper:
    """Integrable map: a translation on the tori of the continuous motion, explicit and rational.

    All four integrals are conserved, the map is Poisson, commutes with the motion and with steps of other lengths, and
    has a discrete Lax pair; we know of no earlier one for this top. Its only error is one of time: the orbit is exact.
    A step is one 3x3 linear system and one rotation, with one division. The length h enters through a constant that
    depends on the integrals. It is computed once (`constants: frozen`), so that deviations of the integrals by
    round-off contract. With `project: K`, the initial values of all four integrals are restored after every K steps
    (stages of a composition) by the shortest correction. Steps so long that round-off is not safe, beyond
    3.6/sqrt(2E + 2k) to 5/sqrt(2E + 2k) depending on the state, are refused, or divided (`substeps: auto`).

    With `compensated: true`, deviations of the integrals after 1e6 steps are smaller by a factor of 32 at h = 0.01 and
    of 2.1 at h = 0.1 (medians of 20 random states; quartiles 22 to 58 and 1.4 to 2.8); h = 0.5 gains nothing. A step
    takes 1.16 times as long.

    With `nodes: exact` there is no error of time either. A step then consists of three or four steps of one length and
    one backward step of another; two equations make their composition the motion over h. The first step is compared
    with Taylor series of 26 terms in integers of 96 bits, and E and k² are watched during the run.
    """
    if options.nodes == "exact":
        method, longest = PARTS if options.substeps == "auto" else NODES, NODES_LONGEST
    elif options.constants == "frozen":
        method, longest = COMPENSATED if options.compensated else FROZEN, FROZEN_LONGEST
    else:
        method, longest = COMPENSATED_RECOMPUTED if options.compensated else RECOMPUTED, RECOMPUTED_LONGEST
    if options.substeps == "auto":
        method = substepped(method.composable or method, longest)
    return projected(method.composable or method, options.period) if options.period else method
