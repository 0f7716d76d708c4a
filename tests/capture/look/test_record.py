"""What a look found goes through a run's log unchanged."""

import json
from dataclasses import replace

import numpy as np

from tests.helpers.look import found
from tg4mm.capture.look.marks import marked
from tg4mm.capture.look.record import from_record, to_record


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
