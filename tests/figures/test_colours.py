"""Figures are read by colour-blind readers and in grey print: colours differ there, and lines not by colour alone."""

from __future__ import annotations

import itertools

import matplotlib as mpl
import pytest
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D

from seen_colours import difference, lightness, pattern
from topcli.figures.outcomes import SHADES
from topcli.figures.space import BAND, BAND_FAR, RUN, TRACE, TRACE_FAR
from topcli.figures.style import REFERENCE_LOOK, looks, styled


def cycle() -> list[str]:
    with styled():
        return [style["color"] for style in mpl.rcParams["axes.prop_cycle"]]


def test_the_simulation_has_known_values() -> None:
    """Red and green of equal lightness are alike without green receptors, and far apart with them; black is 0."""
    red, green = "#a46100", "#5a7d00"
    assert difference(red, green, deuteranopia=False) > 40.0
    assert difference(red, green, deuteranopia=True) < 12.0
    assert difference("#000000", "#ffffff", deuteranopia=True) == pytest.approx(100.0, abs=0.2)
    assert (lightness("black"), lightness("white")) == pytest.approx((0.0, 100.0), abs=1e-6)
    assert lightness("#777777") == pytest.approx(50.0, abs=0.5)


def test_colours_of_lines_differ_for_the_colour_blind_and_are_dark_enough() -> None:
    """The nearest pair, green and purple, is 17.9 apart; the palest colour has the lightness 71."""
    for one, other in itertools.combinations(cycle(), 2):
        assert difference(one, other, deuteranopia=True) > 15.0, (one, other)
    assert max(map(lightness, cycle())) < 75.0


def test_shades_and_traces_differ_for_the_colour_blind_and_in_grey() -> None:
    for one, other in itertools.combinations(SHADES, 2):
        assert difference(one, other, deuteranopia=True) > 10.0
        assert abs(lightness(one) - lightness(other)) > 7.0
    for one, other in ((TRACE, TRACE_FAR), (BAND, BAND_FAR), (RUN, "0.15")):
        assert abs(lightness(one) - lightness(other)) > 12.0
    for one, other in ((TRACE, BAND), (TRACE_FAR, BAND_FAR)):
        assert difference(one, other, deuteranopia=True) > 15.0


def test_49_lines_differ_in_colour_and_dashes_and_7_in_dashes_alone() -> None:
    with styled():
        lines = [Line2D([], [], **style) for style in looks(map(str, range(49))).values()]
    assert len({(to_hex(line.get_color()), pattern(line)) for line in lines}) == 49
    for first in range(0, 49, 7):
        assert len({pattern(line) for line in lines[first : first + 7]}) == 7


def test_lines_stand_out_from_the_reference_behind_them() -> None:
    """In grey print too: the palest coloured line is darker by 10 and the reference is no white."""
    reference = REFERENCE_LOOK["color"]
    assert lightness(reference) - max(map(lightness, cycle())) > 10.0
    assert lightness(reference) < 90.0


@pytest.mark.parametrize("markers", [False, True])
def test_a_scheme_has_its_colour_whatever_is_drawn_beside_it(markers: bool) -> None:
    names = ["rk4", "hybrid", "splitting", "hk", "dg4"]
    with styled():
        together = looks(["another", *names], markers)
        alone = {name: looks([name], markers)[name] for name in names}
    assert {name: look["color"] for name, look in together.items() if name in names} == {
        name: look["color"] for name, look in alone.items()
    }


def test_a_composition_has_the_colour_of_its_scheme_and_a_look_of_its_own() -> None:
    names = ["hk", "hk-projected", "hk+suzuki4", "hk+kahan-li8", "rk4", "backlund+yoshida4", "backlund"]
    with styled():
        found = looks(names, markers=True)
    colours = {name: to_hex(look["color"]) for name, look in found.items()}
    assert len({colours[name] for name in names if name.startswith("hk")}) == 1
    assert colours["backlund+yoshida4"] == colours["backlund"] != colours["hk"] != colours["rk4"]
    assert len({(colours[name], look["marker"], str(look["linestyle"])) for name, look in found.items()}) == len(names)


def test_names_in_configs_and_display_names_have_one_look() -> None:
    with styled():
        assert looks(["bohlin-a"]) == {"bohlin-a": looks(["Bohlin A"])["Bohlin A"]}
