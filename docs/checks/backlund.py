"""Formulas (4) to (11) of the page on the Kowalevski top, evaluated numerically and compared with the scheme."""

import numpy as np

import topcli

y, h, c = np.array([0.7, -0.4, 1.3, 0.6, 0.48, 0.64]), 0.5, 1.0
I5, al, q4 = np.diag([1.0, 1, 1, -1, -1]), -2 / h, (c * h / 2) ** 2
step = topcli.simulate("kowalevski_generic_backlund", h=h, N=1).states[1]


def integrals(y):
    G, l2 = y[3:] @ y[3:], 2 * (y[0] * y[3] + y[1] * y[4]) + y[2] * y[5]
    xi = complex(y[0], y[1]) ** 2 - c * complex(y[3], y[4])
    return G, l2, y[0] ** 2 + y[1] ** 2 + y[2] ** 2 / 2 + c * y[3], abs(xi) ** 2


def lax(m, g, lam):
    V = np.zeros((3, 2), complex)
    V[0, 0] = V[1, 1] = 2 * lam
    V[:, 0] -= c / lam * g
    hat = np.array([[0, m[2], -m[1]], [-m[2], 0, m[0]], [m[1], -m[0], 0]])  # v -> v x m
    return np.block([[hat, V], [V.T, -m[2] * np.array([[0, 1], [-1, 0]])]])


def pair(L):  # eigenvalues and vectors near 2 alpha
    values, vectors = np.linalg.eig(L)
    near = np.argsort(-np.sign(al) * values.real)[:2]
    return values[near], vectors[:, near]


G, l2, E, K = integrals(y)
m, gamma = np.array([2 * y[0], 2 * y[1], y[2]]), y[3:]
nu, W = pair(lax(m, gamma, al))
root = np.sqrt(16 * K + q4 * (4 * l2**2 - 8 * E * G) + (q4 * G) ** 2 + 0j)
eps = 2 * E - q4 * G / 2 + np.array([-0.5, 0.5]) * root
assert np.allclose(sorted(nu.real**2), sorted((4 * al**2 - eps).real))  # (4)

# (5), (6): two elementary steps, and the discrete Lax pair at another lambda
mm, gg, U, lam = m + 0j, gamma + 0j, np.eye(5), 0.3 + 0.7j
for value in nu:
    values, vectors = np.linalg.eig(lax(mm, gg, al))
    ell = vectors[:, abs(values - value).argmin()]
    assert abs(ell @ I5 @ ell) < 1e-13
    P = np.outer(ell, ell) / (ell @ ell)
    D = (lam - al) / (lam + al) * P + np.eye(5) - P - I5 @ P @ I5 + (lam + al) / (lam - al) * I5 @ P @ I5
    a, b = ell[:3] / np.sqrt(ell[:3] @ ell[:3] + 0j), np.append(ell[3:], 0) / np.sqrt(ell[3:] @ ell[3:] + 0j)
    S = np.eye(3) - 2 * np.outer(b, b)
    g = np.eye(5, dtype=complex)
    g[:3, :3], g[3:, 3:] = S, S[:2, :2]
    U = g @ D @ U
    mm, gg = -S @ mm + 4 * al * np.cross(a, b), S @ (np.eye(3) - 2 * np.outer(a, a)) @ gg
assert np.allclose([mm[0] / 2, mm[1] / 2, mm[2], *gg], step, atol=1e-12)
after = np.array([2 * step[0], 2 * step[1], step[2]])
assert np.allclose(lax(after, step[3:], lam) @ U, U @ lax(m, gamma, lam), atol=1e-11)

# (9), (7): the constant and the plane
u, F = h * h / 16, 2 * E
S, Pi = u * (2 * F - q4 * G), u * u * (F * F - 4 * K - q4 * l2**2)
z = S + 2 * (S - Pi) / (1 + np.sqrt(1 - S + Pi))
tau = z / (2 + np.sqrt(4 - z))
t = 2 - tau
assert np.isclose(t, nu.sum().real / (2 * al), rtol=1e-13)
a, b, n = -h / 2 * np.array([y[0], y[1], y[2] / 2])
d1, d2, d3 = c * h * h / 8 * gamma
T = np.array(
    [[2 - d1, -b - d3, a, d2 - 2 * n], [b - d3, d1, d2, a], [-a, d2, -d1, b + d3], [d2 + 2 * n, -a, d3 - b, d1 - 2]]
)
assert np.allclose(sorted(np.linalg.eigvals(T).real)[-1], t)
psi = np.append(1, np.linalg.solve(t * np.eye(3) - T[1:, 1:], T[1:, 0]))
assert np.allclose(T @ psi, t * psi)
e = np.array([1, psi[2], -psi[1], -psi[3]])
(e0, e1, e2, e3), N = e, e @ e
R = np.eye(3) + 2 / N * (e0 * np.cross(e[1:], np.eye(3)).T + np.outer(e[1:], e[1:]) - (e[1:] @ e[1:]) * np.eye(3))
q = R[:, :2]
assert np.allclose((W @ np.linalg.inv(W[3:]))[:3], q, atol=1e-12)

