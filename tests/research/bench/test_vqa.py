"""Video quality by a checkout: its program is run on a video, and its last number is the score."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tg4mm.research.bench import BenchError
from tg4mm.research.bench.vqa import PROGRAMS, Checkout, checkouts

VIDEO = np.full((4, 32, 32, 3), 128, np.uint8)


def checkout(folder: Path, metric: str, program: str) -> Checkout:
    (folder / PROGRAMS[metric][0]).write_text(program)
    (found,) = checkouts({metric: folder}, sys.executable)
    return found


def test_the_two_are_called_as_their_authors_say(tmp_path: Path) -> None:
    says = "import sys\nassert open(sys.argv[-1], 'rb').read(12)[4:8] == b'ftyp'\n"
    md = checkout(
        tmp_path, "md_vqa", says + "assert sys.argv[1] == '-i'\nprint('loaded 3 models')\nprint(81.04)\n"
    )
    assert md(VIDEO, 30.0) == 81.04
    line = "print('The quality score of the video (range [0,1]) is 0.20890.', sys.argv[1:4] == [])\n"
    fast = checkout(tmp_path, "fast_vqa", says + "assert sys.argv[1:4] == ['-m', 'FAST-VQA', '-v']\n" + line)
    assert fast(VIDEO, 30.0) == pytest.approx(0.2089)


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("raise SystemExit('no weights')", "status 1: no weights"),
        ("print('none')", "the last line that it printed is 'none', expected one with the score"),
        ("print('loaded 3 models')\nprint('score: nan')", "the last line that it printed is 'score: nan'"),
        ("", "the last line that it printed is ''"),
    ],
)
def test_what_goes_wrong_is_said(tmp_path: Path, program: str, message: str) -> None:
    with pytest.raises(BenchError, match=message):
        checkout(tmp_path, "md_vqa", program)(VIDEO, 30.0)


def test_a_folder_without_the_program(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"--fast-vqa .*: holds no vqa.py"):
        checkouts({"fast_vqa": tmp_path}, "python3")
