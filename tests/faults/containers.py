"""Seeded mutations of files that hold arrays, whole otherwise: checksums, digests and sizes are put right again."""

import contextlib
import io
import json
import struct
import tempfile
import warnings
import zipfile
import zlib
from pathlib import Path

import numpy as np
import torch
from safetensors import safe_open

from tests.faults.mutate import WHOLE, changed, of_bytes, of_json, written
from tg4mm.core.files import json_digest
from tg4mm.core.untrusted import parse_json
from tg4mm.run.tensor_file import DIGEST, write_tensors


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


_TYPES = (np.float16, np.float32, np.float64, np.int32, np.int64, np.uint8, np.bool_)
_WHOLE, _REAL = (0, 1, -1, 2**31 - 1), (np.nan, np.inf, -1.0, 0.0, 1e30, -1e30, 1e-30)
_SHAPES = (  # other shapes of an array
    lambda a: a[:0] if a.ndim else a,
    lambda a: a[: max(len(a) - 1, 0)] if a.ndim else a[None],
    lambda a: a.reshape(-1),
    lambda a: a[None],
    lambda a: a.reshape(-1)[:1].reshape(()) if a.size else a,
)


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
