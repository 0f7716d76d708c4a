"""Share of a small motion that survives a video's compression, by a blind test with a known motion.

A codec skips changes that are too small, so it is a low-pass over time: of 0.02 pixels at a third of the frame rate, a
fifth may remain. The remainder depends on texture, noise, rate, amplitude and encoder. So the mean picture is moved in
each region by a tone of the measured frequency, direction and amplitude, with noise as strong as in the key frames,
encoded as the file says, and measured again; then tones of other amplitudes, until the measured one is left. From the
second on they last as long as the standard error requires. A region is encoded alone where that is the same. A weaker
tone that grows by the encoding is one that the codec makes of a stronger one, at least in part.

Nothing is fitted. If the file names no available encoder, the pictures decide: a region whose pixels hardly ever repeat
and whose noise is new in each frame has lost nothing; any other is marked.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tg4mm.capture.codec.trial import (
    CodecSample,
    MeasuredTone,
    TestedTone,
    box_about,
    is_lossless,
    probe,
    through,
)
from tg4mm.capture.tracking.registration import Box
from tg4mm.capture.video import ALONE, BETWEEN, FORWARD, av_module
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.lines import CodecChange
from tg4mm.core.pictures.decode import THREADS

# The deviation of a gain: times the test's standard error, and beside it (docs/uncertainty.md, films of x264, x265)
SCATTER, BESIDE = 1.15, 0.06
_INEXACT = 0.4  # of what the test of a decaying tone corrects, which it is wrong by
_TOO_LARGE = "it is too large for a test in seconds (tg4mm measure tests it)"
_UNASKED = "the file names no encoder that can be tested"
_UNEVEN = "its parts move differently, which cannot be tested; choose a smaller region"
LOST = 0.5  # a gain below it is marked
_UNSURE = 0.25  # of a gain: with a larger deviation it is marked, since a quotient's error is then not normal
# equal pixels and the noise's correlation from frame to frame, at most,
FRESH_PIXELS, FRESH_NOISE = (0.15, 0.1)
FRESH = 0.08  # of what lost nothing; the deviation of its gain
# Frames of the test, its periods of the slowest tone, both at least; the pixels of all its frames, at most.
_FEWEST, _PERIODS, _PIXELS = 64, 6, 30e6
# The same where an answer is wanted in seconds, and the pixels beyond which there is none.
_QUICK_PERIODS, _QUICK_PIXELS, _QUICK_MOST = 3, 4e6, 12e6
_LEAST = 0.15  # gain that one test corrects the next by
_MOST_LOST = 0.9  # share of detail: what is left of a line that is found
_FEWEST_OF_KIND = 8  # frames, more than which show what a kind lacks
_FOLDS = 3  # e-foldings of a decaying tone that its test contains
_ALIKE = 0.9  # of the measured amplitude, what the last test may leave
_ROUNDS = 5  # encodings, at most
_MADE = 3.0  # deviations: a tone that grows by more in the encoding is made by the codec, at least in part
_APART = 0.2  # of the logarithms of the amplitudes of two trials, from which the exponent follows


@dataclass(frozen=True)
class Loss:
    """Share of one tone's amplitude that survives compression."""

    gain: float  # 1 where nothing is lost; NaN where it is not known
    deviation: float  # standard deviation of the gain
    # the mark: why the true amplitude is larger (with `is_made`: smaller), by an amount that is not known
    why: str = ""
    # of a decaying tone: what compression adds to its decay, per second, with its deviation; None: steady, or unknown
    faster: float | None = None
    faster_deviation: float = 0.0
    is_made: bool = False  # by the codec, of stronger tones, at least in part: the true amplitude is smaller

    @property
    def is_lost(self) -> bool:
        """Return whether the test showed that the amplitude cannot be corrected; False where it is not known."""
        return bool(np.isfinite(self.gain)) and (self.gain < LOST or bool(self.why))


