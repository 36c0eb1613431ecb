"""A custom top as a config, and the same top as a class: the gyrostat of Zhukovski and Volterra."""

from __future__ import annotations

from copy import deepcopy
from typing import Any, ClassVar

from ruamel.yaml import YAML

from topcli.contracts import Top

VOLTERRA = """\
top:
  kind: custom
  components: [w1, w2, w3]
  parameters: {A: 3.0, B: 2.0, C: 1.0, k: 0.3}
  field:
    w1: ((B - C)*w2*w3 - k*w2)/A
    w2: ((C - A)*w3*w1 + k*w1)/B
    w3: (A - B)*w1*w2/C
  invariants:
    energy: (A*w1**2 + B*w2**2 + C*w3**2)/2
    momentum: (A*w1)**2 + (B*w2)**2 + (C*w3 + k)**2
initial: {w1: 0.9, w2: -0.4, w3: 1.2}
scheme: hk
h: 0.01
N: 400
"""
Y0 = (0.9, -0.4, 1.2)
SECTION: dict[str, Any] = YAML(typ="safe", pure=True).load(VOLTERRA)["top"]


def config(**changes: Any) -> dict[str, Any]:
    """The config of ``VOLTERRA`` as a dict."""
    whole = {"top": SECTION, "initial": dict(zip(("w1", "w2", "w3"), Y0, strict=True)), "scheme": "hk"}
    return deepcopy(whole | {"h": 0.01, "N": 400} | changes)


def section(**changes: Any) -> dict[str, Any]:
    """The section ``top`` with some keys changed."""
    return deepcopy(SECTION | changes)


class Volterra(Top):
    """The same top declared in Python."""

    kind = "volterra-in-python"
    components = ("w1", "w2", "w3")
    A: float = 3.0
    B: float = 2.0
    C: float = 1.0
    k: float = 0.3

    @staticmethod
    def field(y, p):
        A, B, C, k = p
        w1, w2, w3 = y
        return (
            ((B - C) * w2 * w3 - k * w2) / A,
            ((C - A) * w3 * w1 + k * w1) / B,
            (A - B) * w1 * w2 / C,
        )

    integrals: ClassVar = {
        "energy": lambda y, p: (p[0] * y[0] ** 2 + p[1] * y[1] ** 2 + p[2] * y[2] ** 2) / 2,
        "momentum": lambda y, p: (p[0] * y[0]) ** 2 + (p[1] * y[1]) ** 2 + (p[2] * y[2] + p[3]) ** 2,
    }
