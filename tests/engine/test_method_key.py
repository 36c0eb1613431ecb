"""The code key of a run: an edit of any function or constant of which a method consists changes it."""

from __future__ import annotations

import pytest

from topcli.runs.identity import method_fingerprint

METHOD = """
import topcli
from topcli.contracts import Stepper

GAIN = 1.25
PAIR = (0.5, (2.25, 3.0))

def helper(x, k=4.125):
    return x + k * 0.0

def step(s, h, p, q=5.5):
    return (helper(s[0]), s[1] + q * 0.0, s[2] * GAIN, s[3] * PAIR[1][0], s[4], s[5], s[6])

def enter(y, h, p):
    return (*y, 6.75)

def leave(s, h, p):
    return (s[0], s[1], s[2], s[3], s[4], s[5] + 7.125)

METHOD = Stepper(step, 7, enter, leave{traits})
"""
EDITS = {
    "global of the step": ("GAIN = 1.25", "GAIN = 1.5"),
    "nested global": ("2.25", "2.5"),
    "default of the step": ("q=5.5", "q=5.25"),
    "default of a helper": ("k=4.125", "k=4.25"),
    "body of a helper": ("x + k", "x - k"),
    "body of the step": ("s[1] + q", "s[1] - q"),
    "body of enter": ("6.75", "6.5"),
    "body of leave": ("7.125", "7.5"),
    "no leave": ("enter, leave{traits}", "enter{traits}"),
    "plain": ("{traits}", ", plain=True{traits}"),
    "counters": ("{traits}", ", counters=('count',){traits}"),
    "iterative": ("{traits}", ", iterative=True{traits}"),
    "comment": ("GAIN = 1.25", "GAIN = 1.25  # a gain"),
}
SAME = {"comment"}


def key(text: str) -> str:
    scope: dict = {"__name__": "mine", "__file__": "mine.py"}
    exec(compile(text.replace("{traits}", ""), "mine.py", "exec"), scope)
    return method_fingerprint(scope["METHOD"])


@pytest.mark.parametrize("edit", EDITS)
def test_every_edit_of_a_method_changes_its_code_key(edit: str) -> None:
    old, new = EDITS[edit]
    assert METHOD.count(old) == 1
    assert key(METHOD) == key(METHOD)
    assert (key(METHOD.replace(old, new)) == key(METHOD)) == (edit in SAME)


def test_edits_have_keys_of_their_own() -> None:
    keys = [key(METHOD.replace(*EDITS[edit])) for edit in EDITS if edit not in SAME]
    assert len(set(keys)) == len(keys)
