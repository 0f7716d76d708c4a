"""A folder of one request: gone on with for the same one, refused to any other, one process at a time."""

import os
from pathlib import Path

import pytest

from tg4mm.core.errors import CaptureError, RunError
from tg4mm.core.work_folder import FolderStep as Step
from tg4mm.core.work_folder import WorkFolder, run_steps

ASKED = {"alpha": 5.0, "cameras": {"seed": 0, "views": 3}, "band": None}

RECORD = {"format": "test"}


def folder(path, **changes):
    return WorkFolder(path, "work.json", **changes)


def test_a_new_folder_holds_what_was_asked_and_the_same_request_goes_on(tmp_path):
    work = folder(tmp_path / "a" / "b")
    work.claim(ASKED)
    assert work.read() == ASKED
    (work.path / "done.txt").touch()
    work.claim(ASKED)
    assert sorted(os.listdir(work.path)) == ["done.txt", "work.json"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"alpha": 6.0}, r"was made with alpha = 5\.0, not 6\.0"),
        ({"cameras": {"seed": 7, "views": 3}}, r"was made with cameras\.seed = 0, not 7"),
        ({"band": [1, 2]}, r"was made with band = null, not \[1, 2\]"),
        ({"extra": 1}, r"was made with extra = \(not set\), not 1"),
        ({"alpha": "x" * 500}, r"not \"x{78}…: give"),
    ],
)
def test_the_first_value_that_differs_is_named(tmp_path, change, message):
    folder(tmp_path).claim(ASKED)
    with pytest.raises(CaptureError, match=message):
        folder(tmp_path, error=CaptureError).claim(ASKED | change)
    with pytest.raises(RunError, match=r"not \(not set\)"):
        folder(tmp_path).claim({k: v for k, v in ASKED.items() if k != "band"})
    assert folder(tmp_path).read() == ASKED


def test_values_that_may_change_and_values_that_are_not_shown(tmp_path):
    work = folder(tmp_path, free=("alpha",), others={"cameras": "from other cameras"})
    work.claim(ASKED)
    work.claim(ASKED | {"alpha": 9.0})
    with pytest.raises(RunError, match=r"was made from other cameras: give another folder$"):
        work.claim(ASKED | {"cameras": {"seed": 1, "views": 3}})


@pytest.mark.parametrize("text", ["{", "[]", "NaN", '{"a": 1, "a": 2}', "\xff"])
def test_a_torn_record_is_named(tmp_path, text):
    (tmp_path / "work.json").write_text(text, encoding="latin-1")
    with pytest.raises(RunError, match=r"work\.json (is not readable JSON|holds list, expected an object)"):
        folder(tmp_path).claim(ASKED)


def test_somebody_elses_folder_is_left_alone(tmp_path):
    (tmp_path / "holiday.txt").touch()
    for call in (lambda: folder(tmp_path).claim(ASKED), lambda: folder(tmp_path).locked("works").__enter__()):
        with pytest.raises(RunError, match=r"is not empty and holds no work\.json, but 'holiday\.txt'"):
            call()
    assert os.listdir(tmp_path) == ["holiday.txt"]
    folder(tmp_path, foreign_files="*.png").claim(ASKED)  # of which none is there
    with pytest.raises(RunError, match=r"holiday\.txt is a file, expected a folder"):
        folder(tmp_path / "holiday.txt").claim(ASKED)


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path):
    with pytest.raises(RunError, match=r"^/proc/nobody cannot be written: [^\n]+$"):
        folder(Path("/proc/nobody")).claim(ASKED)


def test_a_second_holder_is_refused_and_nothing_is_left(tmp_path):
    (tmp_path / "mine").mkdir()
    for name in ("new/run", "mine"):
        work = folder(tmp_path / name)
        with work.locked("trains it"):
            assert os.listdir(work.path) == [".lock"]
            with pytest.raises(RunError, match="is in use: another process trains it; wait for it"):
                work.locked("trains it").__enter__()
    assert not (tmp_path / "new" / "run").exists()
    assert os.listdir(tmp_path / "mine") == []


class Made:
    """A chain of steps data → run → page that counts how often each was done; `fail` raises once."""

    def __init__(self, root):
        self.root, self.calls, self.said, self.fail = root, [], [], ""

    def __call__(self, **asked):
        def folder(name):
            path = self.root / name
            path.mkdir(exist_ok=True)
            if self.fail == name:
                self.fail = ""
                raise KeyboardInterrupt
            (path / "file").write_text(f"{name} {asked.get(name, 0)}")
            self.calls.append(name)

        def page():
            (self.root / "page").write_text((self.root / "run" / "file").read_text())
            self.calls.append("page")

        steps = [
            Step("data", "Data", self.root / "data", lambda: folder("data"), {"value": asked.get("data", 0)}),
            Step("run", "Run", self.root / "run", lambda: folder("run"), {"value": asked.get("run", 0)}, ["data"]),
            Step("page", "Page", self.root / "page", page, {}, ["run"]),
        ]  # fmt: skip
        self.calls.clear()
        owned = WorkFolder(self.root, "steps.json", free=("done",))
        owned.claim(RECORD, {**RECORD, "done": {}})
        run_steps(owned, RECORD, steps, self.said.append)
        return list(self.calls)


@pytest.fixture
def made(tmp_path):
    made = Made(tmp_path / "out")
    assert made() == ["data", "run", "page"]
    return made


def test_another_request_does_what_depends_on_it_and_keeps_the_folder_of_before(made):
    assert made(run=1) == ["run", "page"]
    assert (made.root / "page").read_text() == "run 1"
    assert (made.root / "run_1" / "file").read_text() == "run 0"
    assert made(data=1, run=1) == ["data", "run", "page"]
    folders = {p.name for p in made.root.iterdir() if p.is_dir()}
    assert folders == {"data", "data_1", "run", "run_1", "run_2"}
    assert sum("kept as" in line for line in made.said) == 3


def test_a_result_that_is_gone_is_made_again_with_what_reads_it(made):
    (made.root / "page").unlink()
    assert made() == ["page"]
    (made.root / "data" / "file").unlink()
    (made.root / "data").rmdir()
    assert made() == ["data", "run", "page"]


def test_after_a_kill_the_same_request_goes_on_in_the_folder_and_another_begins_a_new_one(made):
    made.fail = "run"
    with pytest.raises(KeyboardInterrupt):
        made(run=1)
    assert made(run=1) == ["run", "page"]
    assert not (made.root / "run_2").exists()
    made.fail = "data"
    with pytest.raises(KeyboardInterrupt):
        made(data=1, run=1)
    assert made(data=2, run=1) == ["data", "run", "page"]
    assert (made.root / "data" / "file").read_text() == "data 2"
    assert made(data=2, run=1) == []
