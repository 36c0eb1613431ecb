"""Splitting and Moser-Veselov steps in matrices and quaternions, written for the tests.

The equations are m' = m x omega + gamma x g and gamma' = gamma x omega, with m = I omega.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation


def turned(v: np.ndarray, rotation_vector: np.ndarray) -> np.ndarray:
    """Solution at time 1 of v' = v x a."""
    return Rotation.from_rotvec(-rotation_vector).apply(v)


def parts(top, y):
    """m, gamma, moments, weight and the sign of omega in the state, of a state of the top."""
    equations = top.euler_poisson()
    moments = np.array(equations.moments)
    gamma = np.array(y[3:]) if len(y) == 6 else np.zeros(3)
    return equations.omega_sign * moments * np.array(y[:3]), gamma, moments, np.array(equations.gravity)


def state(top, m, gamma, length):
    """State of the top from m and gamma."""
    equations = top.euler_poisson()
    return np.concatenate([equations.omega_sign * m / np.array(equations.moments), gamma])[:length]


def kicked(top, y, h, free):
    """Half a kick, the motion ``free(m, gamma, moments, h)``, half a kick."""
    m, gamma, moments, weight = parts(top, y)
    m = m + 0.5 * h * np.cross(gamma, weight)
    m, gamma = free(m, gamma, moments, h)
    return state(top, m + 0.5 * h * np.cross(gamma, weight), gamma, len(y))


def axes(m, gamma, moments, h):
    """Rotations about the axes 1, 2, 3, 2, 1."""
    for i, part in ((0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5), (0, 0.5)):
        a = part * h * m[i] / moments[i] * np.eye(3)[i]
        m, gamma = turned(m, a), turned(gamma, a)
    return m, gamma


def closed(m, gamma, moments, h):
    """Exact motion of a free body with A = B."""
    spin = h * m[2] * (1.0 / moments[2] - 1.0 / moments[0]) * np.array([0.0, 0.0, 1.0])
    return turned(m, spin), turned(turned(gamma, h * m / moments[0]), spin)


def moser_veselov(m, gamma, moments, h):
    """Rotation by the quaternion (e0, e) with h m_i = 2 (I_i e0 e_i + (I_k - I_j) e_j e_k)."""
    j, k = np.array([1, 2, 0]), np.array([2, 0, 1])

    def defect(e):
        e0 = np.sqrt(1.0 - e @ e)
        return 2.0 * (moments * e0 * e + (moments[k] - moments[j]) * e[j] * e[k]) - h * m

    e = fsolve(defect, 0.5 * h * m / moments, xtol=1e-15, full_output=True)[0]  # warns at round-off otherwise
    half = np.arcsin(np.linalg.norm(e))
    a = 2.0 * half * e / np.linalg.norm(e)
    return turned(m, a), turned(gamma, a)


def bracket_matrix(top, y):
    """Poisson matrix of (m, gamma), or of m, at a state of the top."""
    m, gamma, _, _ = parts(top, y)

    def hat(v):
        return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])

    if len(y) == 3:
        return hat(m)
    return np.block([[hat(m), hat(gamma)], [hat(gamma), np.zeros((3, 3))]])


def poisson_defect(top, step, y, h, nudge=1e-5):
    """Largest element of J P J^T - P at the image, with the derivative J of the step in (m, gamma) by differences."""
    d = len(y)
    scale = np.ones(d)
    scale[:3] = top.euler_poisson().omega_sign * np.array(top.euler_poisson().moments)
    columns = []
    for i in range(d):
        change = np.zeros(d)
        change[i] = nudge / scale[i]
        columns.append(scale * (step(y + change, h) - step(y - change, h)) / (2.0 * nudge))
    jacobian = np.array(columns).T
    return np.abs(jacobian @ bracket_matrix(top, y) @ jacobian.T - bracket_matrix(top, step(y, h))).max()
