"""Splat files of every kind that other programs write, put together by the definitions of the formats."""

import base64
import gzip
import io
import itertools
import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.core.splatfile.conftest import random_splat
from tg4mm.core.splatfile import SplatFile
from tg4mm.core.splatfile.formula import y_up
from tg4mm.core.splatfile.ply import write_splat
from tg4mm.core.splatfile.spz import write_spz
from tg4mm.show.export.gltf import write_glb

C0 = 0.28209479177387814

# What a kind keeps: place (scene units), covariance (of the largest), opacity, constant and further coefficients.
EXACT = (1e-6, 1e-5, 1e-6, 1e-6, 1e-6)

KEPT = {
    "compressed PLY": (0.005, 0.02, 0.003, 0.02, 0.02),
    ".splat": (1e-6, 0.05, 0.003, 0.008, None),
    "SPZ 1": (0.002, 0.2, 0.003, 0.014, 0.01),
    "SPZ 2": (1e-5, 0.2, 0.003, 0.014, 0.01),
    "SPZ 3": (1e-5, 0.08, 0.003, 0.014, 0.01),
    "SPZ 4": (1e-5, 0.08, 0.003, 0.014, 0.01),
    "SOG 1": (0.001, 0.05, 0.02, 0.02, 0.01),
    "SOG 2": (0.001, 0.05, 0.003, 0.02, 0.01),
}


def stored(splat: SplatFile) -> dict[str, np.ndarray]:
    """The columns of a 3DGS PLY, float32; −∞ and +∞ where they are the logarithm or logit."""
    k = splat.sh.shape[1] - 1
    rest = splat.sh[:, 1:].transpose(0, 2, 1).reshape(len(splat), 3 * k)
    with np.errstate(divide="ignore"):
        logs, logits = np.log(splat.scales), np.log(splat.opacities) - np.log1p(-splat.opacities)
    columns = {"xyz"[i]: splat.means[:, i] for i in range(3)}
    columns |= {f"f_dc_{i}": splat.sh[:, 0, i] for i in range(3)}
    columns |= {f"f_rest_{i}": rest[:, i] for i in range(3 * k)}
    columns |= {"opacity": logits} | {f"scale_{i}": logs[:, i] for i in range(3)}
    return columns | {f"rot_{i}": splat.quats[:, i] for i in range(4)}


def ply(
    path: Path, columns: dict[str, np.ndarray], form: str = "binary_little_endian", lines: tuple = ()
) -> None:
    """Write a PLY of float and uchar columns in one of its three forms."""
    n = len(next(iter(columns.values())))
    kinds = {name: "u1" if np.asarray(c).dtype == np.uint8 else "f4" for name, c in columns.items()}
    head = ["ply", f"format {form} 1.0", *lines, f"element vertex {n}"]
    head += [f"property {'uchar' if kinds[name] == 'u1' else 'float'} {name}" for name in columns]
    table = np.zeros(n, list(kinds.items()))
    for name, column in columns.items():
        table[name] = column
    if form == "ascii":
        body = "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in table.tolist()).encode()
    else:
        body = table.astype(table.dtype.newbyteorder(">" if "big" in form else "<")).tobytes()
    path.write_bytes("\n".join([*head, "end_header\n"]).encode() + body)


def _ply_as(form: str) -> Callable[[Path, SplatFile], None]:
    return lambda path, splat: ply(path, stored(splat), form)


def _compressed(path: Path, splat: SplatFile) -> None:
    """SuperSplat's compressed PLY, by gsply."""
    import gsply

    columns = stored(splat)
    counts = {"scale": 3, "rot": 4}
    parts = [np.stack([columns[f"{name}_{i}"] for i in range(n)], 1) for name, n in counts.items()]
    rest = None if splat.sh.shape[1] == 1 else splat.sh[:, 1:]
    data = gsply.compress_to_bytes(
        gsply.GSData(splat.means, *parts, columns["opacity"], splat.sh[:, 0], rest)
    )
    path.write_bytes(data)


def _antimatter(path: Path, splat: SplatFile) -> None:
    quats = splat.quats / np.linalg.norm(splat.quats, axis=1, keepdims=True)
    rgba = np.column_stack([0.5 + C0 * splat.sh[:, 0], splat.opacities])
    with path.open("wb") as file:
        for row in range(len(splat)):
            file.write(struct.pack("<6f", *splat.means[row], *splat.scales[row]))
            file.write(bytes(np.clip(np.round(255 * rgba[row]), 0, 255).astype(np.uint8)))
            file.write(bytes(np.clip(np.round(128 + 128 * quats[row]), 0, 255).astype(np.uint8)))


