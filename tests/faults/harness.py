"""Mutations of every reader's files, each read in a child process that may neither crash, hang nor take much memory.

A fault is any exception but Tg4mmError, a process that dies, more than LIMIT_S seconds, and a file left or changed
beside the one that is read.
"""

import json
import os
import random
import resource
import select
import shutil
import tempfile
import time
import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.readers import READERS
from tg4mm.core.errors import Tg4mmError

MEMORY = 3 << 30  # bytes of address space beyond what the process has before it reads
LIMIT_S = 20.0  # seconds for one file
FIRST_S = 300.0  # for the first, before which everything is imported and compiled


@dataclass
class Tally:
    """What became of one reader's inputs."""

    read: int = 0  # accepted: the mutation did no harm, or none that is visible
    refused: int = 0
    faults: list[tuple[int, str]] = field(default_factory=list)  # number of the mutation, what happened

    @property
    def count(self):
        return self.read + self.refused + len(self.faults)


def mutated(name, seed, index, sample):
    """The `index`-th mutation of a reader's sample; the same in every process."""
    return READERS[name].mutate(sample, random.Random(f"{seed} {name} {index}"))


def run_reader(name, count, seed):
    """Read `count` mutations. A child that dies or hangs costs one of them; the next one goes on after it."""
    tally, index = Tally(), 0
    while index < count:
        for message in _answers(name, index, count, seed):
            index = int(message["index"])
            if message["what"] == "read":
                tally.read += 1
            elif message["what"] == "refused":
                tally.refused += 1
            else:
                tally.faults.append((index, str(message["what"])))
            index += 1
    return tally


def _answers(name, start, count, seed):
    """What a child process says of the mutations from `start` on, until it is through, dies or hangs."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(out)
        status = 1
        try:
            with os.fdopen(into, "w") as channel:
                _read_all(name, range(start, count), seed, channel)
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)
    os.close(into)
    index, rest, silent = start, b"", False
    with os.fdopen(out, "rb", buffering=0) as channel:
        while True:
            # the first one imports
            ready, _, _ = select.select([channel], [], [], FIRST_S if index == start else LIMIT_S)
            silent = not ready
            data = channel.read(1 << 16) if ready else b""
            if not data:
                break
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                yield json.loads(line)
                index += 1
    if silent:
        os.kill(child, 9)
    _, status = os.waitpid(child, 0)
    if silent:
        yield {"index": index, "what": f"no answer within {FIRST_S if index == start else LIMIT_S:g} s"}
    elif index < count:
        yield {"index": index, "what": f"the process died with status {status}"}


def _read_all(name, numbers, seed, channel):
    reader = READERS[name]
    warnings.simplefilter("ignore")
    tempfile.tempdir = "/dev/shm" if Path("/dev/shm").is_dir() else None  # files of milliseconds need no disk
    with tempfile.TemporaryDirectory(prefix="tg4mm-faults-") as scratch, open(os.devnull, "w") as null:
        os.dup2(null.fileno(), 1)  # libraries complain there
        os.dup2(null.fileno(), 2)
        root = Path(scratch)
        file = reader.make(root)
        sample = file.read_bytes()
        reader.read(root)  # the sample is valid, and everything is imported
        base = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (base + MEMORY, resource.RLIM_INFINITY))
        before = _contents(root, file)
        for i in numbers:
            file.write_bytes(mutated(name, seed, i, sample))
            began = time.monotonic()
            what = _outcome(reader, root)
            seconds = time.monotonic() - began
            if what in ("read", "refused") and _contents(root, file) != before:
                what = "something beside the file was written or removed"
                shutil.rmtree(root)
                root.mkdir()
                file = reader.make(root)
            if seconds > LIMIT_S:
                what = f"took {seconds:.0f} s"
            channel.write(json.dumps({"index": i, "what": what, "seconds": seconds}) + "\n")
            channel.flush()


def _outcome(reader, root):
    try:
        reader.read(root)
    except Tg4mmError:
        return "refused"
    except BaseException as error:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if "tests" not in f.filename]
        place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
        ours = [f for f in frames if "/tg4mm/" in f.filename or "/dataset_gen/" in f.filename]
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno} " if ours else ""
        return f"{type(error).__name__} at {where}({place}): {' '.join(str(error).split())[:100]}"
    return "read"


def _contents(root, file):
    """What every file holds but the mutated one and the log, which reading a run writes."""
    found = {}
    for folder, _, names in os.walk(root):
        for path in (Path(folder, name) for name in names):
            known = path != file and path.name != "log.json"
            found[str(path)] = path.read_bytes() if known else b""
    return found
