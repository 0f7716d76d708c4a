"""Splat files of other programs, for the harness: the mutations get past gzip, zip and the lengths in headers."""

import gzip
import io
import json
import struct
import zipfile

import numpy as np

from tests.faults.mutate import Mutation, changed, of_bytes, of_header, of_json, written
from tests.faults.reader import Reader
from tests.helpers.splat_files import KINDS, sog_parts, write_as


def _still():
    from tg4mm.core.splatfile import SplatFile

    rng = np.random.default_rng(0)
    shapes = ((12, 3), (12, 4), (12, 3), (12,), (12, 4, 3))
    return SplatFile.static(*(rng.uniform(0.1, 0.9, shape).astype(np.float32) for shape in shapes))


def _make(kind):
    return lambda root: write_as(kind, root, _still())


def _read(root):
    from tg4mm.core.splatfile import read_head, read_splat

    path = next(root.glob("a.*"))
    read_head(path)
    read_splat(path)


def _loose_sog(root):
    meta, pictures = sog_parts(_still())
    for name, data in pictures.items():
        (root / name).write_bytes(data)
    (root / "a.json").write_text(json.dumps(meta))
    return root / "a.json"


def _of_gzip(data, rng):
    return (
        of_bytes(data, rng) if rng.random() < 0.3 else gzip.compress(of_bytes(gzip.decompress(data), rng), 1)
    )


def _of_glb(data, rng):
    if rng.random() < 0.3:
        return of_bytes(data, rng)
    (size,) = struct.unpack_from("<I", data, 12)
    text = written(changed(json.loads(data[20 : 20 + size]), rng))
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    return data[:8] + struct.pack("<II4s", 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def _of_sog(data, rng):
    what, out = rng.random(), io.BytesIO()
    if what < 0.2:
        return of_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        victim = "meta.json" if what < 0.6 else rng.choice(old.namelist())
        for name in old.namelist():
            content = old.read(name)
            if name == victim:
                content = of_json(content, rng) if name == "meta.json" else of_bytes(content, rng)
            new.writestr(name, content)
    return out.getvalue()


_MUTATE: dict[str, Mutation] = {".ply": of_header, ".splat": of_bytes, ".spz": _of_gzip, ".sog": _of_sog}
_MUTATE |= {".glb": _of_glb, ".gltf": of_json}

SPLATS: dict[str, Reader] = {
    **{
        f"splat file: {kind}": Reader(_make(kind), _read, of_bytes if kind == "SPZ 4" else _MUTATE[ending])
        for kind, (ending, _) in KINDS.items()
        if kind != "ours"
    },
    "splat file: SOG in a folder": Reader(_loose_sog, _read, of_json),
}
