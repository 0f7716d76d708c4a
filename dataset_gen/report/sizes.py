"""What the dataset takes on disk: files by kind, by name and distinct, since many names share one file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

KINDS = (
    "training pictures",
    "test pictures",
    "magnified ground truth",
    "per-pixel truth",
    "exact motion",
    "videos",
    "surface points",
    "description and poses",
)


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
