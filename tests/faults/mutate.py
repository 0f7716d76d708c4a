"""Seeded mutations of files: what disks, editors, other programs and hostile people do to them.

A mutation takes a file's bytes and a random generator and gives other bytes; the same generator gives the same.
Those of bytes fit any file; the others know a format well enough to get past its first check.
"""

import contextlib
import copy
import io
import json
import random
import re
import struct
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open

from tg4mm.core.files import json_digest
from tg4mm.core.untrusted import parse_json
from tg4mm.run.tensor_file import DIGEST, write_tensors

Mutation = Callable[[bytes, random.Random], bytes]

WHOLE = (0, 1, -1, 127, 255, 1 << 15, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, (1 << 63) - 1, 10**9)
DEEP, ENDLESS, TWICE = "\ue000deep", "\ue000endless", "\ue000twice"  # markers, replaced in the text
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 0.5, -0.0, 1e-320, 1e308, 10**9, 10**12, 2**63, 10**400),
    *(float("nan"), float("inf"), float("-inf"), DEEP, ENDLESS),
    *("", " ", "x", "nan", "1", "0x10", "../../../../etc/passwd", "/etc/passwd", "C:\\x.png", "a\0b", "\ud800", "%s"),
    *("a\nb", "a" * 300, "a" * 5000, ".", "..", "r_000", "./train/r_001", "é", "1/0", "-1/3", "2020-02-30"),
    *([], {}, [[]], [0], [1, 2], [1, 2, 3], [None], ["x"], [[1]], {"x": 1}, {"": {}}, [0] * 1000, [float("nan")] * 3),
)  # fmt: skip
YAML_TEXTS = (
    *('!!bool "foo"', '!!int ""', "!!timestamp x", "!!map [1]", "!!python/object/apply:os.system [id]"),
    *("!!binary x", "&a [*a]"),
    *("*nowhere", "{? [1] : 2}", "<<: {a: 1}", "=", "~", ".nan", ".inf", "-.inf", "1e999", "2001-99-99"),
    *("0b", "0x_", "1:99:99", "'", '"', "|", ">", "%YAML 9.9", "---", "...", "\t", "[", "{"),
    *("- ", ": ", "# ", "!", "@", "9" * 5000, "[" * 200, "{a: " * 200, "\ufeff", "\x00", "\x85", "a" * 3000),
)  # fmt: skip
_TYPES = (np.float16, np.float32, np.float64, np.int32, np.int64, np.uint8, np.bool_)
_WHOLE, _REAL = (0, 1, -1, 2**31 - 1), (np.nan, np.inf, -1.0, 0.0, 1e30, -1e30, 1e-30)
_SHAPES = (  # other shapes of an array
    lambda a: a[:0] if a.ndim else a,
    lambda a: a[: max(len(a) - 1, 0)] if a.ndim else a[None],
    lambda a: a.reshape(-1),
    lambda a: a[None],
    lambda a: a.reshape(-1)[:1].reshape(()) if a.size else a,
)


