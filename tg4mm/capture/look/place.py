"""Region and amplitude of a line, with the amplitude's standard deviation.

From the place with the largest certain amplitude, the region grows over cells that agree with this amplitude rather
than with rest. Cells on its rim contain some background, and are left out where others remain. The region is one
sensor: its series gives the amplitude, and the residual beside the line its standard deviation.

Loss by the codec: B-frames keep 1 − 0.8 τ ± 0.6 τ of a small motion, where τ is their missing share of detail; if
P-frames lack detail beside I-frames, 0.4 of that share may be missing from the amplitude. Both factors are calibrated
on random films (`benchmarks/calibration`).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage, stats

from tg4mm.capture.look.baseline import BLOCK
from tg4mm.capture.look.model import Readout
from tg4mm.capture.look.pools import AggregationWindow
from tg4mm.capture.look.reading import BETWEEN, FORWARD, INTRA
from tg4mm.capture.look.rows import by_phases
from tg4mm.capture.look.scene import lacks
from tg4mm.capture.look.search import PoolLine, Search, images
from tg4mm.capture.look.spectra import LOG2, spectrum
from tg4mm.capture.tracking.template import GAIN_ERROR
from tg4mm.core.lines.search import mirrored

RIM = 0.08  # share of an amplitude that is not exact in cells that hold what is behind, too
_INEXACT = 0.5  # of the root of the share of changes that a shift leaves
_FALSE = 0.01  # share of false detections among the cells found to move
_FREEDOM = 50  # degrees of freedom of a cell's floor
_SEED, _SEED_BEST, _SEED_LEAST = 0.3, 0.1, 30.0  # statistic of a seed: of its size's best, of all, at least
_FILLED = 0.6  # share of pictures in which a seed is seen
_ALIKE = 13.3  # χ² of 4 degrees of freedom, 1 %
_GROWS = 4  # times
_SEEN = 0.04  # of the region's information squared that a picture must have
_FEWEST_OTHERS = 24  # frames of a kind, from which its share of an amplitude is known
_KEEPS, _KEEPS_SPREAD = 0.8, 0.6  # what B-frames keep: 1 − .8 τ, ± .6 τ
_PREDICTED = 0.4  # of P-frames' lack of detail
_READOUT_CELLS, _READOUT_STATISTIC = 5, 25.0
_OTHERWISE = np.deg2rad(30)  # in direction or phase: a part that moves otherwise
_REAL = 2.0  # deviations of a part's amplitude
_REAL_CODED = 3.0  # the same where a codec may carry motion from place to place
_CLEARLY = 3.0  # deviations by noise of how a part differs from others
_JOINS = 0.05  # of the amplitude that a cell moves by at least, to be of one part with the next
_FEWEST_APART = 4  # cells of a part that moves otherwise: fewer may be an edge, or what a codec makes
_AROUND = tuple((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1))


@dataclass(frozen=True)
class Placed:
    """A line's region and amplitude."""

    amplitude_px: float
    deviation_px: float
    direction: np.ndarray  # [2] right and down, unit
    phase_rad: float  # of a cosine by the record's own clock
    centre_px: tuple[float, float]
    region: np.ndarray  # indices of the grid's cells that the amplitude is of
    moving: np.ndarray  # indices of the grid's cells that show the line
    readout: Readout | None  # that would make phases alike at all heights
    noise_px: float  # the part of the deviation that noise makes
    between_share: float  # of the amplitude, that B-frames keep of the others'


@dataclass(frozen=True)
class _Everywhere:
    """A line's coefficients in one pool."""

    pool: AggregationWindow
    fit: np.ndarray  # [2, P, 2] cosine and sine; right and down
    variance: np.ndarray  # [P, 2] of a sample along the pool's axes
    statistic: np.ndarray  # [P]


def cell_numbers(search: Search) -> np.ndarray:
    """[P] indices of the grid's cells of the pool of single cells."""
    corner = search.pools[0].corner
    return np.asarray(corner[:, 0] * search.scene.grid.columns + corner[:, 1])


