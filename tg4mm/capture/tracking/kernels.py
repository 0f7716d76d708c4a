"""Points between pixels, interpolated by a sinc under a Hann window."""

import numba
import numpy as np


@numba.njit(cache=True, error_model="numpy", nogil=True)
def resample(
    pictures: np.ndarray, shift: np.ndarray, top: int, left: int, reach: int, out: np.ndarray
) -> None:
    """Fill out [F, h, w], whose corner is at row `top` and column `left` of pictures [F, H, W].

    From where its rows have moved to, by shifts [F, h or 1, 2] (pixels right and down), by 2 reach + 1 taps each way.
    """
    count, height, width = out.shape
    last_row, last_column = pictures.shape[1] - 1, pictures.shape[2] - 1
    down, right = np.empty(2 * reach + 1, np.float32), np.empty(2 * reach + 1, np.float32)
    line = np.empty(width + 2 * reach, np.float32)
    for f in range(count):
        for i in range(height):
            row = min(i, shift.shape[1] - 1)
            if i == row:
                x, y = round(shift[f, row, 0]), round(shift[f, row, 1])
                _taps(shift[f, row, 0] - x, right)
                _taps(shift[f, row, 1] - y, down)
            line[:] = 0
            for a in range(2 * reach + 1):
                source = min(max(top + i + y + a - reach, 0), last_row)
                weight = down[a]
                if weight != 0:
                    first = left + x - reach
                    if first >= 0 and first + width + 2 * reach - 1 <= last_column:
                        source_row = pictures[f, source, first : first + width + 2 * reach]
                        for j in range(width + 2 * reach):
                            line[j] += weight * source_row[j]
                        continue
                    for j in range(width + 2 * reach):
                        line[j] += weight * pictures[f, source, min(max(first + j, 0), last_column)]
            row_out = out[f, i]
            row_out[:] = 0
            for a in range(2 * reach + 1):
                weight = right[a]
                for j in range(width):
                    row_out[j] += weight * line[j + a]


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _taps(at: float, out: np.ndarray) -> None:
    """Fill the weights of the pixels about a point that lies a fraction of a pixel, −½ … ½, after the middle one."""
    reach = len(out) // 2
    total = 0.0
    for k in range(2 * reach + 1):
        away = k - reach - at
        sinc = 1.0 if abs(away) < 1e-9 else np.sin(np.pi * away) / (np.pi * away)
        value = sinc * np.cos(np.pi * away / (2 * reach + 2)) ** 2
        out[k] = value
        total += value
    for k in range(2 * reach + 1):
        out[k] /= total
