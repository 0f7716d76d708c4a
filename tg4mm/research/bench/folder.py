"""The folder of a benchmark, with a record of its purpose; a folder of another purpose is refused."""

import hashlib
import os
import platform
import shlex
import subprocess
import sys
import time
import traceback
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

from tg4mm.capture import load_capture
from tg4mm.core import __version__
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.core.files import write_atomic, write_json
from tg4mm.core.values import Maybe
from tg4mm.core.work_folder import WorkFolder, read_object
from tg4mm.research.bench import BenchError

RECORD = "bench.json"
SET = "set.json"
FORMAT, VERSION = "tg4mm-bench", 1
CIRCUMSTANCES = {  # of `circumstances`, as a checked form
    **dict.fromkeys(("command", "date", "tg4mm", "python", "torch", "system", "processor"), str),
    **dict.fromkeys(("cores", "threads"), int),
    "load_average": Maybe(float),
}


def open_folder(out: Path, kind: str) -> None:
    """Make the folder, or continue in one of the same `kind`. Raises BenchError for another one."""
    WorkFolder(out, RECORD, BenchError).claim({"format": FORMAT, "version": VERSION, "kind": kind})


def claim_set(out: Path, label: str, root: Path, digest: str, filmed: str) -> None:
    """Record the dataset of the results in OUT/runs/<label>.

    digest, filmed: of its description, and of its training pictures and cameras. Raises BenchError for results of
    another dataset, or of other training pictures or cameras.
    """
    record = out / "runs" / label / SET
    if record.is_file():
        try:
            found = read_object(record)
        except RunError:  # truncated, and written again
            found = {}
        if found.get("digest", digest) != digest:
            raise BenchError(
                f"dataset {root}: {record.parent} holds results of another one of that name, {found.get('root')}; "
                "give this one as NAME=DIR, or choose another --out"
            )
        if found.get("contents", filmed) != filmed:
            raise BenchError(
                f"dataset {root}: its training pictures or cameras have changed since {record.parent} was begun; "
                "remove that folder, or choose another --out"
            )
    record.parent.mkdir(parents=True, exist_ok=True)
    write_json(record, {"root": str(root), "digest": digest, "contents": filmed})


def files_state(files: Iterable[Path], root: Path) -> list[list[Any]]:
    """Return [name below `root`, bytes, time of change in ns] of each file: another list where one was changed."""
    stats = ((file, file.stat()) for file in files)
    return [[file.relative_to(root).as_posix(), s.st_size, s.st_mtime_ns] for file, s in stats]


def filmed_digest(root: Path) -> str:
    """Return a content digest of the training data (cameras, pictures, points3d.ply), independent of location."""
    files = {*root.glob("[0-9]*/transforms_*.json"), *load_capture(root, split="train").paths}
    files |= {file for file in (root / "points3d.ply",) if file.is_file()}
    state = files_state(sorted(files), root)
    return _content_digest(root, tuple(tuple(entry) for entry in state))


@lru_cache(maxsize=64)  # for every job of a set
def _content_digest(root: Path, state: tuple[tuple[str, int, int], ...]) -> str:
    digest = hashlib.sha256()
    for name, size, _ in state:
        digest.update(f"{name} {size}\n".encode())
        digest.update((root / name).read_bytes())
    return digest.hexdigest()[:16]


def safe_name(text: str) -> str:
    """Return a file's name with letters, digits and - _ . of the text, and _ for others."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in text)


def write_text(path: Path, text: str) -> None:
    """Write a page or a picture, atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def circumstances() -> dict[str, Any]:
    """Return machine, time and versions of the figures, for a page's origin."""
    import torch

    return {
        "command": shlex.join(["tg4mm", *sys.argv[1:]]),
        "date": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
        "tg4mm": _version(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": _cores(),
        "threads": torch.get_num_threads(),
        "load_average": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }


def _version() -> str:
    """Return the version, with the commit in a clone."""
    root = Path(__file__).resolve().parents[3]
    if not (root / ".git").exists():
        return __version__
    command = ["git", "-C", str(root), "describe", "--always", "--dirty=, changed", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return __version__
    return f"{__version__} (commit {done.stdout.strip()})"


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or "unknown processor"


def why_failed(error: Exception, place: Path) -> str:
    """Return one line; the traceback of an unexpected error is written to `place`/traceback.txt."""
    why = str(error) or type(error).__name__
    if isinstance(error, Tg4mmError | OSError | MemoryError):
        return why
    log = place / "traceback.txt"
    log.parent.mkdir(parents=True, exist_ok=True)
    text = "".join(traceback.format_exception(error))
    write_atomic(log, lambda file: file.write_text(text, encoding="utf-8"))
    return f"{type(error).__name__}: {why.splitlines()[0]} ({log})"
