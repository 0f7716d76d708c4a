"""Entry for Blender's own Python.

    blender --background --python dataset_gen/blender_main.py -- mic --out DIR …

Takes the arguments after `--`; the package need not be installed. With `--job FILE` it is one worker of a
run; then `--threads N` may follow, for pip's bpy, which reads no command line of Blender's.
"""

import contextlib
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))


def import_bpy(threads: int) -> None:
    """Import bpy with so many threads in its pool; 0: as it is, all cores. On Linux; elsewhere nothing is done.

    The pool (oneTBB) gets as many as there are cores that the process may use at that moment.
    """
    if not threads or not sys.platform.startswith("linux"):
        return
    allowed = sorted(os.sched_getaffinity(0))
    first = os.getpid() % len(allowed)  # workers that start together do not all start on one core
    os.sched_setaffinity(0, (allowed + allowed)[first : first + min(threads, len(allowed))])
    try:
        import bpy  # noqa: F401
    finally:
        for thread in os.listdir("/proc/self/task"):
            with contextlib.suppress(OSError):  # one that has ended meanwhile
                os.sched_setaffinity(int(thread), allowed)


def run(arguments: list[str]) -> int:
    """The generator's command line, or one worker."""
    if arguments[:1] == ["--job"]:
        from tg4mm.core.parent import end_with_parent

        end_with_parent()
        if arguments[2:3] == ["--threads"]:
            import_bpy(int(arguments[3]))
        from dataset_gen.worker import work

        return work(Path(arguments[1]))
    from dataset_gen.__main__ import main

    return main(arguments)


if __name__ == "__main__":
    sys.exit(run(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []))
