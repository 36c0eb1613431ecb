"""Integrable discretization of the Kowalevski top: two Bäcklund transformations at once, in rational form.

The step (``backlund_step``) maps each torus of the continuous top to itself and is a translation on it: it conserves
gamma², 2l, E and k², is Poisson, commutes with the flow and with steps of other lengths, and has a discrete Lax pair
(``analysis.lax``). Its parameter tau depends on h and the four integrals (``backlund_parameters``).

**Constants.** Frozen, tau is computed once, from the initial state. On the surface tau(y) = tau this is the same map;
off it, a deviation of the integrals by round-off contracts, because the surface attracts. Recomputed from the current
state, the map is Poisson everywhere, but deviations do not contract: those of the integrals grow linearly.

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
DOMAIN = "The h of this case is so long that round-off would spoil the integrals; the run is refused before its start."


class BacklundOptions(CompensatedOption):
    """Options: compensated sums, integrals in the step, exact nodes, projection, substeps."""

    constants: Literal["frozen", "recomputed"] = Field(
        default="frozen",
        description="integrals from which the constant tau of the step is computed: those of the initial state "
        "(frozen: deviations by round-off decay), or those of the current state (recomputed: the step is a Poisson map "
        "everywhere)",
    )
    nodes: Literal["plain", "exact"] = Field(
        default="plain",
        description="division of h: one step of length h (plain), or three or four steps forward and one backward that "
        "together have no discretization error (exact)",
    )
    project: int | None = Field(
        default=None,
        ge=0,
        description="number of steps from one projection onto the four integrals of the initial state to the next; 0 "
        "means no projection; null means 16 with exact nodes and 0 without",
    )
    substeps: Literal[1, "auto"] = Field(
        default=1,
        description="number of equal steps into which h is divided: 1 (an h that is too long is refused), or as few as "
        "possible (auto)",
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
    smaller by a factor of 32 at h = 0.01 and of 2.1 at h = 0.1; at h = 0.5 the changes are as large as the state, and
    nothing is gained. A step takes 1.16 times as long.
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

e = (1;\ y, -x, -z), \qquad \gamma' \text{ and } \omega' \text{ rational in } e
""",
    equations="L' U = U L with the 5x5 Lax matrix L, U the product of two dressing matrices with poles at ±2/h",
    options=BacklundOptions,
    limits={
        "resonance": DOMAIN,
        "singular-step": DOMAIN,
        "long steps": "A run is refused if its h exceeds 5/sqrt(2E + 2k) or 5/sqrt|c gamma|. A run is also refused if "
        "1 - S + Π is below 1/32 for h or for a shorter step (the page An integrable discrete Kowalevski top defines S "
        "and Π). Up to these limits round-off does no harm; the map itself exists for some longer steps too. If the "
        "energy is large compared with gravity, the longest h is 0.98 times 4/sqrt(2E + 2k) or less. In an ensemble, a "
        "motion for which h is too long ends as `no_convergence` at step 1.",
        "compositions": "A composition contains backward steps, and these let deviations of the integrals grow. With "
        "the composition kahan-li8 and an h of at least a third of the longest h, the integrals of 1 or 2 of 12 random "
        "motions are lost within 2e4 steps. The option `project: 16` prevents this.",
        "tiny steps": "If |h| is below 1e-290, the run ends as `no_convergence`, because omega times h would lose "
        "digits.",
        "spin about the third axis": "If k is between about E/30 and E/8, the body mainly spins about the third axis. "
        "If then |h omega3| is between about 2.9 and 3.3, deviations of the integrals grow instead of shrinking, and "
        "all integrals are lost within 1e5 steps. Of 300 random motions, 1 lost its integrals with 0.8 times the "
        "longest step, 2 with 0.9 times the longest step, and none with the longest step. The option `project: 16` "
        "prevents this.",
        "hanging top": "Within a distance of about 1e-2 of the hanging equilibrium, deviations of the integrals "
        "hardly decrease. If h exceeds 0.1/sqrt(c), the integral 2l, which is small there, deviates by more than "
        "round-off after 1e5 steps. The option `project: 16` prevents this.",
        "no gravity": "Without gravity (c0 = 0), omega rotates uniformly, and the rounding errors of gamma repeat "
        "with each rotation. After 1e5 steps gamma² deviates by up to 15 times the bound expected for "
        "round-off. The option `project: 16` prevents this.",
        "exact nodes": "The longest h with exact nodes is 0.8 to 2.2 times the longest plain step, with a median of "
        "1.6. The set-up takes 3 to 20 ms for each initial state, also in an ensemble. The run ends as "
        "`no_convergence` if the first step differs from the exact motion by more than 1e-12, or if E or k² later "
        "deviates by more than 1e-11 times the size of its terms. Without projection (`project: 0`), an ensemble is "
        "three times as fast, but the integrals of some motions with long steps deviate within 1e5 steps.",
        "recomputed constants": "With `constants: recomputed`, deviations of the integrals due to round-off do "
        "not shrink but grow linearly. With long steps these deviations are visible after 1e5 steps.",
    },
    longest_step=domain,
    order_with=lambda options: None if options.nodes == "exact" else 2,
)
def build(top: Top, options: BacklundOptions) -> Stepper:
    """Each step is a translation on the torus of the exact motion, given by explicit rational formulas.

    The map conserves gamma², 2l, E and k², preserves the Poisson bracket, commutes with the exact motion and with steps
    of other lengths, and has a discrete Lax pair. We know of no earlier integrable map for this top. The states stay on
    the torus of the exact motion; only their position on this torus has an error.

    A step solves one 3x3 linear system, applies one rotation and needs only one division. The formulas contain a
    constant, tau, that depends on h and on the integrals. By default tau is computed once (`constants: frozen`);
    deviations of the integrals due to round-off then shrink. With `project: K`, the state is projected after every K
    steps (or stages of a composition): the shortest correction restores the initial values of all four integrals.
    Round-off spoils the integrals if h exceeds a limit that depends on the state and lies between 3.6/sqrt(2E + 2k) and
    5/sqrt(2E + 2k), or below these values near the hanging equilibrium. A longer h is refused, or divided into shorter
    steps (`substeps: auto`).

    With `compensated: true`, the deviations of the integrals after 1e6 steps are smaller by a factor of 32 at h = 0.01
    and of 2.1 at h = 0.1 (medians of 20 random states; quartiles 22 to 58 and 1.4 to 2.8). At h = 0.5 they are not
    smaller. A compensated step takes 1.16 times as long as a plain one.

    With `nodes: exact`, the position on the torus has no error either. A step then consists of three or four steps of
    one length and one backward step of another length. The two lengths are chosen such that these steps together are
    the exact motion over a time h. The first step is checked against a Taylor series of 26 terms, computed in 96-bit
    integer arithmetic; E and k² are checked during the run.
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
