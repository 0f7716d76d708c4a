"""What the arithmetic of blending alone would take, from the machine code of its inner loops.

    python -m benchmarks limit

needs AVX-512. It compiles the loops anew and prints what they are made of, for one block, the two loops of the backward
pass together; forward it is the loop of the picture alone. The constants below are what it printed for an earlier
version on Zen 4 (the present loops have two instructions fewer each), kept so that versions are measured by one
yardstick. Two limits follow, in cycles of one core:

- of the evaluations: visible (pixel, Gaussian) / 16 × arithmetic instructions, one a cycle, every lane useful. What no
  way of cutting a picture into vectors of 16 could beat at that rate.
- of the blocks: blocks of 4 × 4 pixels in which a Gaussian is seen × the cycles that a block's loop must take. Zen 4
  works on 512 bits in two halves, on four units of 256 bits, two of which multiply and compare: a vector's
  multiplications, multiply-adds and comparisons into a mask take one cycle each (eight of one and eight of the other
  were measured to take 16.0), all arithmetic half of one, a load or store at least one. Whatever goes on at the same
  time does so for free, so the largest of the three sums is the limit.
"""

import argparse
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import float32, njit

from tg4mm.fit.rasterize.kernels import blend, blend_backward
from tg4mm.fit.rasterize.kernels.layout import ALPHA_MAX, ALPHA_MIN, CA, CB, CC, MX, MY, OP, T_MIN, TILE

_STEPS = 20_000_000
_MOVES = ("vmov", "vbroadcast", "vpbroadcast", "kmov", "kortest", "ktest", "vextract")


@dataclass(frozen=True)
class Loop:
    """An inner loop's instructions, of 512 bits but for the first."""

    instructions: int
    arithmetic: int  # those that calculate: no moves, loads or stores of their own
    multiplications: int  # of these, with or without addition
    comparisons: int  # of these, into a mask
    memory: int  # operands in memory, be they whole vectors or one number for all lanes

    @property
    def cycles(self) -> float:
        """The least a block can take on Zen 4."""
        return max(self.multiplications + self.comparisons, self.arithmetic / 2, self.memory)


FORWARD = Loop(42, 23, 11, 2, 9)
BACKWARD = Loop(83, 47, 26, 3, 19)


@njit(cache=True)
def _chain(n, x):
    """n steps of six instructions of one cycle, each waiting for the one before."""
    for _ in range(n):
        x ^= x << np.uint64(13)
        x ^= x >> np.uint64(7)
        x ^= x << np.uint64(17)
    return x


def clock_ghz() -> float:
    """The processor's clock now, by the shortest of five dependent chains, in processor time."""
    _chain(1, np.uint64(1))
    seconds = []
    for _ in range(5):
        start = time.process_time()
        _chain(_STEPS, np.uint64(1))
        seconds.append(time.process_time() - start)
    return 6 * _STEPS / min(seconds) / 1e9