def placed(search: Search, line: PoolLine) -> list[Placed]:
    """Return region, amplitude and readout of a line, then of parts that move differently at its frequency.

    Cells that clearly show the line form parts that do not touch. A part is listed separately if its direction or phase
    (modulo half a period) clearly differs by more than 30° from that of each part before it.
    """
    placing = _Placing(search, line)
    out = [placing.placed()]
    numbers, grid = cell_numbers(search), search.scene.grid
    sizes = np.linalg.norm(placing.cells.fit, axis=(0, 2))
    joined = numbers[np.isin(numbers, out[0].moving) & (sizes > _JOINS * out[0].amplitude_px)]
    labels, count = ndimage.label(grid.picture(np.isin(np.arange(len(grid)), joined)), BLOCK)
    cells = labels.ravel()[numbers]
    largest = [float(placing.cells.statistic[cells == k].max()) for k in range(1, count + 1)]
    for k in 1 + np.argsort(largest)[::-1]:
        inside = cells == k
        if inside.sum() < _FEWEST_APART or np.isin(out[0].region, numbers[inside]).any():
            continue
        part = _Placing(search, line, inside).placed()
        if all(_differs(search, line, part, one) for one in out):
            out.append(part)
    if len(out) > 1:
        rest = np.concatenate([part.moving for part in out[1:]])
        out[0] = replace(out[0], moving=np.setdiff1d(out[0].moving, rest))
    return out


def _differs(search: Search, line: PoolLine, part: Placed, other: Placed) -> bool:
    """Return whether a part clearly moves in another direction or phase; later rows are later in phase."""
    if part.amplitude_px < (_REAL_CODED if search.scene.patterns else _REAL) * part.deviation_px:
        return False
    sure = _CLEARLY * np.hypot(part.noise_px / part.amplitude_px, other.noise_px / other.amplitude_px)
    turned = np.arccos(min(abs(float(part.direction @ other.direction)), 1.0))
    away = abs((part.phase_rad - other.phase_rad + np.pi / 2) % np.pi - np.pi / 2)
    height = abs(part.centre_px[1] - other.centre_px[1]) / search.scene.series.size[1]
    by_rows = 2 * np.pi * line.vibration.hz * height * search.scene.dt
    return bool(turned > max(_OTHERWISE, sure) or away > max(_OTHERWISE, sure) + by_rows)


