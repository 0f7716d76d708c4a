"""A card says what the datasets are; every file that is changed, missing or new is named."""

import re
import shutil
import subprocess

import pytest

from tg4mm.cli import main


@pytest.fixture
def folder(data, tmp_path):
    shutil.copytree(data, tmp_path / "sets" / "seed0" / data.name)
    assert main(["bench", "release", str(tmp_path / "sets"), "--version", "1.2"]) == 0
    return tmp_path / "sets"


def test_what_is_passed_on_can_be_checked(folder, data, capsys):
    card = (folder / "README.md").read_text()
    assert "version: 1.2" in card
    assert f"| seed0/{data.name} |" in " ".join(card.split())
    assert main(["bench", "verify", str(folder)]) == 0
    if shutil.which("sha256sum"):
        subprocess.run(["sha256sum", "--quiet", "-c", "SHA256SUMS"], cwd=folder, check=True)
    root = folder / "seed0" / data.name
    (root / "truth" / "motion.npz").write_bytes(b"other")
    (root / "scene.json").unlink()
    (root / "new.txt").touch()
    capsys.readouterr()
    assert main(["bench", "verify", str(folder)]) == 1
    place = f"seed0/{data.name}"
    assert capsys.readouterr().out.splitlines() == [
        f"{place}/scene.json: missing",
        f"{place}/new.txt: is not in SHA256SUMS",
        f"{place}/truth/motion.npz: changed",
    ]


@pytest.mark.parametrize(
    ("sums", "message"),
    [
        (None, "SHA256SUMS cannot be read, tg4mm bench release writes it"),
        ("0" * 64 + "  ../a\n", "line 1: .* is not a checksum and a name below the folder"),
        ("hello\n", "line 1: 'hello' is not"),
    ],
)
def test_a_list_that_will_not_do(sums, message, tmp_path, capsys):
    if sums is not None:
        (tmp_path / "SHA256SUMS").write_text(sums)
    assert main(["bench", "verify", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert re.search(message, err)
    assert err.count("\n") == 1


def test_a_folder_without_datasets_has_no_card(tmp_path, capsys):
    assert main(["bench", "release", str(tmp_path)]) == 2
    assert "holds no dataset" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
