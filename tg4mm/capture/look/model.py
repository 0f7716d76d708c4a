"""The result of a look at a recording."""

from dataclasses import dataclass, field

import numpy as np

from tg4mm.core.lines import envelope, tone
from tg4mm.core.regions import Region

Box = tuple[int, int, int, int]  # left, upper, right and lower edge, pixels


@dataclass(frozen=True)
class Readout:
    """Readout time from a picture's first row to its last; negative: from its last to its first."""

    seconds: float
    deviation_s: float
    light_hz: float = 0.0  # of the lamps it is measured from; 0: from phases of vibration


@dataclass(frozen=True)
class LookLine:
    """One vibration: frequency, amplitude, region."""

    hz: float
    hz_deviation: float
    amplitude_px: float  # along its direction; the largest of the record
    amplitude_deviation_px: float
    change: str  # "steady", "decays", "grows", "begins" or "untold" (`tg4mm.core.lines`)
    damping: float | None  # ratio; None: no test says that it rings down
    damping_deviation: float | None
    start_s: float | None  # of what begins during the record
    from_s: float  # where its envelope is 1: the amplitude is of then
    direction: tuple[float, float]  # unit, right and down
    phase_rad: float  # of a cosine by the record's own clock
    centre_px: tuple[float, float]  # right and down from the upper left corner
    box: Box  # around the cells that show it
    cells: np.ndarray  # [rows, columns] bool: those that show it
    region: np.ndarray  # [rows, columns] bool: those that the amplitude is of
    statistic: float  # power over noise where it is strongest, mean 2 where nothing vibrates
    readout_s: float | None  # that would make its phases alike at all heights
    mark: str  # why it may be no vibration of its own; empty: it is one
    kept: float | None = None  # share of the amplitude that compression let through; None: not known
    kept_deviation: float | None = None
    lost: str = ""  # why the true amplitude is larger than this one, by more than the ±; empty: unknown
    readout_deviation_s: float | None = None
    between_share: float = 1.0  # of the amplitude, that B-frames keep of the others'
    # of the amplitude in the pictures, with what compression adds; None: as `damping` says
    coded_decay_per_s: float | None = None

    def course(self, times_s: np.ndarray) -> np.ndarray:
        """Return [2, F]: cosine and sine, decaying as it was found to."""
        start = float(times_s[0]) if self.start_s is None else self.start_s
        shape = envelope(times_s, self.decay_per_s, start, self.start_s)
        return np.asarray((shape[:, None] * tone(times_s, self.hz)).T)

    @property
    def decay_per_s(self) -> float:
        """Return the decay of its amplitude in the pictures; 0 of what does not ring down there."""
        if self.coded_decay_per_s is not None:
            return self.coded_decay_per_s
        ratio = self.damping or 0.0
        return float(2 * np.pi * self.hz * ratio / np.sqrt(max(1 - ratio**2, 1e-9)))


@dataclass(frozen=True)
class MovingRegion:
    """An independently moving or changing region, which no small rigid shift explains."""

    kind: str  # "moves by itself" all along, or "passes"
    box: Box
    hz: float | None = None  # at which it changes periodically, folded below half the rate
    hz_deviation: float | None = None
    from_s: float = 0.0
    until_s: float = 0.0


@dataclass(frozen=True)
class FlickerLine:
    """A line of the light or of the picture as a whole."""

    hz: float
    hz_deviation: float
    amplitude: float  # relative, of light; pixels, of the whole picture


@dataclass(frozen=True)
class GlobalMotion:
    """Motion of the complete picture beside its shift, which is subtracted."""

    kind: str  # "zoom" or "roll" about its middle, or "light": its level
    largest: float  # pixels in the corners from their median; of light, relative, from its least to its most
    at_s: float  # of the largest; of light, of its fastest change
    tones: tuple[FlickerLine, ...] = ()  # its lines, pixels in the corners


