r"""Meaning of every symbol in the formulas of schemes and tops, for the tables below the formulas.

A symbol is a piece of LaTeX such as ``\omega`` or ``\bar\nabla``. Those of one scheme or top come before the general
ones, longer ones before shorter ones.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

GENERAL = {
    "h": "step size",
    "t": "time",
    "y": r"state: the vector of all variables of the top, such as the components of $\omega$ and $\gamma$",
    "f": r"right-hand side of the equations of motion, $\dot y = f(y)$",
    r"\omega": "angular velocity in the frame of the body",
    r"\gamma": "unit vector of the vertical, as seen from the body",
    "m": r"angular momentum, $(A\omega_1, B\omega_2, C\omega_3)$ with the principal moments of inertia $A$, $B$, $C$",
    "J": "diagonal matrix of the principal moments of inertia",
    "I_": "moment of inertia about principal axis $i$",
    "A": "first principal moment of inertia",
    "B": "second principal moment of inertia",
    "C": "third principal moment of inertia",
    "r": "weight times the vector from the fixed point to the centre of gravity",
    "c": "weight times the distance of the centre of gravity from the fixed point, divided by the third moment of "
    "inertia",
    "e_3": "unit vector of the third axis of the body",
    "e_i": "unit vector of axis $i$ of the body",
    r"\mu": "weight times the third coordinate of the centre of gravity",
    r"\mathrm{diag}": "diagonal matrix with the given entries",
    r"\xi": r"Kowalevski's variable, a complex number; $\lvert\xi\rvert^2 = k^2$ is Kowalevski's integral",
    "i": "imaginary unit, as a factor or in an exponent",
    "e^": "exponential function",
}
"""Symbols that mean the same on all pages."""

_INTEGRALS = r"integrals: $\gamma^2$, the angular momentum $2\ell$ about the vertical, the energy $E$, Kowalevski's "
_HK = "HK, the [Hirota-Kimura scheme](hk.md)"
_PROJECTION = {
    r"\Phi^{\mathrm{HK}}_h": f"a step of length $h$ of {_HK}",
    r"\nabla": "gradient with respect to the state",
    "I": _INTEGRALS + "$k^2$",
    "D": "matrix whose columns are the gradients of the four integrals",
    "x": "vector of four multipliers, found by Newton's method",
}
_HYBRID = {r"\mathrm{HK}": f"marks the state after a step of {_HK}"}
_GRAVITY = "{} component of the position of the centre of gravity"
_GYROSTAT = {
    "k": "angular momentum of the rotor",
    "c_0": "weight times the first coordinate of the centre of gravity",
}

OWN: dict[tuple[str, str], dict[str, str]] = {
    ("backlund", ""): {
        "L": "Lax matrix of the top",
        "U": r"matrix of the transformation, a product of two dressing matrices with poles at $\lambda = \pm 2/h$",
        r"\lambda": "spectral parameter",
        "a": r"$-\tfrac h2\,\omega_1$",
        "b": r"$-\tfrac h2\,\omega_2$",
        "n": r"$-\tfrac h4\,\omega_3$",
        "d": r"scaled vertical, $\tfrac18 c h^2\gamma$",
        "t": r"$2 - \tau$",
        r"\tau": r"constant that depends on $h$ and the integrals; $\tau = h^2E/8 + O(h^4)$ with the energy $E$",
        "x": "first unknown of the linear system",
        "y": "second unknown of the linear system",
        "z": "third unknown of the linear system",
        "e": "quaternion of the rotation of the body in a step, not normalized",
    },
    ("bohlin-b", ""): {"z": r"stereographic coordinate of $\gamma$, a complex number"},
    ("bohlin-c", ""): {r"\hat\omega": r"matrix of the map $v \mapsto \omega\times v$", "v": "any vector"},
    ("bs", "lagrange/inertial"): {
        "m": "angular momentum in space",
        "p": "unit vector of the vertical, fixed in space",
        "a": "unit vector of the axis of the top, in space",
    },
    ("dg4", ""): {
        r"\nabla": r"$\bar\nabla$: discrete gradient, a mean gradient that satisfies the last equation",
        "I": _INTEGRALS + "$k^2$",
        "D": "matrix whose columns are the discrete gradients of the four integrals",
    },
    ("dmv", ""): {
        "m^-": "angular momentum after the first kick, a step $h/2$ of gravity alone",
        "m^+": "angular momentum after the rotation",
        "e_": "components of the unit quaternion $(e_0, e)$ that describes how the body rotates in one step",
        "|e|": "length of $e$",
        "e": "vector part of the quaternion $(e_0, e)$",
        "v": "any vector fixed in space, as seen from the body",
    },
    ("dop853", ""): {
        "h_j": "length of an inner step, chosen according to the tolerances",
        "y_j": "state at the start of an inner step",
        "y_{j+1}": "state after an inner step",
        "k_": "stages: values of the right-hand side at states within the step",
        "b_": "weights of the method",
        "a_{il}": "coefficients of the stages",
    },
    ("exact", "euler"): {
        r"\mathrm{dn}": "Jacobi's elliptic function dn (delta amplitudinis)",
        r"\mathrm{sn}": "Jacobi's elliptic function sn (sinus amplitudinis)",
        r"\mathrm{cn}": "Jacobi's elliptic function cn (cosinus amplitudinis)",
        "a_": r"amplitudes of the components of $\omega$",
        "u": "phase of the elliptic functions",
        "k": "modulus of the elliptic functions",
        r"\lambda": "rate at which the phase grows",
        "t_0": "time at which the phase is 0",
        "m^2": r"square of the angular momentum, an integral",
        "T": "kinetic energy, an integral",
    },
    ("exact", "kowalevski"): {
        "s": "with index 1 or 2: Kowalevski's variables of separation",
        r"\Phi": "polynomial of degree 5 that defines the hyperelliptic curve of the motion",
        "e_": r"zeros of $\Phi$, which depend on the integrals of the motion",
    },
    ("exact", "lagrange"): {
        "u_1": r"smallest zero of $\dot u^2$ as a polynomial in $u$",
        "u_2": r"middle zero of $\dot u^2$ as a polynomial in $u$",
        "u_3": r"largest zero of $\dot u^2$ as a polynomial in $u$",
        "u": r"cosine of the angle between the axis and the vertical",
        "s": "angular momentum about the axis, an integral",
        "l": "angular momentum about the vertical, an integral",
        "E": "energy, an integral",
        "m": "angular momentum, in the frame of the body or in space",
        "k": "modulus of the elliptic function",
        "t_0": r"time from the last minimum of $u$ to $t = 0$",
        r"\mathrm{sn}": "Jacobi's elliptic function sn (sinus amplitudinis)",
        "a": "unit vector of the axis of the top, in space",
        "p": "unit vector of the vertical, fixed in space",
    },
    ("hk", "clebsch"): {
        "a_{ijk}": "coefficients of the products in the equations of motion",
        "b_{ij}": "coefficients of the linear terms in the equations of motion",
        "c_": "constant terms in the equations of motion",
    },
    ("hk", "euler"): {r"\alpha_": "difference of two moments of inertia divided by the third one"},
    ("hk-exact", ""): {
        r"\mathrm{dn}": "Jacobi's elliptic function dn (delta amplitudinis)",
        r"\mathrm{sn}": "Jacobi's elliptic function sn (sinus amplitudinis)",
        r"\mathrm{cn}": "Jacobi's elliptic function cn (cosinus amplitudinis)",
        "a_": r"amplitudes of the components of $\omega$",
        r"\varphi": "phase of the elliptic functions",
        "n": "number of the step",
        "v": "half the change of the phase in one step",
        "K_": "factors by which integrals of the exact motion are divided to give integrals of HK",
        r"\alpha_": r"$\alpha_1 = (B - C)/A$ and cyclically, with the principal moments of inertia $A$, $B$, $C$",
        "k": "modulus of the elliptic functions",
    },
    ("hk-projected", ""): {
        **_PROJECTION,
        "I": _INTEGRALS + "$k$ (square root of $k^2$)",
        "z": "state after the step of HK",
    },
    ("hk-symproj", ""): _PROJECTION,
    ("hybrid", ""): _HYBRID,
    ("hybrid-xi", ""): {
        **_HYBRID,
        r"\theta": r"argument (angle) of the complex number $\xi$",
        "k": r"modulus of $\xi$, which is conserved",
    },
    ("midpoint4", ""): {
        "J": r"matrix of the Lie-Poisson bracket of $m$ and $\gamma$",
        "k^2": "Kowalevski's integral",
        "k(": r"square root of Kowalevski's integral",
        "F": "Hamiltonian vector field of the energy $E$",
        "X": r"Hamiltonian vector field of $k^2$",
        "s": r"multiplier that makes the step conserve $k^2$",
        "E": "energy",
        r"\nabla": r"gradient with respect to $m$ and $\gamma$",
    },
    ("rk4", ""): {"k_": "stages: values of the right-hand side at states within the step"},
    ("splitting", ""): {
        r"\Phi_h": "one step of the scheme",
        "K": r"$K_\tau$: kick, the motion under gravity alone during the time $\tau$",
        "F_h": "motion of the free body during the time $h$",
        r"\tau": "duration of a kick or a rotation",
        "R": r"$R^i_\tau$: rotation about principal axis $i$ at a constant rate during the time $\tau$",
        "v": r"$m$ or $\gamma$",
    },
    ("taylor", ""): {
        r"\delta": "time after $t$ at which the series is evaluated",
        "y_": "coefficients of the Taylor series of the state about the time $t$",
        "i": "number of a term of the series",
        "Q": "symmetric bilinear form of the quadratic part of the equations of motion",
        "B": "matrix of the linear part of the equations of motion",
        "b": "constant part of the equations of motion",
    },
    ("", "lagrange/inertial"): {
        "m": "angular momentum in space",
        "a": "unit vector of the axis of the top, in space",
        "p": "unit vector of the vertical, fixed in space",
        "e_3": "unit vector of the third axis in space",
    },
    ("", "kowalevski"): {"c_0": "weight times the distance of the centre of gravity from the fixed point"},
    ("", "heavy"): {
        "mg": "weight",
        "x_0": _GRAVITY.format("first"),
        "y_0": _GRAVITY.format("second"),
        "z_0": _GRAVITY.format("third"),
    },
    ("", "volterra"): {
        "m": "angular momentum of the body and its rotors",
        "a_": "reciprocals of the moments of inertia",
        "b_": "constant part of the angular velocity, due to the rotors",
    },
    ("", "lagrange-gyrostat"): _GYROSTAT,
    ("", "kowalevski-gyrostat"): _GYROSTAT,
    ("", "goryachev-chaplygin"): {"c_0": "weight times the first coordinate of the centre of gravity"},
    ("", "hess-appelrot"): {
        "x_0": "weight times the first coordinate of the centre of gravity",
        "z_0": "weight times the third coordinate of the centre of gravity",
    },
    ("", "clebsch"): {
        "m": "angular momentum of body and fluid",
        "p": "linear momentum of body and fluid",
        r"\Omega": "diagonal matrix of the three parameters",
        r"\omega": "parameters of the body, not an angular velocity",
    },
    ("", "kirchhoff"): {
        "m": "angular momentum of body and fluid",
        "p": "linear momentum of body and fluid",
        "a": "diagonal matrix of the inverse moments of inertia of body and fluid",
        "b": "diagonal matrix of the inverse effective masses along the axes",
    },
    ("", "suslov"): {
        "I_": "components of the tensor of inertia",
        r"\ell": "angular momentum about the third axis",
    },
    ("", "coupled-euler"): {"x_": "components of the state", r"\alpha_": "parameters"},
    ("", "gaudin"): {
        "a": "first spin",
        "b": "second spin",
        r"\lambda_": "strength of the field on each spin",
        "e_3": "direction of the field",
    },
    ("", "weierstrass"): {"x": "coordinate", "v": "velocity", "g_2": "invariant of Weierstrass' elliptic function"},
    ("", "so4"): {
        "M": "angular momentum, a skew-symmetric 4x4 matrix",
        r"\Omega": "angular velocity, a skew-symmetric 4x4 matrix",
        "J_": "second moments of the mass along the four axes",
    },
}
"""Symbols of one scheme (and the first of the tops that share its formula, where there are several formulas) or top."""

_LAYOUT = re.compile(
    r"\\(?:begin|end)\{\w+\}|\\text\{[^{}]*\}|\\\\(?:\[\w+\])?|\\[,;!{} ]|\^\{\\mathsf T\}|\(i, j, k\)|"
    r"\\(?:sum|prod)_(?:\{[^{}]*\}|\w)(?:\^(?:\{[^{}]*\}|\w))?|"
    r"\\(?:q?quad|[dt]?frac|sqrt|bar|dot|times|cdot|circ|mapsto|[lr]vert|[bB]ig[glr]*|left|right|[lg]eq|dots)(?![A-Za-z])"
)
"""Commands of LaTeX that are not symbols of a formula."""
_MACRO = re.compile(r"\\mathrm\{[A-Za-z]+\}|\\[A-Za-z]+")
_SUBSCRIPT = r"_(?:\{[^{}]*\}|.)"


def symbols_of(formula: str, scheme: str = "", top: str = "") -> list[tuple[str, str]]:
    """Symbols of a formula in the order of their first appearance, each with its meaning.

    Raises
    ------
    KeyError
        If the formula contains a symbol without a meaning.
    """
    letters: dict[str, str] = {}

    def encoded(text: str) -> str:
        """Text with one letter for each command of LaTeX."""
        return _MACRO.sub(lambda one: letters.setdefault(one[0], chr(0xE000 + len(letters))), text)

    own: Mapping[str, str] = OWN.get((scheme, top)) or OWN.get((scheme, ""), {})
    meanings = [*own.items(), *((key, text) for key, text in GENERAL.items() if key not in own)]
    text = encoded(_LAYOUT.sub(" ", formula))
    found = []
    for key, meaning in sorted(meanings, key=lambda one: (one[0] not in own, -len(one[0]))):
        symbol = re.escape(encoded(key.removesuffix("_"))) + (_SUBSCRIPT if key.endswith("_") else "")
        if first := re.search(symbol, text):
            found.append((first.start(), key, meaning))
        scripts = "" if key.endswith(("^", "(")) else rf"(?:{_SUBSCRIPT}|\^\w)*"
        text = re.sub(symbol + scripts, lambda one: " " * len(one[0]), text)
    if left := re.search("[A-Za-z\ue000-\uf8ff]", text):
        name = next((macro for macro, letter in letters.items() if letter == left[0]), left[0])
        raise KeyError(f"{scheme or top}: no meaning of {name} in {formula.strip()}")
    return [(f"{key}i" if key.endswith("_") else key.rstrip("^("), meaning) for _, key, meaning in sorted(found)]
