"""The scheme of Hirota and Kimura (Kahan's method) for the general heavy top.

What makes it fast:
- the 6x6 system shrinks to one 3x3 system: gamma's change is Cayley's rotation plus a part linear in omega's;
- Cramer's rule for that, with all three columns from one reciprocal of 1 + |h omega/2|²; two divisions are waited for;
- what depends on the moments and h alone is computed once, before the loop.
"""

from __future__ import annotations

from topcli.contracts import Stepper, Top
from topcli.kernels.euler_poisson import hk_heavy_change
from topcli.kernels.hk_determinant import heavy_determinant
from topcli.schemes.compensated import CompensatedOption, increment_stepper
from topcli.schemes.counting import NEAR_SINGULAR, counting, small_determinant
from topcli.schemes.limits import LONG_HK, SINGULAR
from topcli.schemes.registry import scheme


@scheme(
    "hk",
    top="heavy",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    citation="Hirota, Kimura 2000; Kimura, Hirota 2000; Sogo, Discrete Spinning Tops, section 2.1",
    equations="dEulerPoisson, with the last term of its last line corrected to gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build(top: Top, options: CompensatedOption) -> Stepper:
    """Linear in the new state: gamma by Cayley's inverse, then three equations for omega, solved in closed form.

    It conserves none of the three integrals exactly; the deviations are of size h². Where a special top has a
    scheme `hk` of its own it is the same map, written faster.
    """
    return counting(increment_stepper(hk_heavy_change, 6, options), NEAR_SINGULAR, small_determinant(heavy_determinant))
