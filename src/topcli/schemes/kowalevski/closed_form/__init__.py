"""Closed form of the motion of the Kowalevski top by separation of variables.

The motion separates into two hyperelliptic integrals of genus two. From a state follow its integrals and the roots of
its ``curve``, the two real ovals (``oval``) with their half periods in multiprecision, a ``table`` of each in double
precision, the ``course`` of both angles in time, and the ``motion``, which gives states. ``set_up`` does all that.
"""

from topcli.contracts import Floats
from topcli.schemes.kowalevski.closed_form.course import EPS
from topcli.schemes.kowalevski.closed_form.motion import Motion

__all__ = ["EPS", "Motion", "set_up"]


def set_up(y: Floats, c: float) -> Motion:
    """Motion from the state ``y`` (6,); omega and c gamma should be of the order of one. Raises RunError."""
    from topcli.schemes.kowalevski.closed_form import setup  # imports mpmath

    return setup.set_up(y, c)
