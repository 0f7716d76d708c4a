"""What a look found goes through a run's log unchanged."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.look import found
from tg4mm.capture.codec import Loss
from tg4mm.capture.look import compression
from tg4mm.capture.look.marks import marked
from tg4mm.capture.look.record import from_record, to_record
from tg4mm.capture.look.scene import Light


def test_a_record_is_plain_and_read_back_the_same():
    first = found()
    again = from_record(json.loads(json.dumps(to_record(first))))
    assert to_record(again) == to_record(first)
    assert again.lines[0].box == first.lines[0].box
    assert (again.lines[0].cells == first.lines[0].cells).all()
    assert again.movers == first.movers
    assert again.light == first.light


def test_the_mask_is_of_whole_cells_and_leaves_the_edge_that_no_cell_covers():
    mask = found().mask()
    assert mask.shape == (50, 64)
    assert mask[:16, :16].all()
    assert mask.sum() == 256


def test_a_large_line_of_one_cell_is_marked_and_a_small_one_or_one_of_two_cells_is_not():
    line = found().lines[0]
    wide = np.zeros_like(line.region)
    wide[1, 2:] = True
    cases = [(0.9, line.region, True), (0.3, line.region, False), (0.9, wide, False)]
    for amplitude, region, is_marked in cases:
        own = replace(line, amplitude_px=amplitude, region=region)
        assert bool(marked([own], 30.0, 6.0)[0].mark) == is_marked


def test_what_the_record_does_not_tell_from_what_is_taken_off_is_marked():
    line = replace(found().lines[0], hz=7.4)
    (own,) = marked([line], 30.0, 6.0, taken_off={7.5: "the codec's turns at"})
    assert "the codec's turns at 7.5 Hz" in own.mark
    assert not marked([line], 30.0, 6.0, taken_off={7.7: "the codec's turns at"})[0].mark


def test_no_line_is_made_of_one_that_the_codec_makes():
    codec = replace(found().lines[0], hz=7.4, amplitude_px=0.3)
    own = replace(codec, hz=7.8, amplitude_px=0.013)  # 3 × 7.4 Hz, seen at 30 Hz
    assert "3 × 7.400 Hz" in marked([codec, own], 30.0, 4.0)[1].mark
    of_codec, other = marked([codec, own], 30.0, 4.0, taken_off={7.5: "the codec's turns at"})
    assert "codec's turns" in of_codec.mark
    assert not other.mark


def test_odd_multiples_that_a_codec_makes_are_marked_up_to_the_size_that_a_square_wave_has():
    line = replace(found().lines[0], hz=6.7, amplitude_px=0.2)
    cases = [(5, 0.03, True), (5, 0.05, False), (7, 0.02, True), (7, 0.04, False), (6, 0.01, False)]
    for order, amplitude, is_marked in cases:
        own = replace(line, hz=abs(6.7 * order - 60 * round(6.7 * order / 60)), amplitude_px=amplitude)
        assert (
            f"{order} × 6.700 Hz, which the codec" in marked([line, own], 60.0, 10.0)[1].mark
        ) == is_marked
        assert not marked([line, own], 60.0, 10.0, patterns=())[1].mark


@pytest.mark.parametrize(("gain", "is_marked"), [(1.3, False), (1.9, True)])
def test_a_line_that_compression_makes_is_marked_where_half_of_it_is_made(monkeypatch, gain, is_marked):
    first = found()
    loss = Loss(gain, 0.07, "compression adds to it", is_made=True)
    monkeypatch.setattr(
        compression,
        "codec_losses",
        lambda video, masks, tones, *_, **__: [[loss] * len(own) for own in tones],
    )
    before = first.vibrations[0]
    after = compression.with_losses(first, Path("film.mp4"), 30.0)[first.lines.index(before)]
    assert bool(after.mark) == is_marked
    assert (after.kept, after.lost, after.amplitude_px) == (None, before.lost, before.amplitude_px)
    assert after.amplitude_deviation_px >= (gain - 1) * before.amplitude_px


def test_what_light_makes_seem_to_move_is_marked_and_what_moves_by_more_at_its_frequency_is_not():
    line = replace(found().lines[0], hz=7.4)
    clear, clipped = np.zeros_like(line.region), np.ones_like(line.region)
    for size, cells, mark in (
        (0.005, clear, "no more than light makes"),
        (0.05, clear, ""),
        (0.05, clipped, "may be light"),
        (0.6, clipped, ""),
    ):
        lamp = Light(7.5, 0.01, 0.03, False)
        own = marked([replace(line, amplitude_px=size)], 30.0, 6.0, light=[lamp], clipped=cells)
        assert own[0].mark.startswith(mark)
        assert bool(own[0].mark) == bool(mark)
    for deviation, marked_so in ((0.0005, False), (0.002, True)):
        uncertain = replace(line, amplitude_px=0.012, amplitude_deviation_px=deviation)
        assert bool(marked([uncertain], 30.0, 6.0, light=[lamp], clipped=clear)[0].mark) == marked_so
    large = replace(line, amplitude_px=0.05, amplitude_deviation_px=0.03)
    # Uncertain, but far above the light.
    assert not marked([large], 30.0, 6.0, light=[lamp], clipped=clear)[0].mark


def test_an_image_by_the_codec_is_where_its_line_is():
    strong = replace(found().lines[0], hz=2.0, amplitude_px=0.5)
    weak = replace(strong, hz=13.0, amplitude_px=0.2)
    assert "image of 2.000 Hz" in marked([strong, weak], 30.0, 6.0)[1].mark
    elsewhere = np.zeros((2, *strong.cells.shape), bool)
    elsewhere[0, 0, 0] = elsewhere[1, -1, -1] = True
    pair = [replace(line, cells=cells) for line, cells in zip((strong, weak), elsewhere, strict=True)]
    assert not marked(pair, 30.0, 6.0)[1].mark
