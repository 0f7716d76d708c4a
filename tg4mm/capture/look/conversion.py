"""Recognition of recordings that were converted from another frame rate: 24 pictures a second shown as 30.

A converter shows picture i of the source, taken at i / source rate, at other times, or mixes two: of a line at ω, frame
k shows h_k e^(iωt_k) with known factors h_k, which repeat after n frames. They lower the line's amplitude and make
images of it at its frequency ± j rate / n. Of all conversions that are in use the one whose factors fit a line's series
best is recognised, if it explains it far better than a line without factors does, and nearly as well as any factors of
that period would: two vibrations that lie like images have other amplitudes and phases.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from tg4mm.capture.look.model import LookLine
from tg4mm.capture.look.scene import CellScene

# source pictures a frame: of 24, 25 and 30 (50 and 60) any in any, 24 in 60, 15 in 24 and 25
_SHARES = ((4, 5), (5, 6), (24, 25), (25, 24), (6, 5), (5, 4), (2, 5), (5, 8), (3, 5))
_LONG = 5  # frames: a codec's pattern of fewer acts like a conversion that repeats or blends
_BLENDED = 0.75  # source pictures a frame, from which on converters blend them
_FIELDS = {  # pulldown: how many fields each source picture is shown for
    **{(4, 5): ((2, 3, 2, 3), (2, 3, 3, 2)), (24, 25): ((*[2] * 11, 3) * 2,), (2, 5): ((5, 5),)},
}
_NAMES = {
    "fields": "by pulldown, of fields of two pictures",
    "blended": "by blending neighbours",
    "nearest": "by showing the nearest picture",
}
_REMEDIES = {
    "fields": "take the original, or undo it with ffmpeg -vf fieldmatch,decimate",
    "blended": "take the original",
    "nearest": "take the original",
}
_SURE = 30.0  # times the variance of what any factors of that period leave, that the factors explain
# of what any factors of that period explain; where the codec's kinds of pictures repeat after that period, too
_EXPLAINED, _EXPLAINED_OF_CODEC = 0.7, 0.9
_FEWEST = 8  # periods of the conversion
_SAID = 0.02  # of an amplitude, that it loses


@dataclass(frozen=True)
class Conversion:
    """Conversion of a recording to its frame rate."""

    kind: str  # fields, blended or nearest
    share: Fraction  # source pictures a frame
    rate: float  # frames a second
    sources: tuple[np.ndarray, ...]  # of each picture that a frame is mixed of [n], its number, from 0 on
    weights: tuple[np.ndarray, ...]  # [n] their parts

    @property
    def period(self) -> int:
        """Frames after which the factors repeat."""
        return self.share.denominator

    def factors(self, hz: float) -> np.ndarray:
        """Return [n] complex: what the frames of a period show of a line, relative to the line."""
        late = [(i / float(self.share) - np.arange(self.period)) / self.rate for i in self.sources]
        parts = zip(self.weights, late, strict=True)
        return np.asarray(sum(w * np.exp(2j * np.pi * hz * s) for w, s in parts))

    def kept(self, hz: float) -> float:
        """Return the share of a line's amplitude that is shown."""
        return float(abs(self.factors(hz).mean()))

    @property
    def words(self) -> str:
        """Return what is said of it."""
        source = float(self.share) * self.rate
        return (
            f"{source:.4g} a second were made {self.rate:.4g} {_NAMES[self.kind]}: amplitudes are smaller, the more "
            f"the higher the frequency, and lines have images; {_REMEDIES[self.kind]}"
        )


