"""Colour maps: lightness rises with the amount; phases close."""

import numpy as np

from tg4mm.core.colour import amount_colours, hex_colour, phase_colours, srgb_of_oklch


def luminance(srgb):
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def test_greys_of_oklab_are_greys_and_white_is_white():
    np.testing.assert_allclose(srgb_of_oklch(np.array(1.0), np.array(0.0), np.array(0.0)), 1.0, atol=1e-3)
    grey = srgb_of_oklch(np.array(0.5), np.array(0.0), np.array(123.0))
    np.testing.assert_allclose(grey, grey[0], atol=1e-6)


def test_more_is_lighter():
    light = luminance(amount_colours(np.linspace(0, 1, 200)))
    assert (np.diff(light) > 0).all()
    assert light[0] < 0.03
    assert light[-1] > 0.8


def test_amounts_outside_the_scale_take_its_ends():
    np.testing.assert_array_equal(amount_colours(np.array([-1.0, 2.0])), amount_colours(np.array([0.0, 1.0])))


def test_phases_meet_at_half_a_turn_and_are_equally_light():
    np.testing.assert_allclose(phase_colours(np.array(np.pi)), phase_colours(np.array(-np.pi)), atol=1e-9)
    light = luminance(phase_colours(np.linspace(-np.pi, np.pi, 100)))
    assert light.max() - light.min() < 0.15
    opposite = phase_colours(np.array([0.0, np.pi]))
    assert np.abs(opposite[0] - opposite[1]).max() > 0.3


def test_hex_of_a_colour():
    assert hex_colour(np.array([1.0, 0.5, 0.0])) == "#ff8000"
