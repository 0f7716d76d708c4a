"""Mutations of every reader's files, each read in a child process that may neither crash, hang nor take much memory.

    python -m tests.faults.harness --count 10000 [--seed 0] [--only NAME] [--keep FOLDER]

A fault is any exception but Tg4mmError, a process that dies, more than LIMIT_S seconds, and a file left or changed
beside the one that is read. With --keep, the inputs of faults are written to a folder.
"""

import argparse
import contextlib
import json
import os
import random
import resource
import select
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
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

    read: int = 0  # accepted: the mutation did no harm, or none that can be told
    refused: int = 0
    slowest_s: float = 0.0
    faults: list[tuple[int, str]] = field(default_factory=list)  # number of the mutation, what happened

    @property
    def count(self):
        return self.read + self.refused + len(self.faults)


def mutated(name, seed, index, sample):
    """The `index`-th mutation of a reader's sample; the same in every process."""
    return READERS[name].mutate(sample, random.Random(f"{seed} {name} {index}"))


def run_reader(name, count, seed, keep=None):
    """Read `count` mutations. A child that dies or hangs costs one of them; the next one goes on after it."""
    tally, index = Tally(), 0
    while index < count:
        for message in _answers(name, index, count, seed):
            index = int(message["index"])
            tally.slowest_s = max(tally.slowest_s, float(message.get("seconds", 0.0)))
            if message["what"] == "read":
                tally.read += 1
            elif message["what"] == "refused":
                tally.refused += 1
            else:
                tally.faults.append((index, str(message["what"])))
                if keep is not None:
                    _keep(keep, name, seed, index)
            index += 1
    return tally


def _keep(folder, name, seed, index):
    with tempfile.TemporaryDirectory() as scratch:
        file = READERS[name].make(Path(scratch))
        folder.mkdir(parents=True, exist_ok=True)
        safe = "".join(c if c.isalnum() else "_" for c in name)
        (folder / f"{safe}_{index}{file.suffix}").write_bytes(mutated(name, seed, index, file.read_bytes()))


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
            ready, _, _ = select.select(
                [channel], [], [], FIRST_S if index == start else LIMIT_S
            )  # the first one imports
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


def _printed(name, tally, seconds):
    row = f"{name:<28}{tally.count:>8,}{tally.read:>8,}{tally.refused:>9,}{len(tally.faults):>8}"
    return f"{row}{1e3 * tally.slowest_s:>10.0f}{seconds:>9.0f}"


def main():
    """Prints a row a reader; 1 if there is a fault."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=500, help="mutations of each reader (500)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="readers whose name holds this")
    parser.add_argument("--keep", type=Path, help="folder for the inputs of faults")
    args = parser.parse_args()
    print(f"{'reader':<28}{'inputs':>8}{'read':>8}{'refused':>9}{'faults':>8}{'slowest':>10}{'in all':>9}")
    print(f"{'':<28}{'':>8}{'':>8}{'':>9}{'':>8}{'ms':>10}{'s':>9}")
    total = Tally()
    for name in READERS:
        if args.only not in name:
            continue
        began = time.monotonic()
        tally = run_reader(name, args.count, args.seed, args.keep)
        print(_printed(name, tally, time.monotonic() - began), flush=True)
        kinds = Counter(what for _, what in tally.faults)
        for what, n in kinds.most_common(12):
            first = next(i for i, w in tally.faults if w == what)
            print(f"    {n} × {what} (first: {first})", flush=True)
        total.read += tally.read
        total.refused += tally.refused
        total.faults += tally.faults
    print(f"{total.count:,} inputs, {len(total.faults)} faults, seed {args.seed}")
    return 1 if total.faults else 0


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError):
        sys.exit(main())
