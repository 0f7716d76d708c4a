"""Lines of random records: is one that changes slowly one line, with a true frequency, and are two still two?

python -m benchmarks modulated_lines [--records 1000] [--first 0] [--pairs 40]

A record is one sinusoid whose amplitude (or, of the kind `phase`, phase) changes by 2 to 30 % (.02 to .3 rad), in
noise of 1e-3 to 1e-1 of it; lost: no line within half of 1 / duration; false: records with any other line. Pairs are
two steady sinusoids of a record, apart by what is printed over the duration; the table has how many are called two.
"""

from typing import Any

import numpy as np

from tg4mm.core.lines import find_lines

OPTIONS = {"--records": 1000, "--first": 0, "--pairs": 40}
KINDS = ("sinusoid", "walk", "step", "phase")
APART = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 5.0)  # over the duration
RATIOS = (1.0, 0.5, 0.2, 0.05)


def draw(rng: np.random.Generator, kind: str, longest: int) -> tuple[np.ndarray, np.ndarray, float, str]:
    """Values and times [T] of a record, its frequency in Hz and what it is in words."""
    n = int(np.exp(rng.uniform(np.log(150), np.log(longest))))
    fps, depth = rng.uniform(20, 240), rng.uniform(0.02, 0.3)
    t, duration = np.arange(n) / fps, n / fps
    hz = rng.uniform(max(8 / duration, 0.04 * fps), 0.42 * fps)
    noise = 10 ** rng.uniform(-3, -1)
    slow = change(rng, "sinusoid" if kind == "phase" else kind, t, min(0.2 * hz, 12 / duration))
    phase = 2 * np.pi * hz * t + rng.uniform(0, 2 * np.pi)
    values = np.cos(phase + depth * slow) if kind == "phase" else (1 + depth * slow) * np.cos(phase)
    words = f"{kind} {depth:.3f} n {n} fps {fps:.1f} hz {hz:.3f} bin {hz * duration:.1f} noise {noise:.4f}"
    return values + noise * rng.normal(size=n), t, hz, words


def change(rng: np.random.Generator, kind: str, t: np.ndarray, fastest: float) -> np.ndarray:
    """[T] from −1 to 1; fastest: Hz."""
    duration = float(t[-1])
    if kind == "sinusoid":
        rate, more = np.exp(rng.uniform(np.log(0.5 / duration), np.log(fastest))), rng.uniform(0, 0.5)
        parts = [(1.0, rate), (more, 1.8 * rate)]
        out = sum(size * np.cos(2 * np.pi * own * t + rng.uniform(0, 2 * np.pi)) for size, own in parts)
    elif kind == "walk":
        width = max(int(rng.uniform(1, 5) / 2 / fastest / (t[1] - t[0])), 1)
        out = np.convolve(np.cumsum(rng.normal(size=len(t) + width - 1)), np.ones(width) / width, "valid")
        out = out - out.mean()
    else:
        rise = rng.uniform(0.01, 0.1) * duration
        out = rng.choice([-1, 1]) * np.tanh((t - rng.uniform(0.15, 0.85) * duration) / rise)
    return np.asarray(out / np.abs(out).max())


def scored(seed: int, kind: str, longest: int = 1500) -> tuple[bool, int, float, str]:
    """Return whether a record's line was lost, how many others there are, and the frequency's error over its ±."""
    values, t, hz, words = draw(np.random.default_rng([seed, KINDS.index(kind)]), kind, longest)
    lines = find_lines(values, t).lines
    own = [line for line in lines if abs(line.hz - hz) < 0.5 / t[-1] and line.amplitude[0] > 0.5]
    error = (own[0].hz - hz) / own[0].hz_deviation if own else np.nan
    found = ", ".join(f"{line.hz:.3f} ({line.amplitude[0]:.4f} {line.change})" for line in lines)
    return not own, len(lines) - bool(own), float(error), f"{words}: {found}, off by {error:.1f}"


def are_resolved(seed: int, apart: float, ratio: float, noise: float) -> bool:
    """Return whether two lines of a record of 300 samples are two."""
    rng, t = np.random.default_rng(seed), np.arange(300) / 30
    hz = rng.uniform(3, 10)
    both = hz, hz + apart / 10 * rng.choice([-1, 1])
    values = sum(
        a * np.cos(2 * np.pi * f * t + rng.uniform(0, 6.3)) for a, f in zip((1, ratio), both, strict=True)
    )
    found = sorted(line.hz for line in find_lines(values + noise * rng.normal(size=300), t).lines)
    return len(found) == 2 and bool(np.abs(np.array(found) - sorted(both)).max() < 0.3 * apart / 10)


def run(options: Any) -> None:
    print("change     records  lost  false  within 1 ±    2 ±  largest")
    for kind in KINDS if options.records else ():
        scores = [scored(options.first + k, kind) for k in range(options.records // len(KINDS))]
        for own in scores:
            if own[0] or own[1] or abs(own[2]) > 4:
                print(f"    {own[3]}")
        z = np.abs([own[2] for own in scores if np.isfinite(own[2])])
        lost, more = sum(own[0] for own in scores), sum(own[1] > 0 for own in scores)
        within = f"{(z < 1).mean():11.1%} {(z < 2).mean():6.1%} {max(z, default=0):8.1f}"
        print(f"{kind:10} {len(scores):7} {lost:5} {more:6} {within}", flush=True)
    for noise in (0.001, 0.03) if options.pairs else ():
        print(f"two lines called two, noise {noise:g}: apart by, over the duration")
        print("ratio " + " ".join(f"{apart:5g}" for apart in APART))
        for ratio in RATIOS:
            seeds = range(options.first, options.first + options.pairs)
            shares = [np.mean([are_resolved(seed, apart, ratio, noise) for seed in seeds]) for apart in APART]
            print(f"{ratio:5g} " + " ".join(f"{share:5.0%}" for share in shares), flush=True)