def codec_losses(
    video: Path,
    regions: Sequence[np.ndarray],
    tones: Sequence[Sequence[MeasuredTone]],
    fps: float | None = None,
    start_s: float = 0.0,
    repeats: Sequence[int] = (),
    seed: int = 0,
    quick: bool = False,
    without_between: bool = False,
    uneven: Sequence[bool] | None = None,
) -> list[list[Loss]]:
    """Measure the share of each region's tones that survives compression.

    The film is encoded up to five times for each set of regions that do not overlap.

    Args:
        video: the file that was measured.
        regions: [H, W] bool or float masks on the upright picture.
        tones: of each region.
        fps: pictures per second that frequencies refer to; None: the file's own.
        start_s: seconds of the file that come before.
        repeats: duplicate frames, counted from start_s.
        seed: of the noise that is added to the tones.
        quick: take seconds only: regions whose pictures show no loss are not tested, others with a few frames; larger
            pictures are not tested at all.
        uneven: of each region, whether its parts move differently: it is not tested, and its pictures decide.
        without_between: measure the test's amplitudes without B-frames, as the given ones were.

    Raises Tg4mmError for a region of another size than the picture.
    """
    if not any(tones):
        return [[] for _ in tones]
    slowest = max(min(tone.frequency_hz for of_region in tones for tone in of_region), 1e-3)
    height, width = regions[0].shape
    periods, pixels = (_QUICK_PERIODS, _QUICK_PIXELS) if quick else (_PERIODS, _PIXELS)
    fewest = int(max(_FEWEST, periods * (fps or 30.0) / slowest))
    folds = [t.start_s + _FOLDS / t.decay_per_s for own in tones for t in own if t.decay_per_s > 0]
    decaying = int((fps or 30.0) * max(folds, default=0.0))
    fewest = max(fewest, min(decaying, int(_QUICK_MOST / (height * width))) if quick else decaying)
    most = max(fewest, int(pixels / (height * width)))
    try:
        if is_lossless(video):
            return [[Loss(1.0, 0.0) for _ in of_region] for of_region in tones]
        made = probe(video, start_s, most)
    except (OSError, ValueError, Tg4mmError, av_module().FFmpegError):
        made = None
    if made is None:
        why = "what its compression takes is not known: the video cannot be tested"
        return [[Loss(float("nan"), float("nan"), why) for _ in of_region] for of_region in tones]
    shape = made.orientation.shown(made.luma[0]).shape
    for region in regions:
        if region.shape != shape:
            raise Tg4mmError(f"a region has the shape {region.shape}, the video's pictures {shape}")
    masks = [made.orientation.stored(region.astype(np.float32)) for region in regions]
    if made.is_key.all():  # every picture by itself: noise, but no memory
        return [[Loss(1.0, 0.0) for _ in of_region] for of_region in tones]
    if not made.encoder or quick:
        unasked = _TOO_LARGE if made.encoder else _UNASKED
        own_words = [_by_pictures(made, mask, unasked) for mask in masks]
        found = [[loss] * len(of_region) for loss, of_region in zip(own_words, tones, strict=True)]
        if not made.encoder or most * height * width > _QUICK_MOST:
            return found
        tones = [of_region if loss.why else [] for loss, of_region in zip(own_words, tones, strict=True)]
    elif uneven is not None and any(uneven):
        found = [
            [_by_pictures(made, mask, _UNEVEN)] * len(own) if differs else []
            for mask, own, differs in zip(masks, tones, uneven, strict=True)
        ]
        tones = [[] if differs else own for own, differs in zip(tones, uneven, strict=True)]
    else:
        found = [[] for _ in tones]
    is_new = ~np.isin(np.arange(len(made.luma)), list(repeats))
    is_new[0] = True
    times = (np.cumsum(is_new) - 1) / float(fps or made.rate)
    tested = _tested(made, masks, tones, times, seed, without_between, fewest)
    return [of_region or known for of_region, known in zip(tested, found, strict=True)]