# (8): the new state
f1, f2, g1, g2, rho = e0 * e1 - e3 * e2, e0 * e2 + e3 * e1, e0 * e1 + e3 * e2, e0 * e2 - e3 * e1, e0**2 + e3**2
X, Y = 8 * e0 * e3 + 2 * (n * rho + a * f2 - b * f1), t * N
H = X * X + Y * Y
v = np.array([N * a + 2 * g1, N * b + 2 * g2])
scaled = np.array([a, b]) - 2 * t / H * np.array([[Y, X], [-X, Y]]) @ v
third = n + 4 * t / H * (2 * Y * e0 * e3 - X * (e0**2 - e3**2))
assert np.allclose(-2 / h * np.array([*scaled, 2 * third]), step[:3], atol=1e-12)
r0 = ((Y * Y - X * X) * rho - H * (e1**2 + e2**2)) / (H * N)
r = np.array([-2 * Y * (Y * f1 + X * f2), -2 * Y * (Y * f2 - X * f1), -2 * X * Y * rho]) / (H * N)
assert np.isclose(r0**2 + r @ r, 1)
assert np.allclose(gamma + 2 * r0 * np.cross(r, gamma) + 2 * np.cross(r, np.cross(r, gamma)), step[3:], atol=1e-12)

# (10), (11): the flow of E over T_E and of K over T_K, and their common Hamiltonian
x, w = np.polynomial.legendre.leggauss(32)
sizes = h / 4 * (x + 1)


def tau_of(s, E, K):
    S, Pi = s**2 * (4 * E - c * c * s**2 * G) / 4, s**4 * (4 * E * E - 4 * K - c * c * s**2 * l2**2) / 16
    p = np.sqrt(1 - S + Pi)
    z = S + 2 * (S - Pi) / (1 + p)
    return z / (2 + np.sqrt(4 - z)), p


taus, ps = tau_of(sizes, E, K)
ts = 2 - taus
assert np.allclose(ts**2, 2 - sizes**2 * (4 * E - c * c * sizes**2 * G) / 4 + 2 * ps)
TE = h / 4 * w @ ((2 - sizes**2 * E + 2 * ps) / (ps * ts))
TK = h / 4 * w @ (sizes**2 / (2 * ps * ts))


def hamiltonian(E, K):
    return h / 4 * w @ (4 * tau_of(sizes, E, K)[0] / sizes**2)


assert np.isclose(TE, (hamiltonian(E + 1e-5, K) - hamiltonian(E - 1e-5, K)) / 2e-5, rtol=1e-8)
assert np.isclose(TK, (hamiltonian(E, K + 1e-5) - hamiltonian(E, K - 1e-5)) / 2e-5, rtol=1e-8)


def rate(y, of):  # m x dF/dm + gamma x dF/dgamma, gamma x dF/dm
    scale = np.array([2.0, 2, 1, 1, 1, 1])
    grad = np.array([integrals(y + 1e-6 * k)[of] - integrals(y - 1e-6 * k)[of] for k in np.eye(6)]) / 2e-6 / scale
    m, g = (scale * y)[:3], y[3:]
    return np.append(np.cross(m, grad[:3]) + np.cross(g, grad[3:]), np.cross(g, grad[:3])) / scale


def flow(y, of, time, steps=400):
    for _ in range(steps):
        k = time / steps
        k1 = rate(y, of)
        k2 = rate(y + k / 2 * k1, of)
        k3 = rate(y + k / 2 * k2, of)
        y = y + k / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + k * k3, of))
    return y


assert np.allclose(flow(flow(y, 2, TE), 3, TK), step, atol=1e-8)
