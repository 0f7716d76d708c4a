"""Small file systems in memory, which need root."""

import contextlib
import os
import subprocess


@contextlib.contextmanager
def mounted(folder, size):
    """An empty file system of so many bytes at `folder`, which is made."""
    folder.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def fill(folder, left=0):
    """Fill the file system with a file `filler`, but for so many bytes."""
    room = os.statvfs(folder)
    (folder / "filler").write_bytes(b"\1" * max(room.f_bavail * room.f_frsize - left, 0))
