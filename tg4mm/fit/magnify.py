"""Magnification over time of anything but modes: linear of series, and phase-based of videos.

Linear: a series is filtered, and α times the band is added; for embeddings (`paper`) the series of every channel since
timestep 0, for modal motion displacement and rotation, which gives a modal motion again.

Phase-based: [TG4MM] Eqs. (12) to (15), [PVM]. Each sub-band of the complex steerable pyramid holds local phase. Its
change since frame 0 is filtered over time, multiplied by α, and added to the phase; high- and low-pass
residual stay as they are. In its linear range (α times the shift below about half the wavelength of a sub-band) a shift
δ of what the band shows becomes (1 + α) δ.

Memory. A pyramid of every frame at once would take 23 MB × T at 512², 7 GB for T = 300. Here one sub-band of all frames
is held at a time. With S = T · H · W cells of a video, at most

    4 S (video) + 4 S (half of its spectrum) + 4 S (half of the change's) + 8 S (finest sub-band)   = 20 S bytes

and a working set of at most 100 MB that does not grow: 1,595 MiB at T = 300, 512², of which 1,537 were measured.

The sub-bands with which phase-based video magnification was published [PVM]: half an octave wide. Narrower than those
of the complex steerable pyramid, so that phase may grow twice as far before it leaves the range in which
it stands for a shift ([PVM] §3.3). Eight orientations, radial windows that fall by a raised cosine of 0.75 octaves:
the settings of its authors' program.
"""

import math
import warnings
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tg4mm.core.errors import Tg4mmError
from tg4mm.core.magnification import Magnification, apply_response
from tg4mm.core.phasors import series_modes
from tg4mm.fit.motion.modes import ModalMotion

SMALLEST = 16  # below, "auto" leaves less than two scales
_CELLS_AT_ONCE = 1 << 20  # complex numbers in a working set
_ORIENTATIONS = 8
_PER_OCTAVE = 2
_FALL = 0.75  # octaves over which a window falls
_LEFT_OUT = 2  # octaves at the coarse end, which stay as they are