@njit(cache=True)
def visible_evaluations(splats, tile_start, pair_gaussian, width, height):
    """Number of (pixel, Gaussian) with alpha >= 1/255 where the pixel still takes light."""
    n_x = (width + TILE - 1) // TILE
    total = 0
    for tile in range(len(tile_start) - 1):
        x0, y0 = (tile % n_x) * TILE, (tile // n_x) * TILE
        for y in range(y0, min(y0 + TILE, height)):
            for x in range(x0, min(x0 + TILE, width)):
                t = 1.0
                for pair in range(tile_start[tile], tile_start[tile + 1]):
                    i = pair_gaussian[pair]
                    dx, dy = x + float32(0.5) - splats[i, MX], y + float32(0.5) - splats[i, MY]
                    sigma = (splats[i, CA] * dx * dx + splats[i, CC] * dy * dy) / 2 + splats[i, CB] * dx * dy
                    alpha = min(splats[i, OP] * math.exp(-sigma), ALPHA_MAX)
                    if alpha >= ALPHA_MIN:
                        total += 1
                        t *= 1 - alpha
                        if t <= T_MIN:
                            break
    return total


def blocks_seen(reached: np.ndarray) -> int:
    """How many blocks of PIXELS pixels `blend_forward` found a Gaussian seen in, from its `reached` [P] uint32."""
    return int(np.unpackbits(reached.view(np.uint8)).sum())


def inner_loops(assembly: str) -> list[list[str]]:
    """The loops that hold no other and multiply vectors; instructions in AT&T's syntax."""
    labels: dict[str, int] = {}
    code: list[str] = []
    for line in assembly.splitlines():
        if label := re.match(r"^(\.?[\w$.]+):", line):
            labels[label[1]] = len(code)
        elif (text := line.strip()) and not text.startswith((".", "#")):
            code.append(text)
    loops = []
    for end, text in enumerate(code):
        jump = re.match(r"^j\w+\s+(\S+)", text)
        if jump and labels.get(jump[1], end + 1) <= end:
            loops.append((labels[jump[1]], end))
    inner = [(a, b) for a, b in loops if not any(a <= c and d <= b and (a, b) != (c, d) for c, d in loops)]
    return [code[a : b + 1] for a, b in inner if _fused(code[a : b + 1])]


def _fused(body: list[str]) -> int:
    """Multiply-adds of whole vectors."""
    return sum(text.startswith(("vfm", "vfnm")) and "zmm" in text for text in body)


def block_loops(bodies: list[list[str]]) -> list[tuple[list[str], int]]:
    """Of a kernel's inner loops those that every block takes, and how many blocks a round of each works on.

    One calculates the exponential, whose shift tells how many there are: of the loops with shifts that with the fewest
    instructions a block, since a loop that looks ahead at Gaussians has one as well. In the backward pass another, that
    with most multiply-adds, uses it.
    """
    rounds = [(body, sum(text.startswith("vpslld") for text in body)) for body in bodies]
    exponential = min((r for r in rounds if r[1] > 0), key=lambda r: len(r[0]) / r[1])
    others = [
        (body, 1)
        for body, found in rounds
        if found == 0 and _fused(body) > _fused(exponential[0]) / exponential[1]
    ]
    return [exponential, *sorted(others, key=lambda r: -_fused(r[0]))[:1]]


def composition(body: list[str]) -> Loop:
    """What a loop is made of."""
    vectors = [text for text in body if "zmm" in text or re.search(r"\bk[0-7]\b|%k[0-7]", text)]
    arithmetic = [text for text in vectors if not text.startswith(_MOVES)]
    return Loop(
        instructions=len(body),
        arithmetic=len(arithmetic),
        multiplications=sum(text.startswith(("vfm", "vfn", "vmul")) for text in arithmetic),
        comparisons=sum(text.startswith("vcmp") for text in arithmetic),
        memory=sum("(" in text and "zmm" in text for text in vectors),
    )


def printed() -> None:
    """Compile both kernels on a small scene and print what their loops are made of."""
    from benchmarks.kernels import Kernels, scene

    parameters, viewmat, K = scene(500, 64)
    kernels = Kernels([p.numpy() for p in parameters], viewmat.numpy(), K.numpy(), (64, 64))
    for name, kernel in (("blend", blend._forward), ("blend backward", blend_backward._backward)):
        kernels.calls[name]()
        for body, blocks in block_loops(inner_loops(kernel.inspect_asm(kernel.signatures[0]))):
            print(f"{name}, {blocks} block(s) a round: {composition(body)}", flush=True)


OPTIONS: dict[str, Any] = {}


def run(options: argparse.Namespace) -> None:
    """`printed` in a process without cached kernels, of which there would be no machine code to see."""
    if "TG4MM_LIMIT" in os.environ:
        return printed()
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": folder, "TG4MM_LIMIT": "1"}
        subprocess.run([sys.executable, "-m", "benchmarks", "limit"], env=environment, check=True)
    return None