def spz_content(path: Path, splat: SplatFile) -> bytes:
    """What SPZ version 3 packs: the header, then its six sections."""
    write_spz(path, splat)
    return gzip.decompress(path.read_bytes())


def spz_sections(content: bytes) -> list[bytes]:
    """Positions, opacities, colours, scales, rotations, further coefficients."""
    n, degree = struct.unpack_from("<IB", content, 8)
    ends = np.cumsum([16, *(n * size for size in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)))])
    return [content[a:b] for a, b in itertools.pairwise(ends)]


def _spz(version: int) -> Callable[[Path, SplatFile], None]:
    def write(path: Path, splat: SplatFile) -> None:
        content = spz_content(path, splat)
        sections, other = spz_sections(content), y_up(splat)
        if version == 1:
            sections[0] = other.means.astype("<f2").tobytes()
        if version < 3:
            quats = other.quats / np.linalg.norm(other.quats, axis=1, keepdims=True)
            xyz = quats[:, 1:] * np.where(quats[:, :1] < 0, -1, 1)
            sections[4] = np.clip(np.round(127.5 * xyz + 127.5), 0, 255).astype(np.uint8).tobytes()
        head = content[:4] + struct.pack("<I", version) + content[8:16]
        path.write_bytes(
            gzip.compress(head + b"".join(sections), mtime=0) if version < 4 else spz_4(head, sections)
        )

    return write


def spz_4(head: bytes, sections: list[bytes], extensions: bytes = b"") -> bytes:
    """SPZ version 4 of a header of 16 bytes and sections."""
    import zstandard

    packed = [(zstandard.ZstdCompressor().compress(s), len(s)) for s in sections if s]
    table = b"".join(struct.pack("<QQ", len(data), size) for data, size in packed)
    flags = bytes([2 if extensions else 0, len(packed)])
    long = head[:14] + flags + struct.pack("<I12x", 32 + len(extensions))
    return long + extensions + table + b"".join(data for data, _ in packed)


def webp(pixels: np.ndarray) -> bytes:
    """A lossless WebP of [H, W, 4] uint8."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "WEBP", lossless=True, exact=True)
    return out.getvalue()


def sog_parts(splat: SplatFile, version: int = 2) -> tuple[dict[str, Any], dict[str, bytes]]:
    """meta.json and pictures of a SOG. Of degree 1 on each Gaussian has a set of coefficients of its own."""
    n, k = len(splat), splat.sh.shape[1] - 1
    width = 4 * int(np.ceil(np.sqrt(n) / 4))
    pictures: dict[str, bytes] = {}

    def picture(name: str, *columns: np.ndarray) -> str:
        flat = np.full((width * width, 4), 255, np.uint8)
        for c, column in enumerate(columns):
            flat[:n, c] = column
        pictures[f"{name}.webp"] = webp(flat.reshape(width, width, 4))
        return f"{name}.webp"

    logs = np.sign(splat.means) * np.log1p(np.abs(splat.means.astype(float)))
    low, high = logs.min(0), logs.max(0)
    fine = np.round(65535 * (logs - low) / (high - low)).astype(int).T
    quats = splat.quats / np.linalg.norm(splat.quats, axis=1, keepdims=True)
    which = np.abs(quats).argmax(1)
    quats *= np.sign(quats[np.arange(n), which])[:, None]
    others = np.array([np.delete(q, w) for q, w in zip(quats, which, strict=True)])
    turns = np.round(255 * (others * np.sqrt(2) + 1) / 2).astype(np.uint8).T
    scales, colours = np.log(splat.scales), splat.sh[:, 0]
    logits = np.log(splat.opacities) - np.log1p(-splat.opacities)
    if version == 2:
        tables = [{"codebook": np.linspace(a.min(), a.max(), 256).tolist()} for a in (scales, colours)]
        opacities = np.round(255 * splat.opacities)
        bytes_ = [np.round(255 * (a - a.min()) / np.ptp(a)).astype(np.uint8) for a in (scales, colours)]
    else:
        four = np.column_stack([colours, logits])
        tables = [{"mins": a.min(0).tolist(), "maxs": a.max(0).tolist()} for a in (scales, four)]
        bytes_ = [np.round(255 * (a - a.min(0)) / np.ptp(a, axis=0)).astype(np.uint8) for a in (scales, four)]
        opacities = bytes_[1][:, 3]
    meta: dict[str, Any] = {"version": 2, "count": n} if version == 2 else {}
    shape = {} if version == 2 else {"shape": [n, 3]}
    meta["means"] = shape | {
        "mins": low.tolist(),
        "maxs": high.tolist(),
        "files": [picture("means_l", *(fine & 255)), picture("means_u", *(fine >> 8))],
    }
    meta["scales"] = tables[0] | {"files": [picture("scales", *bytes_[0].T)]}
    meta["quats"] = {"files": [picture("quats", *turns, 252 + which)]}
    meta["sh0"] = tables[1] | {"files": [picture("sh0", *bytes_[1].T[:3], opacities)]}
    if k:
        rest = splat.sh[:, 1:]
        sets = np.full((64 * -(-n // 64), k, 4), 255, np.uint8)
        sets[:n, :, :3] = np.round(255 * (rest - rest.min()) / np.ptp(rest))
        pictures["centroids.webp"] = webp(sets.reshape(-1, 64 * k, 4))
        table = {"mins": float(rest.min()), "maxs": float(rest.max())}
        if version == 2:
            table = {"codebook": np.linspace(rest.min(), rest.max(), 256).tolist(), "bands": 3, "count": n}
        labels = picture("labels", np.arange(n) % 256, np.arange(n) // 256)
        meta["shN"] = table | {"files": ["centroids.webp", labels]}
    return meta, pictures


def sog_zip(path: Path, meta: dict[str, Any], pictures: dict[str, bytes]) -> None:
    """Pack a SOG."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in {"meta.json": json.dumps(meta).encode(), **pictures}.items():
            archive.writestr(zipfile.ZipInfo(name), data)


