"""Releases a folder of datasets: a card of its contents, the same as Croissant metadata, a checksum of every file."""

import hashlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from tg4mm.core import __version__
from tg4mm.core.files import write_json
from tg4mm.core.progress import progress
from tg4mm.core.work_folder import read_object
from tg4mm.research.bench import BenchError
from tg4mm.research.bench.folder import write_text
from tg4mm.research.bench.sets import open_set
from tg4mm.research.text import table

CARD, CROISSANT, SUMS = "README.md", "croissant.json", "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64}) [ *]([^\x00-\x1f]+)")

_HEAD = """---
pretty_name: {name}
version: "{version}"
license: gpl-3.0
tags: [vibration, motion magnification, Gaussian splatting, synthetic]
---

# {name}, version {version}

Generated scenes that vibrate by a fraction of a pixel, with exact ground truth: magnified pictures of the test views,
depth and displacement of their pixels, and the motion of every vertex. Made by tg4mm {program}; layout, axes and units
are in its docs/conventions.md, how methods are compared in docs/protocol.md. Train on `train` alone; tune on no set
that is called a test.

`{croissant}` holds the table below for programs (Croissant 1.0). `sha256sum -c {sums}` or `tg4mm bench verify DIR`
checks every file.
"""
_COLUMNS = dict.fromkeys(("set", "scene", "cameras", "pixels"), "sc:Text") | {
    "views": "sc:Integer", "timesteps": "sc:Integer", "Hz": "sc:Float", "motion, px": "sc:Float",
    "seed": "sc:Text", "noise": "sc:Text", "MiB": "sc:Float",
}  # fmt: skip
_CR = "http://mlcommons.org/croissant/"


def release(root: Path, version: str) -> list[Path]:
    """Write the card, its Croissant metadata, and the checksums of all files in `root`; returns these three files.

    Datasets may lie at any depth.

    Raises BenchError without a dataset, and for an invalid version.
    """
    if not re.fullmatch(r"[\w.+-]+", version):
        raise BenchError(f"--version {version!r}: use only letters, digits, _ . + and -")
    datasets = sorted(file.parent for file in root.rglob("scene.json") if (file.parent / "000").is_dir())
    if not datasets:
        raise BenchError(f"{root} holds no dataset: expected a folder with scene.json and 000/")
    rows = [_row(root, dataset) for dataset in datasets]
    name = root.resolve().name
    card = _HEAD.format(name=name, version=version, program=__version__, sums=SUMS, croissant=CROISSANT)
    write_text(root / CARD, f"{card}\n{table(list(_COLUMNS), rows, text_columns=3)}\n")
    write_json(
        root / CROISSANT,
        _croissant(name, version, rows, dict(_digests(root, [d / "scene.json" for d in datasets]))),
    )
    lines = [f"{digest}  {name}\n" for name, digest in _digests(root, _files(root))]
    write_text(root / SUMS, "".join(lines))
    return [root / CARD, root / CROISSANT, root / SUMS]


def _croissant(name: str, version: str, rows: list[list[str]], digests: Mapping[str, str]) -> dict[str, Any]:
    """Return the card as Croissant 1.0: the description of every set as a file, and the table as records."""
    terms = {key: f"cr:{key}" for key in ("recordSet", "field", "citeAs")}
    context = {"@language": "en", "@vocab": "https://schema.org/", "sc": "https://schema.org/", "cr": _CR, **terms,
               "dct": "http://purl.org/dc/terms/", "conformsTo": "dct:conformsTo",
               "data": {"@id": "cr:data", "@type": "@json"},
               "dataType": {"@id": "cr:dataType", "@type": "@vocab"}}  # fmt: skip
    files = [
        {"@type": "cr:FileObject", "@id": file, "name": file, "contentUrl": file, "encodingFormat": "application/json",
         "sha256": digest} for file, digest in digests.items()
    ]  # fmt: skip
    keys = {column: f"sets/{re.sub('[^A-Za-z]+', '_', column)}" for column in _COLUMNS}
    fields = [{"@type": "cr:Field", "@id": keys[c], "name": keys[c], "description": c, "dataType": kind}
              for c, kind in _COLUMNS.items()]  # fmt: skip
    types = {"sc:Integer": int, "sc:Float": float, "sc:Text": str}
    data = [
        {keys[c]: types[_COLUMNS[c]](cell) for c, cell in zip(_COLUMNS, row, strict=True)} for row in rows
    ]
    return {
        "@context": context, "@type": "sc:Dataset", "conformsTo": f"{_CR}1.0", "name": name, "version": version,
        "description": "Generated scenes that vibrate by a fraction of a pixel, with exact ground truth.",
        "license": "https://www.gnu.org/licenses/gpl-3.0.html", "citeAs": f"tg4mm {__version__}",
        "distribution": files,
        "recordSet": [{"@type": "cr:RecordSet", "@id": "sets", "name": "sets", "field": fields, "data": data}],
    }  # fmt: skip


def _row(root: Path, dataset: Path) -> list[str]:
    data, scene = open_set(dataset, dataset.name), read_object(dataset / "scene.json")
    files = {(s.st_ino, s.st_size) for s in (f.stat() for f in dataset.rglob("*") if f.is_file())}
    mib = sum(size for _, size in files) / 2**20
    pixels, hz, px = f"{data.width}×{data.height}", f"{data.frequency_hz:g}", f"{data.amplitude_px:.2g}"
    cells = (data.scene, data.cameras, pixels, data.n_views, data.n_timesteps, hz, px, scene.get("seed", ""),
             scene.get("noise", "state"), f"{mib:.1f}")  # fmt: skip
    return [dataset.relative_to(root).as_posix(), *map(str, cells)]


def verify(root: Path) -> list[str]:
    """Return a line for each file that is missing, changed or unlisted. Raises BenchError without a valid list."""
    wanted = dict(_listed(root / SUMS))
    present = {file.relative_to(root).as_posix() for file in _files(root)}
    found = [f"{name}: missing" for name in wanted if name not in present]
    found += [f"{name}: is not in {SUMS}" for name in sorted(present - set(wanted))]
    there = [root / name for name in wanted if name in present]
    return found + [f"{name}: changed" for name, digest in _digests(root, there) if digest != wanted[name]]


def _listed(file: Path) -> Iterator[tuple[str, str]]:
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BenchError(f"{file} cannot be read, tg4mm bench release writes it: {error}") from None
    for number, line in enumerate(lines, 1):
        found = _LINE.fullmatch(line)
        path = None if found is None else PurePosixPath(found[2])
        if found is None or path is None or path.is_absolute() or ".." in path.parts:
            raise BenchError(
                f"{file}, line {number}: {line[:80]!r} is not a checksum and a name below the folder"
            )
        yield found[2], found[1]


def _files(root: Path) -> list[Path]:
    return sorted(file for file in root.rglob("*") if file.is_file() and file != root / SUMS)


def _digests(root: Path, files: list[Path]) -> Iterator[tuple[str, str]]:
    """Yield each file's name below the root and its SHA-256, which is computed once for hard links."""
    known: dict[tuple[int, int], str] = {}
    with progress("checksums", len(files), unit="files", brief=True) as update:
        for done, file in enumerate(files, 1):
            stat = file.stat()
            key = (stat.st_dev, stat.st_ino)
            if key not in known:
                with file.open("rb") as stream:
                    known[key] = hashlib.file_digest(stream, "sha256").hexdigest()
            yield file.relative_to(root).as_posix(), known[key]
            update(done)
