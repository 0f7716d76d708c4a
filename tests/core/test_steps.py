"""Steps of a folder: what is skipped, what is done again, and what is kept."""

import pytest

from tg4mm.core.steps import Step, run_steps
from tg4mm.core.work_folder import WorkFolder

RECORD = {"format": "test"}


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
    assert sorted(p.name for p in made.root.iterdir() if p.is_dir()) == [
        "data",
        "data_1",
        "run",
        "run_1",
        "run_2",
    ]
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