@dataclass(frozen=True)
class Smallest:
    """The smallest detectable amplitude of a steady vibration of a region of this size; compression may raise it."""

    across_px: int
    amplitude_px: float  # along the better known direction; median over places and frequencies
    best_px: float  # the same of the tenth of the places that has most texture


@dataclass(frozen=True)
class LookSummary:
    """The result of one pass over a recording of a fixed camera; `record.py` writes and reads it."""

    lines: tuple[LookLine, ...]  # the largest amplitude first, marked ones last
    movers: tuple[MovingRegion, ...]
    light: tuple[FlickerLine, ...]
    whole: tuple[FlickerLine, ...]  # of the whole picture, which is the camera's or everything's
    hz: np.ndarray  # [K]
    composite: np.ndarray  # [K] mean over cells of power over noise: 1 where nothing vibrates
    composite_floor: float  # that one of a hundred recordings of noise exceeds anywhere
    moves_by_itself: np.ndarray  # [rows, columns] bool
    cell_px: int
    size: tuple[int, int]  # of the picture
    without_between: bool = field(
        default=False, kw_only=True
    )  # amplitudes are mostly of pictures other than B
    light_readout: Readout | None = field(default=None, kw_only=True)  # by lamps that flicker
    swings: tuple[GlobalMotion, ...] = field(default=(), kw_only=True)
    # by how much the codec may let a steady line grow or fade over the record, as a logarithm
    coded_change: float = field(default=0.0, kw_only=True)
    rows_s: float = field(default=0.0, kw_only=True)  # the readout that phases take into account
    conversion: str = field(
        default="", kw_only=True
    )  # from another frame rate, in words; empty: none is recognised

    @property
    def vibrations(self) -> tuple[LookLine, ...]:
        """The lines without a mark."""
        return tuple(line for line in self.lines if not line.mark)

    def mask(self) -> np.ndarray:
        """Return [H, W] bool: the pixels of independently moving regions."""
        return self.pixels(self.moves_by_itself)

    def pixels(self, cells: np.ndarray) -> np.ndarray:
        """Return [H, W] bool: the pixels of cells [rows, columns]."""
        width, height = self.size
        fine = np.kron(cells, np.ones((self.cell_px, self.cell_px), bool))
        out = np.zeros((height, width), bool)
        out[: fine.shape[0], : fine.shape[1]] = fine[:height, :width]
        return out


@dataclass(frozen=True)
class RegionLook:
    """A drawn region: the lines of its mean shift, and its texture."""

    region: Region
    lines: tuple[LookLine, ...]  # by falling strength
    noise_px: float  # standard deviation of one picture's shift along the best-resolved direction
    remark: str  # what its texture does not determine


@dataclass(frozen=True)
class Look(LookSummary):
    """The result with every cell's series."""

    hidden: np.ndarray  # [F, rows, columns] bool: something passes there
    usable: np.ndarray  # [rows, columns] bool: cells with texture that do not move by themselves
    shift_px: np.ndarray  # [F, rows, columns, 2] right and down, less the whole picture's
    whole_px: np.ndarray  # [F, 2]
    times_s: np.ndarray  # [F]
    smallest: tuple[Smallest, ...]  # motion that would be found, by the size of what moves
    first: np.ndarray  # [H, W] uint8: the first picture
    regions: tuple[RegionLook, ...] = field(default=(), kw_only=True)  # in the order asked for
    repeats: tuple[int, ...] = field(default=(), kw_only=True)  # frames that repeat the one before, left out
    # rate of frames other than B: a line at f has images by their order at |k × images_hz ± f|; 0: none
    images_hz: float = field(default=0.0, kw_only=True)

    @property
    def rate(self) -> float:
        """Pictures a second."""
        return 1 / float(np.median(np.diff(self.times_s)))

    @property
    def duration_s(self) -> float:
        """Seconds from the first picture to the end of the last."""
        return float(self.times_s[-1] - self.times_s[0]) + 1 / self.rate
