"""Sections of the report on what a perfect method would score, how it was rendered, what it takes on disk."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tg4mm.core.pages.page import Block, Section, Table, Text
from tg4mm.core.pages.svg import number, size_text
from tg4mm.core.records import read_formed

from ..tree import TIMING
from .dataset import decibel, plural, similarity
from .noise_floor import FloorRow
from .sections import Findings

_SETTINGS = (
    "engine", "images", "sensor", "seed", "background", "kind", "cameras", "effects", "blender_version",
    "package_version", "source",
)  # fmt: skip


def floor_section(f: Findings) -> Section:
    """For each α: nothing moves, two renders of the truth, a perfect method."""
    title = "What a perfect method would score"
    if not f.floor:
        return Section(title, [Text("There are no test views, so there is nothing to score.")])
    rows: list[list[str]] = []
    styles: list[str] = []
    for row in f.floor:
        own = [
            ("nothing moves", row.still_own_noise, "still"),
            ("nothing moves, same noise", row.still, "still"),
            ("another render of the truth", row.pair, ""),
        ]
        for label, score, style in own:
            if score is not None:
                cells = [
                    f"{row.alpha:g}", label, decibel(score.psnr_db), similarity(score.ssim), str(score.n),
                ]  # fmt: skip
                rows.append(cells)
                styles.append(style)
        if row.pair is not None:
            least = "–" if row.pair.ssim is None else f"≥ {similarity(row.pair.ssim)}"
            rows.append(
                [f"{row.alpha:g}", "perfect method", decibel(row.perfect_psnr_db), least, str(row.pair.n)]
            )
            styles.append("ours")
        if styles:
            styles[-1] = f"{styles[-1]} last".strip()
    table = Table(["α", "what", "PSNR (dB)", "SSIM", "pictures"], rows, _caption(), styles=styles, left=2)
    return Section(title, [Text(_words(f.floor)), table])


def _words(floor: tuple[FloorRow, ...]) -> str:
    if all(row.pair is None for row in floor):
        return (
            "Not measured: report/reseeded/, a second render of some truth pictures with another seed, is absent. "
            "The rows say what a method scores that leaves the scene at rest."
        )
    text = (
        "A method that is right in every respect still differs from the truth by the noise of the renderer and of the "
        "sensor. A second render of the truth with another seed shows how much. "
    )
    if any(row.pair is not None and row.pair.psnr_db >= 100 for row in floor):
        text += "Here the second render is equal: the renderer draws no random numbers, so nothing limits a method. "
    best, still, pair = floor[-1].perfect_psnr_db, floor[-1].still_own_noise, floor[-1].pair
    if best is not None and still is not None and pair is not None:
        # Both without noise of their own: of the pair's squared error half is the truth's.
        apart = 10 ** (-still.psnr_db / 10) - 0.5 * 10 ** (-pair.psnr_db / 10)
        gap = max(0.0, best + 10 * math.log10(apart)) if apart > 0 else 0.0
        text += (
            f"At α = {floor[-1].alpha:g} a method has {gap:.1f} dB between doing nothing and being perfect."
        )
    return text


def _caption() -> str:
    return (
        "PSNR and SSIM (11×11, σ 1.5) over white against the truth, of one test camera where the "
        "motion is largest. “Perfect method”: exact and free of noise, 3.01 dB "
        "above the pair of renders, since the pair differs by the noise of both; for SSIM the pair is a lower bound. "
        "“Nothing moves”: the rest picture of the same camera, with noise of its own; “same noise”: the set’s own "
        "picture nearest to rest, which shares its seed with the truth and so, without a sensor model, agrees to the "
        "last bit where nothing moves, as no method can."
    )


def making_section(f: Findings) -> Section:
    """Render settings and sizes."""
    scene = f.dataset.scene
    rows = [row for key in _SETTINGS if key in scene for row in _flat(key.replace("_", " "), scene[key])]
    blocks: list[Block] = [Table(["setting", "value"], rows, "From scene.json.", left=9)]
    blocks.append(Text(_timing(f)))
    parts = shares(f.dataset.root)
    table = [
        [s.kind, f"{s.names:,}", f"{s.files:,}", size_text(s.on_disk), size_text(s.as_named)] for s in parts
    ]
    totals = [sum(getattr(s, name) for s in parts) for name in ("names", "files", "on_disk", "as_named")]
    table.append(["all", f"{totals[0]:,}", f"{totals[1]:,}", size_text(totals[2]), size_text(totals[3])])
    caption = (
        "Files. Equal pictures are one file with several names (hard links), counted once, where they come up first; "
        "“copied” is what a copy takes that does not keep links."
    )
    header = ["what", "names", "files", "on disk", "copied"]
    blocks.append(Table(header, table, caption, styles=[*[""] * (len(table) - 2), "last", ""]))
    return Section("How it was made", blocks)


def _flat(name: str, value: Any) -> list[list[str]]:
    if isinstance(value, dict):
        return [
            row for key, inner in value.items() for row in _flat(f"{name}: {key}".replace("_", " "), inner)
        ]
    return [[name, "none" if value is None else str(value)]]


def _timing(f: Findings) -> str:
    try:
        timing = read_formed(f.dataset.root / "report/timing.json", TIMING)
    except (OSError, ValueError):
        timing = {}
    if not timing.get("pictures"):
        return "How long the pictures took was not recorded."
    seconds, pictures, processes = timing["seconds"], timing["pictures"], timing.get("processes")
    by = (
        f" by {plural(processes, 'process') if processes == 1 else f'{processes} processes'}"
        if processes
        else ""
    )
    return (
        f"{plural(pictures, 'distinct picture')} in {number(seconds)} s{by}: {number(seconds / pictures)} s each, "
        "data passes included."
    )


KINDS = (
    "training pictures", "test pictures", "magnified ground truth", "per-pixel truth", "exact motion",
    "videos", "surface points", "description and poses",
)  # fmt: skip


@dataclass(frozen=True)
class Share:
    """One kind of file."""

    kind: str
    names: int
    files: int  # distinct
    on_disk: int  # bytes of the distinct files
    as_named: int  # bytes if every name were a file of its own


def shares(root: Path) -> list[Share]:
    """The kinds that are present, in the order of `KINDS`; the report's own folder does not count.

    A file with names of several kinds (a rest picture serves every α) is counted where it comes up first.
    """
    found: dict[str, list[tuple[tuple[int, int], int]]] = {kind: [] for kind in KINDS}
    for path in sorted(root.rglob("*")):
        relative = path.relative_to(root)
        if path.is_file() and relative.parts[0] != "report" and not relative.name.startswith("."):
            stat = path.stat()
            found[_kind(relative)].append(((stat.st_dev, stat.st_ino), stat.st_size))
    seen: set[tuple[int, int]] = set()
    result = []
    for kind, entries in found.items():
        own = {key: size for key, size in entries if key not in seen}
        seen |= own.keys()
        if entries:
            total = sum(size for _, size in entries)
            result.append(Share(kind, len(entries), len(own), sum(own.values()), total))
    return result


def _kind(relative: Path) -> str:
    parts = relative.parts
    if relative.suffix == ".json":
        return "description and poses"
    if parts[0] == "video":
        return "videos"
    if parts[0] == "truth":
        return "exact motion" if relative.name == "motion.npz" else "per-pixel truth"
    if parts[0] == "magnified":
        return "magnified ground truth"
    if relative.suffix == ".ply":
        return "surface points"
    if len(parts) > 1 and parts[1] == "test":
        return "test pictures"
    return "training pictures" if len(parts) > 1 else "description and poses"