def _tested(
    made: CodecSample,
    masks: Sequence[np.ndarray],
    tones: Sequence[Sequence[MeasuredTone]],
    times: np.ndarray,
    seed: int,
    without_between: bool,
    frames: int,
) -> list[list[Loss]]:
    """times [F] seconds, of frames that show one picture the same."""

    def searched(group: Sequence[int], box: Box | None) -> list[list[Loss]]:
        part = made if box is None else made.within(box)
        inside = [masks[k] if box is None else masks[k][box] for k in group]
        return _searched(part, inside, [tones[k] for k in group], times, seed, without_between, frames)

    found: list[list[Loss]] = [[] for _ in tones]
    groups = _groups(made, [k for k, of_group in enumerate(tones) if of_group], masks)
    with ThreadPoolExecutor(THREADS) as pool:
        for (group, _), losses in zip(groups, pool.map(lambda own: searched(*own), groups), strict=True):
            for k, own in zip(group, losses, strict=True):
                found[k] = own
    return found


def _searched(
    made: CodecSample,
    masks: Sequence[np.ndarray],
    tones: Sequence[Sequence[MeasuredTone]],
    times: np.ndarray,
    seed: int,
    without_between: bool,
    frames: int,
) -> list[list[Loss]]:
    """Search the amplitudes of regions that are encoded together.

    The first encoding has `frames`, the others as many as make their standard error as small as what is beside it.
    """
    of_group = [
        [replace(t, phasor=made.orientation.stored_vector(t.phasor)) for t in of_region]
        for of_region in tones
    ]
    largest = [max(float(np.linalg.norm(tone.phasor)) for tone in of_region) for of_region in of_group]
    searches = [
        [AmplitudeSearch(tone, tone, float(np.linalg.norm(tone.phasor)) < most) for tone in of_region]
        for of_region, most in zip(of_group, largest, strict=True)
    ]
    every = [search for of_region in searches for search in of_region]
    length = min(frames, len(times))
    for round_ in range(_ROUNDS):
        encoded = [[search.encoded for search in of_region] for of_region in searches]
        results = through(made, masks, encoded, times[:length], seed + round_, without_between)
        for search, result in zip(every, (tone for of_region in results for tone in of_region), strict=True):
            search.add(result)
        needed = length * (SCATTER * max(search.trials[-1].found.error for search in every) / BESIDE) ** 2
        if all(search.is_done or search.is_made for search in every) and (round_ or needed <= length):
            break
        if round_ + 1 < _ROUNDS:
            length = int(np.clip(needed, length, len(times)))
            for search in every:
                if not search.is_made:  # what is made is encoded again as it is
                    search.encoded = search.following()
    return [[_loss(search) for search in of_region] for of_region in searches]


@dataclass(frozen=True)
class Trial:
    """One encoding of a tone. Amplitudes are natural logarithms of multiples of the measured one."""

    encoded: float  # amplitude before the encoding
    remaining: float  # and after it
    found: TestedTone


