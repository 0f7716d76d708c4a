"""Plain data from files of unknown origin: limits are kept, damage is one line, good files are read as they are."""

import contextlib
import io
import struct
import time
import zipfile

import numpy as np
import pytest

from tg4mm.core import untrusted
from tg4mm.core.untrusted import parse_json, parse_yaml, read_json, read_npz


def refused(call, match):
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)


class TestJson:
    @pytest.mark.parametrize(
        ("text", "match"),
        [
            ("{", "line 1 is not JSON"),
            ("[1,\n2,]", "line 2 is not JSON"),
            ("", "line 1 is not JSON"),
            ("[" * 100_000, "nested more than 64 deep"),
            ("[" * 65 + "]" * 65, "nested more than 64 deep"),
            ('{"a": 1, "a": 2}', "key 'a' is there twice"),
            ("9" * 5000, "a whole number of 5000 digits"),
            ("-" + "9" * 4000, "a whole number of 4001 digits"),
            ('["\\ud800"]', r"the text '\\ud800', which is not Unicode"),
            ('{"\\udfff": 1}', "which is not Unicode"),
        ],
    )
    def test_what_would_trip_others_is_refused(self, text, match):
        refused(lambda: parse_json(text), match)

    def test_a_file_that_is_too_long_or_no_text_is_refused(self, tmp_path):
        path = tmp_path / "a.json"
        path.write_bytes(b" " * 101)
        refused(lambda: read_json(path, 100), "has more than 100 bytes")
        path.write_bytes(b'"\xe9"')
        refused(lambda: read_json(path), "is not UTF-8 text: .* at byte 1")


class TestYaml:
    @pytest.mark.parametrize(
        ("text", "match"),
        [
            ('a: !!bool "foo"', "line 1 has the tag tag:yaml.org,2002:bool"),
            ('a: 1\nb: !!int ""', "line 2 has the tag"),
            ("a: !!timestamp x", "has the tag"),
            ("a: !!map [1]", "has the tag"),
            ("a: !mine x", "has the tag !mine"),
            ("!!python/object/apply:os.system [id]", "has the tag"),
            ("a: 2001-99-99", "month must be in 1..12"),
            ("a: [", "is not YAML"),
            ("a: &x [*x]", "line 1 is not YAML: found unconstructable recursive node"),
            ("? [1]\n: 2", r"key \[1\] is not text"),
            ("{a: 1, a: 2}", "key 'a' is there twice"),
            ("[" * 60_000, "nested more than 64 deep"),
            ("a: " + "9" * 4000, "a whole number of more than 20 digits"),
            ("# " + "x" * (64 << 10), "has more than 65536 bytes"),
        ],
    )
    def test_what_would_trip_others_is_refused(self, text, match):
        refused(lambda: parse_yaml(text), match)

    def test_aliases_cannot_stand_for_billions(self):
        lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
        lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 10)]
        refused(lambda: parse_yaml("\n".join(lines)), "stands for more than 100000 values")

    @pytest.mark.parametrize("line", ["- {a: [1, 2], b: 'x'}\n", "- - - - 1\n", "? a\n", "&x "])
    def test_the_longest_is_read_or_refused_in_seconds(self, line):
        began = time.monotonic()
        text = (line * (64 << 10))[: 64 << 10]
        with contextlib.suppress(ValueError):
            parse_yaml(text)
        assert time.monotonic() - began < 5


def npz(path, **parts):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(f"{name}.npy", data)
    return path


def npy(array):
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


class TestNpz:
    @pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
    def test_what_numpy_writes_is_read(self, tmp_path, save):
        arrays = {
            "whole": np.arange(12, dtype=np.int32).reshape(3, 4), "turned": np.arange(12.0).reshape(3, 4).T,
            "complex": np.ones((2, 3), np.complex64), "names": np.array(["a", "ü"]), "one": np.array(2.5),
            "none": np.zeros((0, 3), np.float32), "flags": np.array([True, False]), "zeros": np.zeros(100_000),
        }  # fmt: skip
        save(tmp_path / "a.npz", **arrays)
        read = read_npz(tmp_path / "a.npz")
        assert list(read) == list(arrays)
        for name, array in arrays.items():
            assert read[name].dtype == array.dtype
            np.testing.assert_array_equal(read[name], array)

    def test_pickles_are_not_opened(self, tmp_path):
        path = npz(tmp_path / "a.npz", a=npy(np.array([{"a": 1}], dtype=object)))
        refused(lambda: read_npz(path), "Python objects")

    def test_a_bomb_is_refused_before_it_is_unpacked(self, tmp_path, monkeypatch):
        monkeypatch.setattr(untrusted, "NPZ_BYTES", 1 << 20)
        path = npz(tmp_path / "a.npz", a=npy(np.zeros(1 << 17)), b=npy(np.zeros(1)))
        assert path.stat().st_size < 4096
        refused(lambda: read_npz(path), "unpacks to 1048[0-9]* bytes; expected at most 1048576")

    @pytest.mark.parametrize(
        ("form", "offset", "value", "match"),
        [
            ("<I", 24, 1 << 29, "promises 536870912 bytes, more than it can hold"),
            ("<H", 10, 99, "method 99"),
            ("<H", 8, 1, "encrypted"),
        ],
    )
    def test_other_packings_and_sizes_that_are_lies_are_refused(self, tmp_path, form, offset, value, match):
        path = npz(tmp_path / "a.npz", a=npy(np.zeros(4)))
        raw = bytearray(path.read_bytes())
        struct.pack_into(form, raw, raw.rfind(b"PK\x01\x02") + offset, value)
        path.write_bytes(raw)
        refused(lambda: read_npz(path), match)

    def test_a_header_that_promises_more_than_there_is_is_refused(self, tmp_path):
        data = npy(np.zeros(4)).replace(b"(4,)", b"(9999999999999,)")
        path = npz(tmp_path / "a.npz", a=data)
        refused(lambda: read_npz(path), "its header says float64")

    @pytest.mark.parametrize("code", [0x110000, 0xFFFFFFFF, 0xD800])
    @pytest.mark.parametrize("order", "<>")
    def test_text_that_is_no_unicode_is_refused(self, tmp_path, code, order):
        text = np.array(["a", "bc"], f"{order}U2")
        assert read_npz(npz(tmp_path / "a.npz", a=npy(text)))["a"].tolist() == ["a", "bc"]
        text.view(f"{order}u4")[1] = code
        path = npz(tmp_path / "a.npz", a=npy(text))
        refused(lambda: read_npz(path), "a text that is not Unicode")

    def test_what_is_no_archive_is_refused(self, tmp_path):
        (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 and no more")
        refused(lambda: read_npz(tmp_path / "a.npz"), "not a zip file")
        with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
            archive.writestr("../a.txt", "x")
        refused(lambda: read_npz(tmp_path / "b.npz"), "holds '../a.txt', which is no array")