def _sog(version: int) -> Callable[[Path, SplatFile], None]:
    return lambda path, splat: sog_zip(path, *sog_parts(splat, version))


def _gltf(path: Path, splat: SplatFile) -> None:
    """.gltf with its buffer in the text, of the .glb that tg4mm writes."""
    write_glb(path, splat)
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + size])
    text = base64.b64encode(data[28 + size :]).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{text}"
    path.write_text(json.dumps(document))


KINDS: dict[str, tuple[str, Callable[[Path, SplatFile], None]]] = {  # kind → ending, writer
    "ours": (".ply", write_splat),
    "PLY": (".ply", _ply_as("binary_little_endian")),
    "big-endian PLY": (".ply", _ply_as("binary_big_endian")),
    "ASCII PLY": (".ply", _ply_as("ascii")),
    "compressed PLY": (".ply", _compressed),
    ".splat": (".splat", _antimatter),
    **{f"SPZ {v}": (".spz", _spz(v)) for v in (1, 2, 3, 4)},
    **{f"SOG {v}": (".sog", _sog(v)) for v in (1, 2)},
    "glTF, .glb": (".glb", write_glb),
    "glTF, .gltf": (".gltf", _gltf),
}


def write_as(kind: str, folder: Path, splat: SplatFile) -> Path:
    """Write a splat as a file of one of KINDS in `folder`."""
    ending, write = KINDS[kind]
    path = folder / f"a{ending}"
    write(path, splat)
    return path


def still(n: int = 60, k: int = 16, seed: int = 3) -> SplatFile:
    """A scene at rest whose colours every kind can hold."""
    made = random_splat(seed=seed, n=n, k=k, m=0, fps=0.0, n_timesteps=1, unit_scale_m=None)
    sh = np.clip(0.2 * made.sh, -0.4, 0.4)
    sh[:, 0] = np.clip(made.sh[:, 0], -1.7, 1.7)
    return replace(made, sh=sh, time_origin_s=0.0)


def covariances(splat: SplatFile) -> np.ndarray:
    scaled = Rotation.from_quat(splat.quats[:, [1, 2, 3, 0]]).as_matrix() * splat.scales[:, None, :]
    return scaled @ scaled.transpose(0, 2, 1)


def assert_alike(read: SplatFile, want: SplatFile, kept: tuple) -> None:
    place, shape, opacity, constant, rest = kept
    np.testing.assert_allclose(read.means, want.means, atol=place)
    size = want.scales.max(axis=1)[:, None, None] ** 2
    np.testing.assert_allclose(covariances(read) / size, covariances(want) / size, atol=shape)
    np.testing.assert_allclose(read.opacities, want.opacities, atol=opacity)
    np.testing.assert_allclose(read.sh[:, 0], want.sh[:, 0], atol=constant)
    if rest is not None:
        np.testing.assert_allclose(read.sh[:, 1:], want.sh[:, 1:], atol=rest)


def parsed(path):
    """(JSON, {attribute: array}) of a .glb, by the container's own definition."""
    data = path.read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sII I4s", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + length])
    chunk, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert (kind, chunk) == (b"BIN\0", document["buffers"][0]["byteLength"])
    binary = data[28 + length :]

    def array(number):
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        flat = np.frombuffer(binary, "<f4", accessor["count"] * width, view["byteOffset"])
        return flat.reshape(-1, width)

    return document, array