@dataclass
class AmplitudeSearch:
    """The search for the tone of which the encoding leaves the measured one, by the secant method.

    The remaining amplitude falls steeply where the codec begins to skip a motion: there a division by the gain goes
    far beyond the solution. Between two trials it is assumed to be a power of the encoded amplitude.
    """

    measured: MeasuredTone
    encoded: MeasuredTone  # in the next trial, or in the last one once the search has ended
    has_stronger: bool = False  # beside it in its region
    trials: list[Trial] = field(default_factory=list)

    def add(self, found: TestedTone) -> None:
        """Add the result of encoding `encoded`."""
        size = float(np.linalg.norm(self.encoded.phasor) / np.linalg.norm(self.measured.phasor))
        self.trials.append(Trial(np.log(size), np.log(size * max(found.gain, _LEAST**2)), found))

    @property
    def nearest(self) -> Trial:
        """Return the trial whose remaining amplitude is nearest to the measured one."""
        return min(self.trials, key=lambda trial: abs(trial.remaining))

    @property
    def is_made(self) -> bool:
        """Return whether encoding makes more of the measured, steady tone: the codec adds to it, of stronger ones."""
        last, is_steady = self.trials[-1], self.measured.decay_per_s <= 0
        more = last.found.gain - 1 > _MADE * _deviation(last.found)
        return self.has_stronger and is_steady and not last.encoded and more

    @property
    def exponent(self) -> float:
        """Return the exponent of that power: 1 where the same share remains of any amplitude."""
        own = self.nearest
        others = [trial for trial in self.trials if abs(trial.encoded - own.encoded) > _APART]
        if not others:
            return 1.0
        other = min(others, key=lambda trial: abs(trial.remaining))
        return max(1.0, (own.remaining - other.remaining) / (own.encoded - other.encoded))

    @property
    def is_done(self) -> bool:
        """Return whether the measured tone remained of the last one, within the deviation, with the same decay."""
        last, decay = self.trials[-1], self.encoded.decay_per_s
        is_as_fast = decay <= 0 or abs(last.found.decay_per_s / decay - 1) < 1 - _ALIKE
        return abs(last.remaining) < -np.log(_ALIKE) and is_as_fast

    @property
    def gain(self) -> float:
        """Return the measured amplitude over that before the compression."""
        own = self.nearest
        return (
            own.found.gain
            if len(self.trials) == 1
            else float(np.exp(own.remaining / self.exponent - own.encoded))
        )

    def following(self) -> MeasuredTone:
        """Return the tone of the next trial."""
        own, found, decay = self.nearest, self.trials[-1].found, self.encoded.decay_per_s
        size = own.encoded - float(np.clip(own.remaining, np.log(_LEAST), -np.log(_LEAST))) / self.exponent
        below = max((trial.encoded for trial in self.trials if trial.remaining < 0), default=-np.inf)
        above = min((trial.encoded for trial in self.trials if trial.remaining > 0), default=np.inf)
        if np.isfinite(above - below) and not min(below, above) < size < max(below, above):
            size = (below + above) / 2
        if decay > 0 and found.decay_per_s > 0:
            excess = found.decay_per_s - decay
            decay = float(np.clip(self.measured.decay_per_s - excess, decay / 3, 3 * decay))
        return replace(self.measured, phasor=self.measured.phasor * np.exp(size), decay_per_s=decay)


def _deviation(found: TestedTone) -> float:
    """Return the deviation of a gain near 1."""
    return float(np.hypot(SCATTER * found.error, BESIDE))


def _made(gain: float, deviation: float) -> Loss:
    why = f"compression adds to it, of stronger ones: a test tone becomes {gain:.2f} ± {deviation:.2f} times as large"
    return Loss(gain, deviation, why, is_made=True)


def _loss(search: AmplitudeSearch) -> Loss:
    if search.is_made:
        last = search.trials[-1].found
        return _made(last.gain, _deviation(last))
    gain, nearest, last, decay = (
        search.gain,
        search.nearest,
        search.trials[-1].found,
        search.encoded.decay_per_s,
    )
    relative = SCATTER * nearest.found.error / max(abs(nearest.found.gain), _LEAST)
    missed = 0.0 if search.is_done else abs(nearest.remaining)
    deviation = float(np.hypot(np.hypot(relative, missed) * min(abs(gain), 1.0) / search.exponent, BESIDE))
    if gain < LOST or deviation > _UNSURE * gain:
        why = "smaller than the codec lets through: of a test tone of this size "
        return Loss(gain, deviation, f"{why}{max(gain, 0.0):.2f} ± {deviation:.2f} is left")
    if search.has_stronger and decay <= 0 and gain - 1 > _MADE * deviation * gain:
        return _made(gain, deviation * gain)
    if decay > 0 and not last.decay_per_s:
        return Loss(gain, deviation, "", 0.0, decay)  # any decay may be the codec's
    if decay > 0:
        faster = last.decay_per_s - decay
        errors = SCATTER * last.decay_error, np.sqrt(2) * BESIDE * decay, _INEXACT * faster
        deviation = float(np.hypot(deviation, _INEXACT * (gain - 1)))
        return Loss(gain, deviation, "", faster, float(np.linalg.norm(errors)))
    return Loss(gain, deviation)


