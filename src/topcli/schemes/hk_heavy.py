"""The scheme of Hirota and Kimura (Kahan's method) for the general heavy top."""

from __future__ import annotations

from topcli.contracts import NoOptions, Stepper, Top
from topcli.kernels.euler_poisson import hk_heavy
from topcli.kernels.hk_determinant import heavy_determinant
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
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build(top: Top, options: NoOptions) -> Stepper:
    """Linear in the new state: gamma by Cayley's inverse, then three equations for omega, solved in closed form.

    It conserves none of the three integrals exactly; the deviations are of size h². Where a special top has a
    scheme `hk` of its own it is the same map, written faster.
    """
    return counting(Stepper(hk_heavy, 6), NEAR_SINGULAR, small_determinant(heavy_determinant))