class _Placing:
    """Search for the region of a line; inside [P] bool: among these cells only."""

    def __init__(self, search: Search, line: PoolLine, inside: np.ndarray | None = None) -> None:
        self.search, self.line = search, line
        self.basis = line.vibration.columns(search.times)
        self.products = self.basis.T @ self.basis
        self.row = search.bin_of(line.vibration.hz)
        self.all = [self._everywhere(j) for j in range(len(search.pools))]
        self.cells = self.all[0]
        axes, pool = self.cells.pool.axes, self.cells.pool
        precision = np.minimum(pool.filled, 1)[:, None] / self.cells.variance
        self.weights = np.einsum("cxa,ca,cya->cxy", axes, precision, axes)  # [P, 2, 2]
        self.at = {(int(r), int(c)): k for k, (r, c) in enumerate(pool.corner)}
        if inside is not None:
            self._keep(inside)

    def _keep(self, inside: np.ndarray) -> None:
        """Leave out the positions that extend beyond some cells [P] bool."""
        outside = np.zeros((self.search.scene.grid.rows, self.search.scene.grid.columns), bool)
        outside[tuple(self.cells.pool.corner[~inside].T)] = True
        for each in self.all:
            size = each.pool.size
            beyond = sliding_window_view(outside, (size, size)).any((2, 3))
            each.statistic[beyond[tuple(each.pool.corner.T)]] = 0
        self.at = {cell: k for cell, k in self.at.items() if inside[k]}

    def placed(self) -> Placed:
        statistic = self.cells.statistic
        seed, size = self._seed()
        region, is_rim = self._inner(self._grown(seed, size))
        amplitude, deviation, direction, phase, noise = self._amplitude(region, is_rim)
        share = self._between_share(region)
        if len(region) <= size**2:  # the largest of all, so that its error is rather up than down
            beside = self._beside(region.tolist(), self._common(region))
            deviation = float(np.hypot(deviation, 0.0 if beside is None else abs(amplitude - beside) / 2))
        size_of = np.trace(self.weights[region], axis1=1, axis2=2)[:, None]
        x, y = (size_of * self.cells.pool.centre[region]).sum(0) / size_of.sum()
        sure = max(1, int((statistic > _READOUT_STATISTIC).sum())) / len(statistic)
        cut = 4 * stats.f.isf(min(_FALSE, _FALSE * sure), 4, _FREEDOM)
        numbers = cell_numbers(self.search)
        return Placed(
            *(amplitude, deviation, direction, phase, (float(x), float(y)), numbers[region]),
            *(numbers[statistic > cut], self._readout(direction), noise, share),
        )

    def _everywhere(self, j: int) -> _Everywhere:
        pool, fit = self.search.pools[j], self.line.plain[j]
        variance = len(self.search.times) / 4 * pool.sure_floor[self.row]
        each = np.einsum("im,ij,jm->m", fit, self.products, fit) / variance
        statistic = each.reshape(-1, 2).sum(1) * pool.filled * (pool.filled > _FILLED)
        return _Everywhere(pool, pool.in_picture(fit), variance.reshape(-1, 2), statistic)

    def _seed(self) -> tuple[list[int], int]:
        """Return the moving cells of the sure place of largest amplitude less two deviations, and its cells a side.

        A deviation includes half of the excess over the amplitudes of the cells around: the largest of many places
        would otherwise often be wrong.
        """
        best_of = [float(e.statistic.max()) for e in self.all]
        surest = self.all[int(np.argmax(best_of))]
        some = self.all[1:3] if surest.pool.size > 1 and len(self.all) > 1 else self.all[:2]
        inverse = np.linalg.inv(self.products)
        inexact = self._inexact()
        best: tuple[float, _Everywhere, int] | None = None
        for each in some:
            least = max(_SEED * float(each.statistic.max()), _SEED_BEST * max(best_of), _SEED_LEAST)
            for k in np.flatnonzero(each.statistic > least):
                axes = each.pool.axes[k]
                covariance = np.einsum("xa,a,ya->xy", axes, each.variance[k], axes)
                amplitude, variance, _, _ = _along(each.fit[:, k], covariance, inverse)
                cells = [self.at[cell] for cell in self._inside(each.pool, int(k))]
                share, beside = float(inexact[cells].max()), self._beside(cells, each.fit[:, k])
                unlike = 0.0 if beside is None else max(amplitude - beside, 0.0) / 2
                sure = amplitude - 2 * float(np.linalg.norm([variance**0.5, share * amplitude, unlike]))
                if best is None or sure > best[0]:
                    best = (sure, each, int(k))
        if best is None:
            usual = max(self.all[:3], key=lambda e: float(e.statistic.max()))
            best = (0.0, usual, int(usual.statistic.argmax()))
        pool, common = best[1].pool, best[1].fit[:, best[2]]
        cells = [self.at[cell] for cell in self._inside(pool, best[2])]
        return [cell for cell in cells if self._moves(cell, common)] or cells, pool.size

    def _inside(self, pool: AggregationWindow, place: int) -> list[tuple[int, int]]:
        """Rows and columns of the usable cells of a place."""
        row, column = (int(k) for k in pool.corner[place])
        cells = ((row + a, column + b) for a in range(pool.size) for b in range(pool.size))
        return [cell for cell in cells if cell in self.at]

    def _inexact(self) -> np.ndarray:
        """[P]: relative error of a cell's amplitude, from the share of its changes that no shift explains."""
        return np.asarray(_INEXACT * np.sqrt(self.search.scene.left[cell_numbers(self.search)]))

    def _common(self, cells: np.ndarray) -> np.ndarray:
        """[2, 2]: the weighted mean of some cells' coefficients."""
        total = self.weights[cells].sum(0)
        return np.linalg.solve(
            total, np.einsum("cxy,icy->xi", self.weights[cells], self.cells.fit[:, cells])
        ).T

    def _distance(self, cell: int, expected: np.ndarray | float) -> float:
        """χ² of a cell's coefficients against expected ones."""
        off = self.cells.fit[:, cell] - expected
        return float(np.einsum("ix,ij,jy,xy->", off, self.products, off, self.weights[cell]))

    def _moves(self, cell: int, common: np.ndarray) -> bool:
        """Return whether a cell agrees with the common motion better than with rest."""
        return self._distance(cell, common) < self._distance(cell, 0.0)

    def _neighbours(self, cell: int, reach: tuple[tuple[int, int], ...]) -> list[int | None]:
        row, column = self.cells.pool.corner[cell]
        return [self.at.get((row + a, column + b)) for a, b in reach]

    def _beside(self, cells: list[int], common: np.ndarray) -> float | None:
        """Return the largest amplitude, px, of neighbours that move alike rather than rest; None without any."""
        around = {n for cell in cells for n in self._neighbours(cell, _AROUND) if n is not None}
        alike = [n for n in around.difference(cells) if self._shows(n) and self._moves(n, common)]
        inverse, zero = np.linalg.inv(self.products), np.zeros((2, 2))
        return max((_along(self.cells.fit[:, n], zero, inverse)[0] for n in alike), default=None)

    def _shows(self, cell: int) -> bool:
        return bool(self.cells.statistic[cell] > _READOUT_STATISTIC)

    def _grown(self, seed: list[int], size: int) -> np.ndarray:
        grown = set(seed)
        for _ in range(_GROWS - (size > 1)):
            common = self._common(np.array(sorted(grown)))
            ring = set(seed) | {n for cell in grown for n in self._neighbours(cell, _AROUND) if n is not None}
            new = {c for c in ring if self._distance(c, common) < _ALIKE and self._moves(c, common)}
            if not new or new == grown:
                break
            grown = new
        return np.array(sorted(grown))

    def _inner(self, region: np.ndarray) -> tuple[np.ndarray, bool]:
        """Return the cells without a neighbour at rest; all, and True, if there are none."""
        common, beside = self._common(region), ((0, 1), (1, 0), (0, -1), (-1, 0))
        inner = [
            cell
            for cell in region
            if all(n is None or self._moves(n, common) for n in self._neighbours(cell, beside))
        ]
        return (np.array(inner), False) if inner else (region, True)

    def _series(self, region: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The region's motion [F, 2] and [F] bool: the pictures in which it is seen."""
        pool, columns = self.cells.pool, np.stack([2 * region, 2 * region + 1], 1).ravel()
        part = self.search.columns(self.line.vibration) @ self.line.taken[0][:, columns]
        motion = pool.in_picture(pool.residual[:, columns] + part, region)
        seen = np.ones((len(motion), len(region))) if pool.seen is None else pool.seen[:, 2 * region]
        weights = self.weights[region]
        total = np.einsum("kc,cxy->kxy", seen, weights)
        enough = np.linalg.det(total) > _SEEN * np.linalg.det(weights.sum(0))
        weighted = np.einsum("kc,cxy,kcy->kx", seen, weights, motion, optimize=True)
        out = np.zeros((len(motion), 2))
        out[enough] = np.linalg.solve(total[enough], weighted[enough][..., None])[..., 0]
        return out, enough

    def _noise(self, series: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """[2, 2] covariance of a sample of white noise as strong as the noise beside the line."""
        search = self.search
        fit = np.linalg.lstsq(self.basis[seen], series[seen], rcond=None)[0]
        hz, amplitudes = spectrum((series - self.basis @ fit) * seen[:, None], search.times)
        d, dt = search.scene.duration, search.scene.dt
        near = (np.abs(hz - self.line.vibration.hz) < max(12 / d, 0.08 / dt)) & (hz > 2 / d)
        part = amplitudes[near]
        covariance = (part.conj().T @ part).real / len(part)
        typical = np.median(np.abs(part) ** 2, 0) / LOG2
        covariance *= np.sqrt(np.outer(typical / np.diag(covariance), typical / np.diag(covariance)))
        return np.asarray(covariance * len(search.times) / 4 / seen.mean())

    def _amplitude(self, region: np.ndarray, is_rim: bool) -> tuple[float, float, np.ndarray, float, float]:
        """Amplitude and its ±, direction, phase and the ± by noise alone of a region."""
        series, seen = self._series(region)
        noise, scene, vibration = self._noise(series, seen), self.search.scene, self.line.vibration
        y, basis, kinds = series[seen], self.basis[seen], scene.series.kinds[seen]

        def fitted(rows: np.ndarray) -> tuple[float, float, np.ndarray, float]:
            products = basis[rows].T @ basis[rows]
            inverse = np.linalg.inv(products + 1e-9 * np.trace(products) * np.eye(2))
            return _along(inverse @ basis[rows].T @ y[rows], noise, inverse)

        amplitude, variance, direction, phase = fitted(np.ones(len(y), bool))
        between = kinds == BETWEEN
        if scene.treats_apart and between.sum() > 8 and (~between).sum() > 8:
            others, variance, direction, phase = fitted(~between)
            theirs, of_theirs, _, _ = fitted(between)
            keeps, spread = 1 - _KEEPS * scene.lost, _KEEPS_SPREAD * scene.lost
            of_theirs = of_theirs / keeps**2 + (spread * max(others, theirs) / keeps) ** 2
            weight = of_theirs / (variance + of_theirs)
            amplitude = weight * others + (1 - weight) * theirs / keeps
            variance = 1 / (1 / variance + 1 / of_theirs)
        if vibration.decay_per_s:  # its decay and its start are not known exactly
            variance *= 2
            if vibration.start_s is not None:
                variance += (amplitude * vibration.decay_per_s * max(scene.dt, 1 / (8 * vibration.hz))) ** 2
        inexact = float(self._inexact()[region].mean())
        relative = np.linalg.norm(
            [RIM if is_rim else GAIN_ERROR, inexact, _PREDICTED * self._predicted_lack()]
        )
        noise_px = float(variance**0.5)
        return amplitude, float(np.hypot(noise_px, relative * amplitude)), direction, phase, noise_px

    def _between_share(self, region: np.ndarray) -> float:
        """Return the share of a region's amplitude that B-frames keep; 1 where nothing shows that it is less.

        That they lack detail shows it, or a significant difference.
        """
        scene, hz = self.search.scene, self.line.vibration.hz
        series, seen = self._series(region)
        kinds = seen & ~scene.between, seen & scene.between
        few = min(int(rows.sum()) for rows in kinds) < _FEWEST_OTHERS
        if few or mirrored(self.search.times[kinds[0]], hz):
            return 1.0
        fits = [np.linalg.lstsq(self.basis[rows], series[rows], rcond=None)[0] for rows in kinds]
        noise = sum(
            ((series[rows] - self.basis[rows] @ fit) ** 2).mean() / rows.sum()
            for rows, fit in zip(kinds, fits, strict=True)
        )
        others, between = (complex_of(fit) for fit in fits)
        power = max(float(np.vdot(others, others).real), 1e-12)
        share = float(np.vdot(others, between).real) / power
        is_less = scene.treats_apart or 1 - share > 2 * float(np.sqrt(4 * noise / power))
        return min(max(share, 0.0), 1.0) if is_less else 1.0

    def _predicted_lack(self) -> float:
        """The share of detail that P-frames lack beside I-frames."""
        series = self.search.scene.series
        intra, forward = series.kinds == INTRA, series.kinds == FORWARD
        if not intra.any() or not forward.any():
            return 0.0
        return lacks(series, forward, intra)

    def _readout(self, direction: np.ndarray) -> Readout | None:
        statistic = self.cells.statistic
        cells = np.flatnonzero(statistic > _READOUT_STATISTIC)
        if len(cells) <= _READOUT_CELLS or self._meets_image():
            return None
        values = np.einsum("icx,x->ic", self.cells.fit[:, cells], direction)
        heights = self.cells.pool.centre[cells, 1] / self.search.scene.series.size[1]
        angles = np.angle(values[0] - 1j * values[1])
        return by_phases(angles, statistic[cells], heights, self.line.vibration.hz)

    def _meets_image(self) -> bool:
        """Return whether the line's images by a codec, at j / p of the rate less its frequency, coincide with it."""
        scene, hz = self.search.scene, self.line.vibration.hz
        image_hz = images(hz, 1 / scene.dt, scene.patterns)
        return min((abs(image - hz) for image in image_hz), default=np.inf) < 2 / scene.duration


def complex_of(fit: np.ndarray) -> np.ndarray:
    """Return the phasors of coefficients [2, …] of a cosine and a sine."""
    return np.asarray(fit[0] - 1j * fit[1])


def _along(fit: np.ndarray, noise: np.ndarray, inverse: np.ndarray) -> tuple[float, float, np.ndarray, float]:
    """Amplitude, its variance, direction [2] and phase of coefficients [2, 2]: their largest part along one line.

    noise [2, 2]: covariance of a sample; inverse [2, 2]: of the normal equations.
    """
    complex_amplitude = complex_of(fit)
    phase = 0.5 * float(np.angle((complex_amplitude**2).sum()))
    along = np.real(complex_amplitude * np.exp(-1j * phase))
    amplitude = float(np.linalg.norm(along)) + 1e-12
    direction = along / amplitude
    return amplitude, float(direction @ noise @ direction * np.trace(inverse) / 2), direction, phase