def _by_pictures(made: CodecSample, mask: np.ndarray, unasked: str) -> Loss:
    inside = mask > 0.5
    luma = made.luma[:, inside].astype(np.float32)
    equal = float((luma[1:] == luma[:-1]).mean())
    luma -= luma.mean(0)
    luma -= luma.mean(1, keepdims=True)
    memory = float((luma[1:] * luma[:-1]).mean() / max(float((luma**2).mean()), 1e-9))
    if equal < FRESH_PIXELS and abs(memory) < FRESH_NOISE:
        return Loss(1.0, FRESH)
    why = f"may be smaller than it was: {equal:.0%} of its pixels repeat the frame before, and {unasked}"
    return Loss(float("nan"), float("nan"), why)


def _groups(
    made: CodecSample, rows: Sequence[int], masks: Sequence[np.ndarray]
) -> list[tuple[list[int], Box | None]]:
    """Regions that one encoding tests, and the part of the picture that it encodes; None: all of it.

    A region alone where that is the same (`CodecSample.is_local`) and encodes fewer pixels.
    """
    together = _apart(rows, masks)
    boxes = {k: box_about(masks[k]) for k in rows} if made.is_local else {}
    pixels = sum(masks[k][box].size for k, box in boxes.items())
    if boxes and pixels < len(together) * masks[0].size:
        return [([k], boxes[k]) for k in rows]
    return [(group, None) for group in together]


def _apart(rows: Sequence[int], masks: Sequence[np.ndarray]) -> list[list[int]]:
    """The regions in groups in which none overlap."""
    groups: list[list[int]] = []
    for k in rows:
        free = (g for g in groups if not any((np.minimum(masks[k], masks[j]) > 0).any() for j in g))
        group = next(free, None)
        groups.append([k]) if group is None else group.append(k)
    return groups


def lacking(noise: np.ndarray, some: np.ndarray, others: np.ndarray) -> float:
    """Return the share of detail that frames `some` [F] bool lack compared with `others`; neither is empty.

    noise [F, …]: mean square of what motion leaves of each frame.
    """
    typical = [float(np.median(noise[rows])) for rows in (some, others)]
    return max(0.0, 1 - typical[0] / max(typical[1], 1e-9))


def coded_change(noise: np.ndarray, kinds: np.ndarray) -> CodecChange:
    """Return what compression may change a steady line by; its `size` is the root mean square that is lacking.

    noise [F, …], as for `lacking`; kinds [F]: of the coded pictures, as FFmpeg numbers them.
    """
    alone, forward, between = (kinds == kind for kind in (ALONE, FORWARD, BETWEEN))
    lost, power = 0.0, 0.0
    pairs = [(between, ~between)] if min(between.sum(), (~between).sum()) > _FEWEST_OF_KIND else []
    for some, others in [*pairs, *([(forward, alone)] if alone.any() and forward.any() else [])]:
        share = lacking(noise, some, others)
        lost, power = max(lost, share), max(power, share * float(np.median(noise[others])))
    return CodecChange(float(-np.log(1 - min(lost, _MOST_LOST))), float(np.sqrt(power)))


def before_compression(amplitude: float, deviation: float, loss: Loss | None) -> tuple[float, float]:
    """Divide an amplitude and its deviation by the gain found by the test; same units as given.

    A marked amplitude is left as measured: the true one is larger by an unknown amount. Of one that the codec made in
    part, that part is added to the deviation.
    """
    if loss is not None and loss.is_made:
        return amplitude, float(np.hypot(deviation, amplitude * min(loss.gain - 1, 1.0)))
    if loss is None or loss.why:
        return amplitude, deviation
    # compression adds nothing, but a decay that it makes too fast begins too large
    gain = min(loss.gain, 1.0) if loss.faster is None else loss.gain
    return amplitude / gain, float(np.hypot(deviation, amplitude * loss.deviation / gain)) / gain
