"""Forms of JSON that tg4mm wrote: what fits is read, what does not is named by its place; digests find edits."""

import json
import re
from typing import Any

import pytest

from tg4mm.core.untrusted import read_formed, write_sealed
from tg4mm.core.values import Just, Maybe, check_form

FORM = {
    "kind": Just("a"),
    "count": int,
    "size": float,
    "name?": str,
    "rows": {float: {"ssim": Maybe(float), str: Maybe(float)}},
    "notes": [str],
    "open?": dict,
    "done?": bool,
}
FITS: dict[str, Any] = {
    "kind": "a", "count": 3, "size": -1e9, "rows": {"20": {"ssim": None, "psnr": 3}}, "notes": [], "else": [1],
}  # fmt: skip


def test_what_fits_is_read_as_it_was_written(tmp_path):
    write_sealed(tmp_path / "a.json", FITS)
    assert read_formed(tmp_path / "a.json", FORM) == FITS
    (tmp_path / "a.json").write_text(json.dumps(FITS))  # from before there was a digest
    assert read_formed(tmp_path / "a.json", FORM) == FITS


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "b"}, "kind is 'b', expected 'a'"),
        ({"count": True}, "count is True, expected a whole number of at least 0"),
        ({"count": -1}, "count is -1, expected a whole number of at least 0"),
        ({"count": 1.0}, "count is 1.0, expected a whole number of at least 0"),
        ({"size": False}, "size is False, expected a finite number"),
        ({"size": 1e31}, "size is 1e+31, expected a finite number"),
        ({"size": float("nan")}, "size is nan, expected a finite number"),
        ({"size": None}, "size is None, expected a finite number"),
        ({"name": 1}, "name is 1, expected text"),
        ({"done": 1}, "done is 1, expected true or false"),
        ({"notes": "x"}, "notes is 'x', expected a list"),
        ({"notes": ["x", None]}, "notes[1] is None, expected text"),
        ({"open": []}, "open is [], expected an object"),
        ({"rows": {"x": {}}}, "rows has the key 'x', expected a number"),
        ({"rows": {"nan": {}}}, "rows has the key 'nan', expected a number"),
        ({"rows": {"5": {}}}, "rows.5 has no ssim"),
        ({"rows": {"5": {"ssim": 1, "flip": "1"}}}, "rows.5.flip is '1', expected a finite number"),
    ],
)
def test_what_does_not_fit_is_named(change, message):
    with pytest.raises(ValueError, match=rf"\A{re.escape(message)}\Z"):
        check_form(FITS | change, FORM)