def conversion_of(scene: CellScene, hz: float) -> Conversion | None:
    """Return how the recording was converted, by its strongest line; None where that does not show it."""
    best, found = _SURE, None
    frames, wave, series = (
        np.arange(len(scene.times_s)),
        np.exp(2j * np.pi * hz * scene.times_s),
        _series(scene, hz),
    )
    plain, free = _left(series, wave[:, None]), dict[int, float]()
    for c in _conversions(1 / scene.dt, scene.patterns):
        n = c.period
        if _FEWEST * n > len(frames) or _has_common_images(hz, 1 / (n * scene.dt), 1 / scene.duration):
            continue
        if n not in free:
            free[n] = _left(series, wave[:, None] * (frames[:, None] % n == np.arange(n)))
        gained = plain - _left(series, (np.resize(c.factors(hz), len(frames)) * wave)[:, None])
        sure = gained / max(free[n] / (len(frames) - 2 * n), 1e-300)
        explained = _EXPLAINED_OF_CODEC if n in scene.patterns else _EXPLAINED
        if sure > best and gained > explained * (plain - free[n]):
            best, found = sure, c
    return found


def with_conversion(lines: Sequence[LookLine], conversion: Conversion | None) -> list[LookLine]:
    """Return the lines, those without a mark with the share of their amplitude that a conversion took."""
    if conversion is None:
        return list(lines)
    taken = [0.0 if line.mark else 1 - conversion.kept(line.hz) for line in lines]
    return [
        replace(line, lost=f"the conversion of its frame rate takes {share:.0%} of it")
        if share > _SAID
        else line
        for line, share in zip(lines, taken, strict=True)
    ]


def _has_common_images(hz: float, step: float, resolution: float) -> bool:
    """Return whether images of a line, at steps in Hz around it, coincide with each other, or with its harmonics."""
    return any(abs((n * hz + step / 2) % step - step / 2) < resolution for n in (1, 2))


def _conversions(rate: float, patterns: Sequence[int]) -> Iterator[Conversion]:
    """Yield all that are in use, in every phase; with a codec's shortest patterns only what no codec does."""
    for m, n in _SHARES:
        frames, share = np.arange(n), Fraction(m, n)
        is_codecs = n in patterns and n < _LONG
        for start in range(n if share > 1 or not is_codecs else 0):
            yield Conversion("nearest", share, rate, ((frames * m + start) // n,), (np.ones(n),))
        for start in range(2 * n if share > _BLENDED and not is_codecs else 0):
            place = (frames * m + start / 2) / n
            before = np.floor(place)
            yield Conversion(
                "blended", share, rate, (before, before + 1), (1 - (place - before), place - before)
            )
        for pattern in _FIELDS.get((m, n), ()):
            shown = np.repeat(np.arange(2 * m), pattern * 2)  # two periods
            for start in range(2 * n):
                fields = shown[start : start + 2 * n : 2], shown[start + 1 : start + 2 * n + 1 : 2]
                yield Conversion("fields", share, rate, fields, (np.full(n, 0.5),) * 2)


def _series(scene: CellScene, hz: float) -> np.ndarray:
    """Return [F]: the shift of all cells, weighted by what they show of a line, less the nuisance columns."""
    wave = np.exp(2j * np.pi * hz * scene.times_s)
    shift = np.nan_to_num(scene.series.shift[:, scene.usable])
    columns = np.concatenate([wave.real[:, None], wave.imag[:, None], scene.nuisance], 1)
    fit = np.linalg.lstsq(columns, shift.reshape(len(wave), -1), rcond=None)[0]
    phasors = (fit[0] - 1j * fit[1]).reshape(-1, 2)
    weights = np.einsum("cxy,cy->cx", np.nan_to_num(scene.information[scene.usable]), phasors)
    turn = np.exp(-0.5j * np.angle((weights * phasors).sum()))
    out = (shift - (scene.nuisance @ fit[2:]).reshape(shift.shape)).reshape(len(wave), -1) @ (
        weights * turn
    ).real.ravel()
    return np.asarray(out / max(float(np.linalg.norm(out)), 1e-300))


def _left(series: np.ndarray, waves: np.ndarray) -> float:
    """Return the square sum that complex waves [F, n] leave of a series."""
    columns = np.concatenate([waves.real, waves.imag], 1)
    left = series - columns @ np.linalg.lstsq(columns, series, rcond=None)[0]
    return float(left @ left)
