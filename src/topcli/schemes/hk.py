"""The scheme of Hirota and Kimura (Kahan's method) for the Kowalevski top.

What makes it fast:
- the 6x6 system shrinks to one 2x2 system in closed form: 50 products, most of them fused with a sum, two divisions;
- every component is old + change, with what the determinant does not decide ready before it is known;
- scaled by h/2 inside the step only: the state stays physical, resumes bit for bit, and c = 0 is no special case.
"""

from __future__ import annotations

from topcli.contracts import Stepper, Top
from topcli.kernels.hk_determinant import kowalevski_determinant
from topcli.kernels.hk_kowalevski import hk_kowalevski
from topcli.kernels.hk_refined import hk_kowalevski_refined
from topcli.kernels.increments import first6
from topcli.schemes.compensated import CompensatedOption, compensation_wanted, enter_compensated
from topcli.schemes.counting import NEAR_SINGULAR, counting, small_determinant
from topcli.schemes.limits import LONG_HK, SINGULAR
from topcli.schemes.registry import scheme


@scheme(
    "hk",
    top="kowalevski",
    title="Hirota-Kimura scheme",
    order=2,
    explicit=True,
    self_adjoint=True,
    citation="Hirota, Kimura 2000; Kimura, Hirota 2000; Sogo, Discrete Spinning Tops, section 3.2.1",
    equations="dEulerPoisson, with the last term of its last line corrected to gamma_2^n omega_1^{n+1}",
    options=CompensatedOption,
    limits={"singular-step": SINGULAR, "resonance": LONG_HK},
)
def build(top: Top, options: CompensatedOption) -> Stepper:
    """Linear in the new state, solved in closed form.

    Every quadratic term y z of the field becomes (y' z + y z')/2, every linear term its mean. The step is its own
    inverse under h -> -h. It conserves none of the four integrals exactly; their deviations stay bounded, of size h².
    Compensated, what the change of gamma rounds is carried along as well.
    """
    if compensation_wanted(options):
        stepper = Stepper(hk_kowalevski_refined, 12, enter_compensated, first6, checked=6)
    else:
        stepper = Stepper(hk_kowalevski, 6)
    return counting(stepper, NEAR_SINGULAR, small_determinant(kowalevski_determinant))
