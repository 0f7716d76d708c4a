"""Every kind of splat file that people have is read, and what cannot be read is refused in one line."""

import contextlib
import gzip
import json
import re
import struct
import subprocess
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tests.core.splatfile.conftest import assert_same, random_splat
from tests.core.splatfile.formats.conftest import NODE
from tests.helpers.splat_files import (
    EXACT,
    KEPT,
    KINDS,
    assert_alike,
    ply,
    sog_parts,
    sog_zip,
    spz_4,
    spz_content,
    spz_sections,
    still,
    stored,
    write_as,
)
from tg4mm.core.errors import SplatFileError
from tg4mm.core.splatfile import SplatFile, read_head, read_splat, write_splat
from tg4mm.core.splatfile.formula import transformed
from tg4mm.core.splatfile.model import Head

WRITTEN = {  # by splat-transform: name, options, from PLY's axes to ours, what is kept
    "a.compressed.ply": ((), np.eye(3), KEPT["compressed PLY"]),
    "a.sog": ((), np.eye(3), (0.001, 0.1, 0.004, 0.02, None)),
    "folder/meta.json": ((), np.eye(3), (0.001, 0.1, 0.004, 0.02, None)),
    "b.spz": (("--spz-version", "3"), [[1, 0, 0], [0, 0, 1], [0, -1, 0]], (3e-4, 0.08, 0.003, 0.014, 0.12)),
    "c.spz": (("--spz-version", "4"), [[1, 0, 0], [0, 0, 1], [0, -1, 0]], (3e-4, 0.08, 0.003, 0.014, 0.12)),
    "a.glb": ((), [[-1, 0, 0], [0, 0, -1], [0, -1, 0]], (1e-6, 1e-4, 1e-5, 1e-5, 1e-5)),
}


@pytest.mark.parametrize("k", [1, 16])
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_comes_back(kind, k, tmp_path):
    splat = still(k=k)
    path = write_as(kind, tmp_path, splat)
    read, head = read_splat(path), read_head(path)
    assert_alike(read, splat, KEPT.get(kind, EXACT))
    assert (head.count, head.n_modes, head.n_lost, read.notes) == (60, 0, 0, ())
    assert head.y_up is kind.startswith(("SPZ", "glTF"))