def of_bytes(data, rng):
    """One to four small damages, wherever they fall."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = rng.choice(_BYTES)(data, rng)
    return data


def _flip(data, rng):
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        if out:
            out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def _truncate(data, rng):
    return data[: rng.randrange(len(data) + 1)]


def _slice(data, rng):
    start = rng.randrange(len(data) + 1)
    return start, min(len(data), start + rng.choice((1, 2, 4, 8, 32, 256, 4096)))


def _delete(data, rng):
    a, b = _slice(data, rng)
    return data[:a] + data[b:]


def _repeat(data, rng):
    a, b = _slice(data, rng)
    return data[:b] + data[a:b] * rng.choice((1, 2, 100)) + data[b:]


def _insert(data, rng):
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.choice((1, 2, 4, 16, 256))) + data[at:]


def _blank(data, rng):
    a, b = _slice(data, rng)
    return data[:a] + bytes([rng.choice((0, 255))]) * (b - a) + data[b:]


def _number(data, rng):
    """A whole number of 1 to 8 bytes with an extreme value, most often near the start, where headers are."""
    size = rng.choice((1, 2, 4, 8))
    if len(data) < size:
        return data
    most = len(data) - size
    at = rng.randint(0, min(most, 200)) if rng.random() < 0.7 else rng.randint(0, most)
    raw = (rng.choice(WHOLE) % (1 << 8 * size)).to_bytes(size, rng.choice(("little", "big")))
    return data[:at] + raw + data[at + size :]


def _swap(data, rng):
    (a, b), (c, d) = sorted((_slice(data, rng), _slice(data, rng)))
    return data if b > c else data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


_BYTES: tuple[Mutation, ...] = (
    *(_flip, _flip, _truncate, _delete, _repeat, _insert, _blank, _number, _number, _swap),
)


def of_json(data, rng):
    """A value replaced, removed, renamed or doubled; now and then damage to the text."""
    if rng.random() < 0.25:
        return of_bytes(data, rng)
    return written(changed(json.loads(data), rng))


def changed(value, rng):
    """JSON data with one to three places changed."""
    value = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 2, 3))):
        holders = list(_holders(value))
        if not holders:
            return copy.deepcopy(rng.choice(VALUES))
        holder = rng.choice(holders)
        key = rng.choice(list(holder)) if isinstance(holder, dict) else rng.randrange(len(holder))
        what = rng.random()
        if what < 0.7:
            holder[key] = copy.deepcopy(rng.choice(VALUES))
        elif what < 0.85:
            del holder[key]
        elif isinstance(holder, dict):
            name = rng.choice((key + "x", key[:-1], TWICE + key, "", "é"))
            holder[name] = holder[key] if name.startswith(TWICE) else holder.pop(key)
        else:
            holder.insert(key, holder[key])
    return value


def _holders(value):
    if isinstance(value, dict | list):
        if value:
            yield value
        for child in value.values() if isinstance(value, dict) else value:
            yield from _holders(child)


def written(value):
    """JSON text, with what json.dumps cannot write: depth, repeated keys, numbers of any length."""
    text = json.dumps(value, default=str)
    text = text.replace(json.dumps(DEEP), "[" * 100_000 + "]" * 100_000)
    text = text.replace(json.dumps(ENDLESS), "9" * 5000)
    return text.replace(json.dumps(TWICE)[1:-1], "").encode()


def of_text(data, rng):
    """A word of a text replaced by another of its words, a hostile one, or an extreme number."""
    if rng.random() < 0.25:
        return of_bytes(data, rng)
    text = data.decode("latin-1")
    for _ in range(rng.choice((1, 1, 2))):
        words = list(re.finditer(r"[^\s,:\[\]{}]+", text))
        if not words:
            return data
        word = rng.choice(words)
        other = rng.choice(
            (rng.choice(words).group(), rng.choice(YAML_TEXTS), str(rng.choice(WHOLE)), "nan", "1e999")
        )
        text = text[: word.start()] + other + text[word.end() :]
    return text.encode("utf-8" if rng.random() < 0.5 else "latin-1", "replace")


def of_header(data, rng):
    """Mutate a PLY: a word of its text header, or bytes anywhere."""
    end = data.find(b"end_header")
    if end < 0 or rng.random() < 0.4:
        return of_bytes(data, rng)
    return of_text(data[:end], rng) + data[end:]


def of_tensors(data, rng):
    """A safetensors file: its bytes, its header, or its tensors written anew with a digest that is right."""
    what = rng.random()
    if what < 0.3:
        return of_bytes(data, rng)
    if what < 0.5:
        (size,) = struct.unpack_from("<Q", data)
        header = of_json(data[8 : 8 + size], rng)
        return struct.pack("<Q", len(header)) + header + data[8 + size :]
    return _tensors_anew(data, rng)


def _tensors_anew(data, rng):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.safetensors"
        path.write_bytes(data)
        with safe_open(path, framework="pt") as file:
            meta = file.metadata()
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        header = {k: parse_json(v) for k, v in meta.items() if k not in ("format", DIGEST)}
        if rng.random() < 0.3:
            header = changed(header, rng)
        else:
            name = rng.choice(list(tensors))
            other = _other_array(tensors[name].numpy(), rng)
            del tensors[name]
            if other is not None:
                name += rng.choice(("", "", "", "", "", "x", "#re"))
                tensors[name] = torch.from_numpy(np.array(other, order="C"))
        try:
            write_tensors(path, tensors, header)
        except Exception:  # what no writer can write
            return of_bytes(data, rng)
        return path.read_bytes()


def _other_array(array, rng):
    """Another type, shape or value; None: none at all."""
    what = rng.randrange(9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # complex to real
        if what == 0:
            return None
        if what == 1 and array.dtype.kind in "fiucb":
            return array.astype(rng.choice(_TYPES))
        if 2 <= what < 2 + len(_SHAPES):
            return _SHAPES[what - 2](array)
        if array.dtype.kind not in "fiuc" or not array.size:
            return np.zeros(rng.choice((0, 1, 3)), np.float32)
        out = array.reshape(-1).copy()
        where = slice(None) if rng.random() < 0.3 else rng.randrange(out.size)
        numbers = _WHOLE if array.dtype.kind in "iu" else _REAL
        out[where] = np.array(rng.choice(numbers)).astype(out.dtype)
        return out.reshape(array.shape)


def of_sealed(data, rng):
    """JSON with a digest: as any JSON, or its values changed and the digest put right, or left out."""
    if rng.random() < 0.3:
        return of_json(data, rng)
    values = json.loads(data)
    values.pop("digest", None)
    values = changed(values, rng)
    if isinstance(values, dict) and rng.random() < 0.5:
        with contextlib.suppress(ValueError, RecursionError):  # of what no writer can write there is none
            values["digest"] = json_digest(json.loads(written(values)))
    return written(values)


def of_npz(data, rng):
    """Bytes; arrays of another type, shape or value; headers that promise more; methods, pickles and bombs."""
    what = rng.random()
    if what < 0.35:
        return of_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    name = rng.choice(list(parts))
    parts[name] = rng.choice((_other_npy, _other_npy, _promising, of_bytes, _bomb))(parts[name], rng)
    if rng.random() < 0.1:
        parts[rng.choice(("x", "../x.npy", "/x.npy", "rest_99.npy"))] = parts.pop(name)
    out = io.BytesIO()
    method = rng.choice((0, 8, 8, 12, 14))
    with zipfile.ZipFile(out, "w") as archive:
        for name, part in parts.items():  # without a time: the same seed gives the same bytes
            archive.writestr(zipfile.ZipInfo(name), part, method, compresslevel=1)
    packed = out.getvalue()
    if rng.random() < 0.1:  # a method that is none, an encrypted entry, sizes that are lies
        at = packed.rfind(b"PK\x01\x02")
        offset, value = rng.choice(((10, 99), (10, 6), (8, 1), (26, 0x7FFF), (22, 0x7FFF)))
        packed = packed[: at + offset] + struct.pack("<H", value) + packed[at + offset + 2 :]
    return packed


def _other_npy(data, rng):
    array = np.load(io.BytesIO(data), allow_pickle=False)
    other = _other_array(array, rng)
    if other is None:
        other = np.array([{"a": 1}], dtype=object)
    out = io.BytesIO()
    np.save(out, other, allow_pickle=True)
    return out.getvalue()


def _promising(data, rng):
    """A header with another number or word in it, as long as before."""
    size = struct.unpack_from("<H", data, 8)[0]
    text = data[10 : 10 + size].decode("latin-1")
    words = ["(", ")", "'", "descr", "True", "<f4", "<c8", "|O", "<U9", "<V0", "None", "1, 1,"]
    words.append(str(rng.choice(WHOLE)))
    at = rng.randrange(max(len(text) - 20, 1))
    word = rng.choice(words)
    text = (text[:at] + word + text[at + rng.choice((0, len(word))) :])[:size].ljust(size)
    return data[:10] + text.encode("latin-1", "replace") + data[10 + size :]


def _bomb(data, rng):
    """Ten million bytes of zeros, which pack to ten thousand."""
    if rng.random() > 0.05:
        return data
    out = io.BytesIO()
    np.save(out, np.zeros((416_000, 3) if rng.random() < 0.5 else 1_250_000, np.float64))
    return out.getvalue()


def of_png(data, rng):
    """Bytes of a PNG, of one chunk with its checksum put right, or another size in its header."""
    what = rng.random()
    if what < 0.3:
        return of_bytes(data, rng)
    chunks = list(_chunks(data))
    i = 0 if rng.random() < 0.5 else rng.randrange(len(chunks))
    kind, body = chunks[i]
    if i == 0 and rng.random() < 0.7:
        size = rng.choice(((13_000, 13_000), (0, 5), (1 << 31, 1 << 31), (65_535, 1), (1, 1), (12, 9)))
        body = struct.pack(">II", *size) + body[8:]
    else:
        body = of_bytes(body, rng)
    chunks[i] = kind, body
    if rng.random() < 0.1:
        rng.shuffle(chunks)
    sealed = (struct.pack(">I", len(b)) + k + b + struct.pack(">I", zlib.crc32(k + b)) for k, b in chunks)
    return data[:8] + b"".join(sealed)


def _chunks(data):
    at = 8
    while at + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, at)
        yield data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        at += 12 + size
