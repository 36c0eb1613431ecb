"""Hirota-Kimura scheme (Kahan's method) of every quadratic field, generated from the field (``topcli.field.implicit``).

``topcli show hk --top lagrange --source`` prints the step of a top.
Of a step of some motion the linear system is singular for certain lengths of the order of 1/|omega|. The determinant is
1 + O(h²), so that a small determinant shows such a step: the state then jumps far away. A top with an energy ends as
``left_motion`` or ``blew_up`` within a few steps; for a top without one, steps with a small determinant are counted.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

from topcli.contracts import Floats, Invariant, NoOptions, StepFunction, Stepper, Top
from topcli.field.implicit import KahanStep, KahanTangent, generated
from topcli.field.polynomial import required_field
from topcli.field.straight_line import compiled_function
from topcli.schemes.any_top.hk_integrals import euler_hk_integrals, lagrange_hk_integrals
from topcli.schemes.registry import linear_invariants, scheme
from topcli.schemes.steppers import stepper

_NEEDED_BY = "scheme 'hk'"
NEAR_SINGULAR = "near_singular_solves"
SMALL = 2.0**-10
"""Determinant, which is 1 at h = 0, below which a step is counted: three digits are lost to cancellation."""


def _tangent(top: Top) -> Stepper:
    """The step of ``top`` with its tangent map."""
    field = required_field(top, _NEEDED_BY, 2)
    code = generated(KahanTangent, field, len(top.constants()))
    return Stepper(compiled_function(code.graph, "tangent", code.outputs), 2 * len(field), constants=code.constants)


@lru_cache(maxsize=256)  # steppers that share the functions share their machine code
def with_counter(change: StepFunction, determinants: StepFunction, d: int) -> Stepper:
    """Stepper of d components that counts steps with a small determinant."""

    def counting(y: Floats, h: float, p: Floats) -> Floats:
        small = 0.0
        for determinant in determinants(y, h, p):
            if abs(determinant) < SMALL:
                small = 1.0
        return (*change(y, h, p), small)

    return stepper(counting, d, counters=(NEAR_SINGULAR,))


def modified(top: Top, h: float, options: NoOptions) -> tuple[Invariant, ...]:
    """Integrals of the map, as far as they are known."""
    if top.form in ("euler", "euler+gamma"):
        return euler_hk_integrals(top, h)
    if top.form in ("lagrange", "lagrange-gyrostat"):
        return lagrange_hk_integrals(top, h)
    return top.modified_invariants("hk", h)


@scheme(
    "hk",
    top=None,
    requires=partial(required_field, needed_by=_NEEDED_BY, degree=2),
    order=2,
    explicit=True,
    self_adjoint=True,
    conserves=linear_invariants,
    modified=modified,
    changes=True,
)
def build_hk(top: Top, options: NoOptions) -> Stepper:
    r"""Hirota-Kimura scheme (Kahan's method).

    Kahan's method for quadratic equations of motion: each step solves one linear system, in closed form.

    The code of the step is generated from the equations of motion. In these equations every product y z of two
    variables becomes (y' z + y z')/2, and every linear term y becomes the mean (y + y')/2; a prime marks a value after
    the step. The step is self-adjoint. HK conserves linear integrals; for small h the deviations of the other integrals
    are of size h². Some tops have modified integrals, which HK conserves exactly for every h.

    Source
    ------
    Kahan 1993; Hirota, Kimura 2000; Kimura, Hirota 2000; Petrera, Pfadler, Suris 2011 (integrability); Celledoni,
    McLachlan, Owren, Quispel, J. Phys. A 46 (2013) 025201; Sogo, Discrete Spinning Tops, sections 1.2, 2.1 and 3.2.1

    Equations
    ---------
    (dEulerPoisson) of the paper, with the last line corrected so that it ends with gamma_2^n omega_1^{n+1}; for any top
    (y' - y)/h = 2 f((y + y')/2) - f(y)/2 - f(y')/2

    Formula
    -------
    \frac{y_i' - y_i}{h} = \sum_{jk} a_{ijk}\,\tfrac12\,(y_j y_k' + y_j' y_k) + \sum_j b_{ij}\,\bar y_j + c_i, \qquad
    \dot y_i = \sum_{jk} a_{ijk}\,y_j y_k + \sum_j b_{ij}\,y_j + c_i

    J\,\frac{\omega' - \omega}{h} = \tfrac12\,(J\omega\times\omega' + J\omega'\times\omega) + \bar\gamma\times r, \qquad
    \frac{\gamma' - \gamma}{h} = \tfrac12\,(\gamma\times\omega' + \gamma'\times\omega)

    Limits
    ------
    singular-step (kowalevski, lagrange, heavy, euler, euler+gamma)
        For certain step sizes of the order of 1/|omega| and larger, the determinant of HK's linear system vanishes,
        and the state jumps far away: the run ends as `left_motion` or `blew_up`. Choose h such that |h| |omega| is
        well below 1.
    resonance (kowalevski, lagrange, heavy, euler, euler+gamma)
        If h is about the time of one revolution of the body, the determinant of HK's linear system changes sign
        along the motion. The state jumps far away whenever the determinant is close to zero. For the Euler top,
        terms of the linear system that are much larger than the change cancel, and the modified integrals deviate
        by up to ten times more than round-off of the state explains. With the vertical, m²/K and m·omega/K keep
        omega bounded, but the modified integral in place of gamma², a quadratic form in gamma, may be indefinite
        for such steps; gamma then grows without bound. The page Tops gives the exact condition.
    """
    field, d = required_field(top, _NEEDED_BY, 2), len(top.components)
    code = generated(KahanStep, field, len(top.constants()))
    of = partial(compiled_function, code.graph)
    change = of("change", code.changes())
    if any(invariant.name == top.energy for invariant in top.invariants()) or not code.determinants:
        plain = Stepper(of("step", code.outputs), d, change=change)
    else:
        plain = with_counter(change, of("determinants", code.determinants), d)
    return replace(plain, constants=code.constants, source=partial(code.source, "step"), tangent=partial(_tangent, top))
