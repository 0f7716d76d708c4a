"""Kernels compiled in advance, in other processes, where numba's cache has none for this processor yet.

A kernel is compiled by being called on next to nothing, with the types that the program calls it with, and lies in the
cache from then on. Such calls are jobs, in groups that are needed at about the same time. The first kernel that the
cache lacks starts the processes; the command waits for its group, with a line that counts, and goes on while the other
groups are compiled. A kernel that is in no job the command compiles itself, as it does with all of them where the
processes cannot be started or die.

The program switches it on (`enable`); without that nothing happens. `python -m tg4mm.fit.precompile` compiles every
kernel now. Importing this imports nothing heavy.
"""

import os
import subprocess
import sys
import threading
from pathlib import Path

from tg4mm.core.progress import progress
from tg4mm.fit.rasterize.missing import answer_with

_PROCESSES = 2
_WORK = "from tg4mm.fit.precompile import work; work()"


def work() -> None:
    """What a process does: the jobs named on its input, one a line, each answered by a line when it is done."""
    from tg4mm.fit.kernel_calls import JOBS

    for line in sys.stdin:
        JOBS[line.strip()].call()
        print(line.strip(), flush=True)


class _Jobs:
    """The jobs of this process's command, shared by the threads that each look after one process."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._queue: list[str] = []
        self._begun: set[str] = set()
        self._done: set[str] = set()
        self._looked_after = 0  # processes at work

    def wait(self, kernel: str) -> bool:
        """Whether a kernel (module.function) that the cache lacked may be there now, after the jobs of its group."""
        from tg4mm.fit.kernel_calls import JOB_OF, JOBS, TOGETHER

        if (name := JOB_OF.get(kernel)) is None or name in self._done:
            return False
        asked = JOBS[name].group
        group = [other for other, job in JOBS.items() if job.group in TOGETHER.get(asked, (asked,))]
        with self._changed:
            # what trains will need all; else what is waited for is compiled before what was in the queue
            order = [*group, *(JOBS if asked == "training" else self._queue)]
            self._queue = [other for other in dict.fromkeys(order) if other not in self._begun]
        self._start()
        label = f"compiling kernels for this processor, once ({asked})"
        with progress(label, len(group), "steps") as update, self._changed:
            while self._looked_after and not self._done.issuperset(group):
                update(len(self._done.intersection(group)))
                self._changed.wait(1.0)
            update(len(self._done.intersection(group)))
        return name in self._done

    def _start(self) -> None:
        with self._changed:
            missing = _PROCESSES - self._looked_after if self._queue else 0
            self._looked_after += missing
        for _ in range(missing):
            threading.Thread(target=self._look_after_one, daemon=True).start()

    def _next(self) -> str | None:
        """The next job; None if there is none, and the process that asked is no longer at work."""
        with self._changed:
            if not self._queue:
                self._ended()
                return None
            self._begun.add(self._queue[0])
            return self._queue.pop(0)

    def _ended(self) -> None:
        self._looked_after -= 1
        self._changed.notify_all()

    def _look_after_one(self) -> None:
        """Give a process one job after the other. It ends with its input, hence with this process at the latest."""
        name: str | None = ""
        try:
            path = [str(Path(__file__).parents[2]), *filter(None, [os.environ.get("PYTHONPATH")])]
            environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(path)}
            with subprocess.Popen(
                [sys.executable, "-P", "-c", _WORK], env=environment, text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            ) as process:  # fmt: skip
                assert process.stdin is not None
                assert process.stdout is not None
                while (name := self._next()) is not None:
                    print(name, file=process.stdin, flush=True)
                    if process.stdout.readline().strip() != name:
                        break
                    with self._changed:
                        self._done.add(name)
                        self._changed.notify_all()
        except OSError:  # no process: the command compiles itself
            pass
        finally:
            if name is not None:
                with self._changed:
                    self._ended()


_jobs = _Jobs()


def compile_all() -> None:
    """Have the cache hold every kernel that a job names; what it holds already is loaded, which takes seconds."""
    from tg4mm.fit.kernel_calls import JOB_OF

    for kernel in JOB_OF:
        _jobs.wait(kernel)


def enable() -> None:
    """From now on kernels that the cache lacks are compiled in advance, where there are two cores."""
    if (os.cpu_count() or 1) > 1:
        answer_with(_jobs.wait)


if __name__ == "__main__":
    compile_all()
