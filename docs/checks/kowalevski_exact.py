"""Equations (1) to (3) of the page on the Kowalevski top, and those of its one equation, evaluated at one state."""

import itertools

import numpy as np

from topcli.tops.kowalevski import kowalevski_field

y, c = np.array([0.7, -0.4, 1.3, 0.6, 0.48, 0.64]), 1.0


def separated(y):
    w1, w2, w3, *g = y
    g = np.array(g)
    x, xi = complex(w1, w2), complex(w1, w2) ** 2 - c * complex(g[0], g[1])
    k, l1 = abs(xi), (w1 * w1 + w2 * w2 + w3 * w3 / 2 + c * g[0]) / 3
    L, G = c * (2 * (w1 * g[0] + w2 * g[1]) + w3 * g[2]) / 2, c * c * g @ g
    R = np.poly1d([-1, 0, 6 * l1, -4 * L, G - k * k])
    R12 = -(abs(x) ** 4) + 6 * l1 * abs(x) ** 2 - 4 * L * w1 + G - k * k
    s = l1 / 2 + (R12 + np.array([-1, 1]) * abs(R(x))) / (2 * (2j * w2) ** 2).real
    return s, R, R12, x, xi, k, l1, L, G


rates = np.array(kowalevski_field(tuple(y), (c,)))
s, R, R12, x, xi, k, l1, L, G = separated(y)
# (1): s1, s2 separate the motion
g2, g3 = k * k - G + 3 * l1 * l1, l1 * (k * k - G - l1 * l1) + L * L
e = np.append(np.roots([4, 0, -g2, -g3]), [(l1 + k) / 2, (l1 - k) / 2]).astype(complex)
ds = (separated(y + 1e-6 * rates)[0] - separated(y - 1e-6 * rates)[0]) / 2e-6
for i in (0, 1):
    Phi = (4 * np.prod(s[i] - e)).real
    assert np.isclose((s[0] - s[1]) ** 2 * ds[i] ** 2, -Phi, rtol=1e-7)
assert np.isclose(s[0] - s[1], abs(R(x)) / (4 * y[1] ** 2))
R1 = (6 * l1 - 4 * y[0] ** 2) * (G - k * k - abs(x) ** 4) - (2 * L - 2 * y[0] * abs(x) ** 2) ** 2
assert np.isclose(s[0], l1 / 2 - R1 / (2 * (abs(R(x)) + R12)))

# the rates of A0 - B0 and of p + q if both variables grow
sigma = 0.4 * s[0] + 0.6 * s[1]
speed = np.abs(ds) / np.sqrt([-(4 * np.prod(s[i] - e)).real for i in (0, 1)])
assert np.isclose(speed[0], speed[1], rtol=1e-7)
assert np.isclose((s[0] - sigma) * speed[0] + (sigma - s[1]) * speed[1], 1, rtol=1e-7)

# (2), (3): the state for one choice of the signs of the square roots
x0 = max(R.roots, key=lambda r: abs(np.polyder(R)(r)))
r1, r2 = np.polyder(R)(x0) / 4, np.polyder(R, 2)(x0) / 24
D, best = s[0] - s[1], np.inf
for signs in itertools.product((1, -1), repeat=7):
    f, g = np.sqrt(s[0] - e), np.sqrt(s[1] - e)
    f[:3], g[:2] = f[:3] * signs[:3], g[:2] * signs[3:5]
    h, kk = f - g, f + g
    pairs = ((0, 1), (1, 2), (2, 0))
    La = 8 * D**2 / np.prod([(h[i] - kk[j]) * (h[i] + kk[j]) for i, j in pairs])
    N = 2 * h[1] * h[2] / ((h[1] - kk[2]) * (h[2] + kk[1])) + (e[0] - r2) * La
    mu, A, B = N - 1, signs[5] * f[3] * f[4], signs[6] * g[3] * g[4]
    F = f[0] * f[1] * f[2] + f[0] * g[1] * g[2] + g[0] * f[1] * g[2] + g[0] * g[1] * f[2]
    F1 = g[0] * g[1] * g[2] + g[0] * f[1] * f[2] + f[0] * g[1] * f[2] + f[0] * f[1] * g[2]
    new = x0 + r1 * La / N
    w3 = 2 * ((F * B - F1 * A) * (mu**2 + 1) - 2 * mu * (F * A - F1 * B)) / ((mu**2 - 1) * D**2)
    third = w3 * new + 2 * r1 * np.prod(h[:3]) * La * (A + B) / (D**2 * N**2)
    part = f[3] * g[4] + signs[5] * signs[6] * f[4] * g[3]
    up = new**2 - (part * np.prod(h[:3]) * (N - 2) / (N * D**2)) ** 2
    found = np.array([new.real, new.imag, w3.real, up.real / c, up.imag / c, third.real / c])
    best = min(best, np.abs(found - y).max() + abs(x0 + r1 * La / (N - 2) - np.conj(new)))
assert best < 1e-12