@pytest.fixture(scope="session")
def splat_transform(tmp_path_factory):
    """Run PlayCanvas's splat-transform, from one file to another. Skips where npm's packages are not there."""
    program = NODE / "node_modules" / "@playcanvas" / "splat-transform" / "bin" / "cli.mjs"
    if not program.exists():
        pytest.skip("needs node and npm's packages: make readers")

    def run(source, target, *options):
        words = ["node", program, "-q", "-w", "-g", "cpu", *options, source, target]
        done = subprocess.run(words, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    return run


@pytest.mark.parametrize("name", WRITTEN)
def test_what_splat_transform_writes_is_read(name, splat_transform, tmp_path):
    """An independent writer of all but .splat; it sorts Gaussians, and turns a PLY's Y down to the format's Y up."""
    splat = still(n=300)
    (tmp_path / "folder").mkdir()
    ply(tmp_path / "a.ply", stored(splat))
    options, turn, kept = WRITTEN[name]
    splat_transform(tmp_path / "a.ply", tmp_path / name, *options)
    read, want = read_splat(tmp_path / name), transformed(splat, np.array(turn, float))
    order = [int(np.argmin(((want.means - mean) ** 2).sum(axis=1))) for mean in read.means]
    assert sorted(order) == list(range(300))
    fields = {f: getattr(want, f)[order] for f in ("means", "quats", "scales", "opacities", "sh")}
    assert_alike(read, SplatFile.static(**fields), kept)


@pytest.mark.parametrize(
    "kind", ["PLY", "compressed PLY", ".splat", "SPZ 2", "SPZ 3", "SPZ 4", "SOG 1", "SOG 2"]
)
def test_what_splat_transform_reads_is_what_we_read(kind, splat_transform, tmp_path):
    """An independent reader of what the tests' own writers make."""
    path = write_as(kind, tmp_path, still())
    splat_transform(path, tmp_path / "out.ply")
    read, other = read_splat(path), read_splat(tmp_path / "out.ply")
    if read_head(path).y_up:
        other = transformed(other, np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
    k = min(read.sh.shape[1], other.sh.shape[1])
    assert k == (1 if kind == ".splat" else 16)
    read, other = (replace(one, sh=one.sh[:, :k]) for one in (read, other))
    assert_alike(read, other, (1e-5, 0.02, 1e-3, 1e-3, 1e-3))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A small file of every kind."""
    made = {}
    for kind in KINDS:
        folder = tmp_path_factory.mktemp("kind")
        made[kind] = write_as(kind, folder, still(n=5, k=4))
    return made


def one_line(path):
    """The refusal of a file that must not be read."""
    with pytest.raises(SplatFileError) as caught:
        read_splat(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: "), message
    assert "\n" not in message
    return message


@settings(deadline=None, max_examples=300)
@given(st.sampled_from(list(KINDS)), st.floats(0, 1, exclude_max=True))
def test_a_file_cut_anywhere_is_refused(files, tmp_path_factory, kind, part):
    data = files[kind].read_bytes()
    cut = int(part * len(data))
    path = tmp_path_factory.getbasetemp() / f"cut{files[kind].suffix}"
    path.write_bytes(data[:cut])
    if kind == ".splat" and cut and cut % 32 == 0:  # it has no header: what is left is a file
        assert len(read_splat(path)) == cut // 32
    elif kind == "ASCII PLY" and b"\n" not in data[cut:-1]:  # in its last line: the last number may be whole
        with contextlib.suppress(SplatFileError):
            assert "its last line has no end" in read_splat(path).notes[0]
    else:
        one_line(path)


def count_changed(kind, path, count):
    """Write a larger number of Gaussians where the file says it."""
    data = path.read_bytes()
    if path.suffix == ".ply":
        data = data.replace(b"element vertex 5", f"element vertex {count}".encode())
    elif kind == "SPZ 4":
        data = data[:8] + struct.pack("<I", count) + data[12:]
    elif kind.startswith("SPZ"):
        content = gzip.decompress(data)
        data = gzip.compress(content[:8] + struct.pack("<I", count) + content[12:])
    elif kind.startswith("SOG"):
        meta, pictures = sog_parts(still(n=5, k=4), int(kind[-1]))
        if kind == "SOG 2":
            meta["count"] = count
        else:
            meta["means"]["shape"] = [count, 3]
        sog_zip(path, meta, pictures)
        return
    else:
        data = re.sub(rb'"count":( ?)5', rf'"count":\g<1>{count}'.encode(), data)
        if kind == "glTF, .glb":  # its JSON may have grown
            size = struct.unpack_from("<I", path.read_bytes(), 12)[0] + len(data) - len(path.read_bytes())
            text = data[20 : 20 + size]
            data = data[:8] + struct.pack("<II4s", len(data), size, b"JSON") + text + data[20 + size :]
    path.write_bytes(data)


@pytest.mark.parametrize("count", [6, 300, 70_000, 4_000_000_000])
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != ".splat"])
def test_a_count_that_is_too_large_is_refused_without_giving_memory_for_it(kind, count, tmp_path):
    path = write_as(kind, tmp_path, still(n=5, k=4))
    count_changed(kind, path, count)
    tracemalloc.start()
    one_line(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6


@pytest.mark.parametrize("kind", ["PLY", "big-endian PLY", "ASCII PLY"])
def test_legal_infinities_are_read_and_the_others_left_out_with_their_count(kind, tmp_path):
    columns = stored(still(n=12, k=4))
    columns["opacity"][3] = np.inf
    columns["opacity"][4] = -np.inf
    columns["scale_1"][5] = -np.inf
    columns["x"][0] = np.nan
    columns["f_rest_2"][1] = np.inf
    columns["scale_0"][2] = 120.0  # its exponential is past float32
    for i in range(4):
        columns[f"rot_{i}"][6] = 0
    form = {"PLY": "binary_little_endian", "big-endian PLY": "binary_big_endian", "ASCII PLY": "ascii"}[kind]
    ply(tmp_path / "a.ply", columns, form)
    read = read_splat(tmp_path / "a.ply")
    assert len(read) == 12 - 4
    assert read.opacities[:2].tolist() == [1, 0]  # rows 3 and 4
    assert read.scales[2, 1] == 0
    notes = " | ".join(read.notes)
    assert "1 of 12 Gaussians have a scale of log 0: read as flat" in notes
    assert "2 of 12 Gaussians have an infinite logit: read as opacity 0 or 1" in notes
    assert "4 of 12 Gaussians are left out, for a position that is no finite number (1), " in notes
    for why in (
        "a scale that is no finite number",
        "a colour that is no finite number",
        "a rotation of zero",
    ):
        assert f"{why} (1)" in notes


def test_motion_that_is_no_number_takes_its_gaussian_along(tmp_path):
    splat = random_splat(n=6, m=2, deviation=True)
    splat.displacement[1, 4, 2] = np.nan + 1j
    with pytest.raises(SplatFileError):  # our own writer writes no such thing
        write_splat(tmp_path / "a.ply", splat)
    good = random_splat(n=6, m=2, deviation=True)
    write_splat(tmp_path / "a.ply", good)
    data = (tmp_path / "a.ply").read_bytes()
    at = data.index(np.float32(good.displacement[1, 4, 2].real).tobytes())
    (tmp_path / "a.ply").write_bytes(data[:at] + np.float32(np.nan).tobytes() + data[at + 4 :])
    read = read_splat(tmp_path / "a.ply")
    assert read.notes == ("1 of 6 Gaussians are left out, for a motion that is no finite number (1)",)
    np.testing.assert_array_equal(read.displacement, np.delete(good.displacement, 4, axis=1))
    np.testing.assert_array_equal(read.deviation, np.delete(good.deviation, 4, axis=1))


def test_mip_splattings_filter_is_honoured(tmp_path):
    splat, smooth = still(n=20, k=1), np.random.default_rng(0).uniform(0, 0.05, 20).astype(np.float32)
    ply(tmp_path / "a.ply", stored(splat) | {"filter_3D": smooth})
    read = read_splat(tmp_path / "a.ply")
    wide = np.sqrt(splat.scales**2 + smooth[:, None] ** 2)
    np.testing.assert_allclose(read.scales, wide, rtol=1e-5)
    part = np.sqrt((splat.scales**2).prod(1) / (wide**2).prod(1))
    np.testing.assert_allclose(read.opacities, splat.opacities * part, rtol=1e-4)
    assert read.notes == ("Mip-Splatting's filter_3D is in the scales and opacities",)


def test_flat_discs_are_read_as_such(tmp_path):
    columns = stored(still(n=4, k=1))
    del columns["scale_2"]
    ply(tmp_path / "a.ply", columns)
    read = read_splat(tmp_path / "a.ply")
    assert not read.scales[:, 2].any()
    np.testing.assert_allclose(read.scales[:, 1], np.exp(columns["scale_1"]), rtol=1e-6)
    assert read.notes == ("2D Gaussian splatting: flat discs, read as Gaussians of no thickness",)


def test_degree_four_is_cut_to_three_and_said(tmp_path):
    splat = still(n=4)
    columns = {n: c for n, c in stored(splat).items() if not n.startswith("f_rest")}
    rest = np.zeros((4, 3, 24), np.float32)
    rest[:, :, :15] = splat.sh[:, 1:].transpose(0, 2, 1)
    rest[:, :, 15:] = 9
    columns |= {f"f_rest_{i}": rest.reshape(4, 72)[:, i] for i in range(72)}
    ply(tmp_path / "a.ply", columns)
    read = read_splat(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.sh, splat.sh)
    assert read.notes == ("its spherical harmonics of degree 4 are cut to degree 3",)


def test_names_as_cloudcompare_writes_them(tmp_path):
    splat = still(n=4)
    columns = {n if n in "xyz" else f"scalar_{n}": c for n, c in stored(splat).items()}
    ply(tmp_path / "a.ply", columns)
    assert_alike(read_splat(tmp_path / "a.ply"), splat, EXACT)


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda c: {n: c[n] for n in "xyz"}, "is a point cloud, without opacity, scale and rotation"),
        (lambda c: {n: v for n, v in c.items() if n != "rot_3"}, "property rot_3 is missing, 1 in all"),
        (lambda c: c | {"f_rest_9": c["x"]}, "has 10 f_rest properties"),
        (lambda c: c | {"opacity": np.zeros(5, np.uint8)}, "property opacity is a whole number type"),
    ],
)
def test_strange_columns(change, part, tmp_path):
    ply(tmp_path / "a.ply", change(stored(still(n=5, k=4))))
    assert part in one_line(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("name", "data", "part"),
    [
        ("a.ksplat", b"\0\1" + bytes(500), "is KSPLAT, of one viewer alone: not read"),
        ("a.splatv", bytes(500), "is SPLATV, a 4D format"),
        ("params.npz", b"PK\3\4" + bytes(500), "is a NumPy archive, as Dynamic 3D Gaussians"),
        ("a.pth", b"PK\3\4" + bytes(500), "is a checkpoint of PyTorch"),
        ("a.usdc", b"PXR-USDC" + bytes(90), "is USD: not read"),
        ("a.spz", b"hello" * 30, "does not begin as .spz files do"),
        (
            "a.splat",
            b"hello",
            "is 5 bytes long, not a positive multiple of the 32 bytes per Gaussian of a .splat",
        ),
        ("a.sog", b"PK\x03\x04" + bytes(90), "is damaged"),
        ("a.json", b'{"a": 1}', "is JSON, but neither glTF nor the meta.json of a SOG"),
        ("a.gltf", b'{"asset": {"version": "2.0"}}', "is glTF without Gaussian splats"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
            "is missing",
        ),
    ],
)
def test_files_of_other_kinds_are_named(name, data, part, tmp_path):
    (tmp_path / name).write_bytes(data)
    assert part in one_line(tmp_path / name)


def test_a_picture_with_loss_and_a_name_that_leads_away_are_refused(tmp_path):
    meta, pictures = sog_parts(still(n=5, k=1))
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "x.webp", lossless=False)
    sog_zip(tmp_path / "a.sog", meta, pictures | {"quats.webp": (tmp_path / "x.webp").read_bytes()})
    assert "quats.webp is a WebP with loss" in one_line(tmp_path / "a.sog")
    meta["quats"]["files"] = ["../x.webp"]
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "meta.json").write_text(json.dumps(meta))
    for name, data in pictures.items():
        (tmp_path / "in" / name).write_bytes(data)
    assert "names the file '../x.webp', which is not beside it" in one_line(tmp_path / "in" / "meta.json")


def test_axes_that_an_extension_of_spz_names_are_honoured(tmp_path):
    splat = still(n=6)
    content = spz_content(tmp_path / "b.spz", splat)
    head = content[:4] + struct.pack("<I", 4) + content[8:16]
    for system, turn in ((4, np.eye(3)), (6, np.diag([1, -1, -1])), (12, [[1, 0, 0], [0, 0, 1], [0, -1, 0]])):
        extension = struct.pack("<IIIIII", 0xADBE0002, 4, 7, 0xADBE0003, 4, system)  # RUB, RDF, RFU
        (tmp_path / "a.spz").write_bytes(spz_4(head, spz_sections(content), extension))
        to_y_up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
        want = transformed(splat, to_y_up.T @ np.array(turn, float) @ to_y_up)
        assert_alike(read_splat(tmp_path / "a.spz"), want, KEPT["SPZ 4"])


def test_zstd_is_asked_for_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "zstandard", None)
    path = write_as("SPZ 3", tmp_path, still(n=3))
    assert len(read_splat(path)) == 3
    monkeypatch.undo()
    path = write_as("SPZ 4", tmp_path, still(n=3))
    monkeypatch.setitem(sys.modules, "zstandard", None)
    assert "is SPZ 4, packed by zstd, for which the Python module zstandard is needed" in one_line(path)
    assert read_head(path) == Head("SPZ 4", 3, y_up=True)


def test_a_file_that_lost_its_frequencies_opens_still_or_with_those_that_are_said(tmp_path):
    splat = random_splat(m=2, unit_scale_m=None)
    path = tmp_path / "a.ply"
    write_splat(path, splat)
    path.write_bytes(re.sub(rb"comment tg4mm .*\n", b"", path.read_bytes()))
    still_read, head = read_splat(path), read_head(path)
    assert (still_read.n_modes, head.n_modes, head.n_lost) == (0, 0, 2)
    said = "opened without motion: it has 24 mode properties but no 'comment tg4mm' line"
    assert still_read.notes[0].startswith(said)
    said = read_splat(path, freqs_hz=splat.freqs_hz, fps=30.0)
    kept = {"notes": (), "n_timesteps": splat.n_timesteps, "time_origin_s": splat.time_origin_s}
    assert_same(replace(said, **kept), splat)
    assert said.n_timesteps == round(30 / splat.freqs_hz.min())
    with pytest.raises(SplatFileError, match="1 frequencies were given, but the file has 24 mode properties"):
        read_splat(path, freqs_hz=[5.0])
    with pytest.raises(SplatFileError, match=r"fps is 0; expected"):
        read_splat(path, freqs_hz=[5.0, 6.0], fps=0)
