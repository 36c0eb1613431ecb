"""Motions of the closed form as bytes, which are stored on disk: plain data in JSON, arrays with all their bits."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np

from topcli.schemes.kowalevski.delone import TripleRoot
from topcli.schemes.kowalevski.inversion import Lattice, Pinch
from topcli.schemes.kowalevski.jacobi_phase import JacobiPhase
from topcli.schemes.kowalevski.oval_table import OvalTable, Series
from topcli.schemes.kowalevski.pendulum import Pendulum
from topcli.schemes.kowalevski.separated_motion import SeparatedMotion
from topcli.schemes.kowalevski.state_of_factors import Formula

Motion = Pendulum | TripleRoot | SeparatedMotion
MOTIONS = Pendulum, TripleRoot, SeparatedMotion
CLASSES = {kind.__name__: kind for kind in (*MOTIONS, Lattice, Pinch, OvalTable, Series, Formula, JacobiPhase)}
"""Classes whose objects are their attributes."""
DTYPES = ("<f8", "<i8", "<c16", "|b1")


def _plain(value: Any) -> Any:
    """Return ``value`` as data that JSON has; what is no such data is a list of its kind and content."""
    if isinstance(value, np.generic):
        value = value.item()
    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if kind is complex:
        return ["complex", value.real, value.imag]
    if kind is Fraction:
        return ["fraction", value.numerator, value.denominator]
    if kind is np.ndarray:
        code = value.dtype.newbyteorder("<").str
        if code not in DTYPES:
            raise TypeError(f"an array of {value.dtype}")
        return ["array", code, list(value.shape), b64encode(value.astype(code).tobytes()).decode()]
    if kind in (tuple, list):
        return [kind.__name__, *map(_plain, value)]
    if kind is dict:
        return ["dict", *([_plain(key), _plain(one)] for key, one in value.items())]
    if CLASSES.get(kind.__name__) is not kind:
        raise TypeError(f"an object of type {kind.__name__}")
    return ["object", kind.__name__, {name: _plain(one) for name, one in vars(value).items()}]


def _array(code: str, shape: list[int], text: str) -> np.ndarray:
    if code not in DTYPES:
        raise ValueError(f"an array of {code}")
    flat = np.frombuffer(b64decode(text, validate=True), dtype=code)
    return flat.reshape(shape).astype(np.dtype(code).newbyteorder("="))


def _object(name: str, attributes: dict[str, Any]) -> Any:
    made = object.__new__(CLASSES[name])
    vars(made).update({key: _value(one) for key, one in attributes.items()})
    return made


_KINDS: dict[str, Callable[..., Any]] = {
    "complex": complex,
    "fraction": Fraction,
    "array": _array,
    "tuple": lambda *items: tuple(map(_value, items)),
    "list": lambda *items: list(map(_value, items)),
    "dict": lambda *items: {_value(key): _value(one) for key, one in items},
    "object": _object,
}


def _value(plain: Any) -> Any:
    """Return the value that ``_plain`` has described."""
    return _KINDS[plain[0]](*plain[1:]) if isinstance(plain, list) else plain


def motion_bytes(motion: Motion) -> bytes:
    """Return a motion as bytes."""
    return json.dumps(_plain(motion), separators=(",", ":")).encode()


def motion_from(data: bytes) -> Motion:
    """Motion that ``motion_bytes`` has written. Raises ValueError for other bytes."""
    try:
        found = _value(json.loads(data))
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError, ArithmeticError) as error:
        raise ValueError(f"no stored motion: {error}") from None
    if not isinstance(found, MOTIONS):
        raise ValueError("no stored motion")
    return found