def magnified_series(series: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return series [T, …] plus its change since timestep 0, filtered by `response` [T // 2 + 1] (Σ of α · filter)."""
    return series + apply_response(series - series[:1], response)


def magnified_motion(motion: ModalMotion, plan: Magnification) -> ModalMotion:
    """Return the motion with displacement, rotation and appearance of every Gaussian filtered over time and magnified.

    With ideal bands and modes on DFT bins this is multiplying the phasors, what `modal` does. Modes between the bins
    spread over them, and are magnified as far as they lie in the band.
    """
    gains = np.stack([motion.gains_at(t) for t in range(motion.n_timesteps)])

    def filtered(series: np.ndarray) -> np.ndarray:
        freqs, phasors = series_modes((gains @ series).real, motion.fps)
        return phasors.astype(np.complex128) * (1 + plan.response(freqs, motion.fps))[:, None]

    series, freqs = filtered(motion.series), np.fft.rfftfreq(motion.n_timesteps, 1 / motion.fps)
    appearance = motion.appearance
    if appearance is not None:
        appearance = replace(appearance, series=filtered(appearance.series))
    return replace(motion, freqs_hz=freqs, series=series, gains=None, magnified=None, appearance=appearance)


@dataclass(frozen=True)
class PyramidConfig:
    """[TG4MM] §IV.B: eight orientations, as many scales as the size allows, transition width 0.75 octaves.

    plenoptic (2.1) cuts the width to whole octaves: 0.75 acts as 0, that is, sharp edges of the radial bands.
    """

    orientations: int = 8
    twidth: float = 0.75


@dataclass(frozen=True)
class SubBand:
    """One scale and orientation; its coefficients are ifft2(crop(fft2(image)) · analysis), complex."""

    scale: int
    orientation: int
    analysis: Tensor  # [h, w] complex64, frequencies in the FFT's order
    # [h, w] complex64: its part of an image is Re ifft2(pad(fft2(coefficients) · synthesis))
    synthesis: Tensor


def pyramid(shape: tuple[int, int], config: PyramidConfig) -> Any:
    """plenoptic's pyramid for images of `shape` (rows, columns).

    Raises Tg4mmError for sizes it is not exact for (odd, not alike when halved) or too small.
    """
    from plenoptic.process import SteerablePyramidFreq

    for size in shape:
        if size < SMALLEST or size & (size - 1):
            raise Tg4mmError(
                f"phase: planes of {shape[0]}×{shape[1]} cells, expected powers of two of at least {SMALLEST}"
            )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return SteerablePyramidFreq(
            shape, height="auto", order=config.orientations - 1, twidth=config.twidth,
            is_complex=True, downsample=True,
        )  # fmt: skip


@torch.no_grad()
def sub_bands(shape: tuple[int, int], config: PyramidConfig | None = None) -> Iterator[SubBand]:
    """Yield all oriented sub-bands of images of `shape`, finest first, without the residuals, which have no phase."""
    config = config or PyramidConfig()
    made = pyramid(shape, config)
    impulse = torch.zeros(1, 1, *shape)
    impulse[..., 0, 0] = 1
    answers = made(impulse)
    scales = [k for k in answers if isinstance(k, int)]
    for scale in scales:
        analysis = torch.fft.fft2(answers[scale][0, 0])
        poke = torch.zeros_like(answers[scale])
        poke[..., 0, 0] = 1  # every orientation: `bands` picks one
        poked = OrderedDict(answers | {scale: poke})
        for o in range(config.orientations):
            # Synthesis filters are real in space: one impulse suffices.
            back = made.recon_pyr(poked, levels=[scale], bands=[o])[0, 0]
            yield SubBand(scale, o, analysis[o].clone(), crop(torch.fft.fft2(back), analysis.shape[-2:]))


def crop(spectrum: Tensor, size: tuple[int, int]) -> Tensor:
    """The lowest (h, w) frequencies of spectra [..., H, W] in the FFT's order: −h/2 … h/2 − 1."""
    h, w = size
    rows = [slice(0, h // 2), slice(spectrum.shape[-2] - h // 2, None)]
    columns = [slice(0, w // 2), slice(spectrum.shape[-1] - w // 2, None)]
    return torch.cat([torch.cat([spectrum[..., r, c] for c in columns], -1) for r in rows], -2)


class PhaseMagnifier:
    """Magnifies videos [T, H, W] of one size by one temporal response."""

    def __init__(
        self,
        shape: tuple[int, int],
        response: np.ndarray,
        bands: Iterable[SubBand] | None = None,
        suppressed: bool = False,
        amplitude_percentile: float = 0.0,
    ) -> None:
        """shape (H, W); response [T // 2 + 1] complex on the DFT bins: Σ over bands α · filter.

        suppressed: phases of other frequencies are left out ([PVM]'s program, "attenuate other frequencies"); α + 1 in
        the response. amplitude_percentile: cells whose mean amplitude is below this percentile of their sub-band keep
        their phase, which is noise there.

        bands: sub-bands of images of `shape`; None for those of the complex steerable pyramid, for powers of two.

        Raises Tg4mmError for a size the pyramid cannot take.
        """
        self.shape, self.response = shape, torch.from_numpy(response.astype(np.complex64))
        self._suppressed, self._percentile = suppressed, amplitude_percentile
        self._bands = (
            list(sub_bands(shape) if bands is None else bands) if np.any(response) or suppressed else []
        )

    @torch.no_grad()
    def __call__(self, video: np.ndarray) -> np.ndarray:
        """The video [T, H, W] float32, magnified. What does not change in time is handed back as it is."""
        if video.shape[1:] != self.shape or len(video) // 2 + 1 != len(self.response):
            expected = f"{self.shape} and T // 2 + 1 = {len(self.response)}"
            raise ValueError(f"video has shape {video.shape}, expected frames of {expected}")
        if not self._bands or not (video != video[:1]).any():
            return video.copy()
        frames = torch.from_numpy(np.ascontiguousarray(video, np.float32))
        spectrum = _by_frames(frames, lambda f: torch.fft.rfft2(f), torch.complex64)
        change = torch.zeros_like(spectrum)
        for band in self._bands:
            self._add(band, spectrum, change)
        del spectrum
        out = frames.clone()
        for part in _parts(len(frames), frames[0].numel()):
            out[part] += torch.fft.irfft2(change[part], s=self.shape)
        return out.numpy()

    def turn(self, held: Tensor) -> None:
        """Replace a sub-band's coefficients [T, h, w], in place, by their change. A subclass may smooth it."""
        flat = held.view(len(held), -1)
        keeps = None
        if self._percentile:
            amplitude = flat.abs().mean(0)
            keeps = amplitude < np.percentile(amplitude.numpy(), self._percentile)
        turn(flat, self.response, self._suppressed, keeps)

    def _add(self, band: SubBand, spectrum: Tensor, change: Tensor) -> None:
        n, (h, w) = len(spectrum), band.analysis.shape
        held = torch.empty(n, h, w, dtype=torch.complex64)
        parts = _parts(n, h * w)
        for part in parts:
            held[part] = torch.fft.ifft2(_take(spectrum[part], (h, w)) * band.analysis)
        self.turn(held)
        for part in parts:
            _give(change[part], torch.fft.fft2(held[part]) * band.synthesis)


def turn(
    coefficients: Tensor, response: Tensor, suppressed: bool = False, keeps: Tensor | None = None
) -> None:
    """Replace coefficients c [T, P], in place, by their change c · (exp(i φ') − 1).

    φ' is the phase relative to timestep 0, in (−π, π], filtered along time by `response` [T // 2 + 1]; `suppressed`:
    less that phase itself. Cells that a mask `keeps` [P] bool do not change.
    """
    n, cells = coefficients.shape
    step = max(_CELLS_AT_ONCE // n, 1)
    for start in range(0, cells, step):
        c = coefficients[:, start : start + step]
        angle = torch.angle(c * c[:1].conj())
        phase = torch.fft.irfft(torch.fft.rfft(angle, dim=0) * response[:, None], n, dim=0)
        if suppressed:
            phase -= angle
        del angle  # or a part of the working set is held twice
        if keeps is not None:
            phase[:, keeps[start : start + step]] = 0
        c *= torch.polar(torch.ones_like(phase), phase) - 1


def _parts(n: int, cells: int) -> list[slice]:
    step = max(_CELLS_AT_ONCE // cells, 1)
    return [slice(start, start + step) for start in range(0, n, step)]


def _by_frames(frames: Tensor, transform, dtype: torch.dtype) -> Tensor:
    first = transform(frames[:1])
    out = torch.empty(len(frames), *first.shape[1:], dtype=dtype)
    for part in _parts(len(frames), frames[0].numel()):
        out[part] = transform(frames[part])
    return out


def _mirror(n: int) -> Tensor:
    """Row −k of every row k."""
    return -torch.arange(n) % n


def _rows(whole: int, h: int) -> Tensor:
    """Rows of the frequencies 0 … h/2 − 1, −h/2 … −1 among `whole`."""
    return torch.cat([torch.arange(h // 2), torch.arange(whole - h // 2, whole)])


def _take(half: Tensor, size: tuple[int, int]) -> Tensor:
    """The lowest (h, w) frequencies, whole, from half-spectra [F, H, W // 2 + 1] of real images."""
    h, w = size
    rows = _rows(half.shape[1], h)
    positive = half[:, rows, : w // 2]
    negative = half[:, _mirror(half.shape[1])[rows], 1 : w // 2 + 1].flip(-1).conj()
    return torch.cat([positive, negative], -1)


def _give(half: Tensor, spectrum: Tensor) -> None:
    """Add the real part of images with the (low) spectra [F, h, w] to half-spectra [F, H, W // 2 + 1] of real images.

    A real part has the spectrum (D(k) + conj D(−k)) / 2; in columns 0 and W/2 `irfft2` takes it by itself.
    """
    h, w = spectrum.shape[1:]
    rows = _rows(half.shape[1], h)
    mirrored = _mirror(half.shape[1])[rows]
    half[:, rows, 0] += spectrum[..., 0]
    half[:, rows, 1 : w // 2] += spectrum[..., 1 : w // 2] / 2
    half[:, mirrored, 1 : w // 2] += spectrum[..., w // 2 + 1 :].flip(-1).conj() / 2
    last = spectrum[..., w // 2]  # column −w/2
    if w == 2 * (half.shape[2] - 1):
        half[:, rows, w // 2] += last
    else:
        half[:, mirrored, w // 2] += last.conj() / 2


def half_octave_bands(shape: tuple[int, int]) -> Iterator[SubBand]:
    """Yield all oriented sub-bands of images of `shape`, finest first, each cropped to the frequencies that it holds.

    Put back they give the image but for the finest and the coarsest frequencies, to 0.5 %. Raises Tg4mmError for an odd
    or too small size.
    """
    if any(size < SMALLEST or size % 2 for size in shape):
        raise Tg4mmError(
            f"pictures of {shape[0]}×{shape[1]} pixels, expected even sizes of at least {SMALLEST}"
        )
    y, x = (2 * torch.fft.fftfreq(size, dtype=torch.float64) for size in shape)
    radius, angle = torch.hypot(y[:, None], x), torch.atan2(y[:, None], x[None])
    octaves = int(math.log2(min(shape))) - _LEFT_OUT
    edges = [2 ** (-k / _PER_OCTAVE) for k in range(octaves * _PER_OCTAVE + 1)]
    for scale, (outer, inner) in enumerate(pairwise(edges)):
        ring = _below(radius, outer) * torch.sqrt(1 - _below(radius, inner) ** 2)
        size = tuple(min(2 * math.ceil(n * outer / 2 + 1), n) for n in shape)
        for o in range(_ORIENTATIONS):
            window = crop(ring * _towards(angle, math.pi * o / _ORIENTATIONS), (size[0], size[1])).to(
                torch.complex64
            )
            yield SubBand(scale, o, window, window)


def _below(radius: Tensor, edge: float) -> Tensor:
    """1 at radii up to `edge` less `_FALL` octaves, 0 from `edge` on, a quarter of a sine between."""
    octaves = torch.log2(edge / radius.clamp_min(1e-9)).clamp(0, _FALL)
    return torch.sin(octaves * (math.pi / 2 / _FALL))


def _towards(angle: Tensor, direction: float) -> Tensor:
    """The half-plane around `direction`: cosⁿ⁻¹; the squares of all and of their mirror images add up to 2."""
    n = _ORIENTATIONS - 1
    size = 2**n * math.factorial(n) / math.sqrt(_ORIENTATIONS * math.factorial(2 * n))
    return math.sqrt(2) * size * torch.cos(angle - direction).clamp_min(0) ** n
