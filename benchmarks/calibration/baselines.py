"""Two other estimators of a region's motion, run by any Python that has numpy, PyAV and (for the first) pyidi.

    python baselines.py VIDEO REGIONS.json OUT.json

REGIONS: a list of [left, upper, right, lower], pixels. OUT: {"pyidi": [R, F, 2], "phase": [R, F, 2], "seconds": {…}},
pixels right and down. pyidi's Lucas-Kanade (Čufar et al.) has one square subset at each region's centre. The
phase-based estimator (Fleet & Jepson 1990) has complex Gabor filters of two wavelengths and four directions and the
least squares of their phases against the mean's over the region.
"""

import contextlib
import io
import json
import sys
import tempfile
import time

import av
import numpy as np

WAVELENGTHS = ((5.0, 2.2), (10.0, 4.4))  # pixels, with the standard deviation of the window
DIRECTIONS = np.arange(4) * np.pi / 4
LARGEST = 61  # pixels of pyidi's subset


def pictures(path):
    """[F, H, W] float64."""
    with av.open(path) as container:
        return np.stack([frame.to_ndarray(format="gray") for frame in container.decode(video=0)]).astype(
            float
        )


def filters(shape):
    """Transfer functions [H, W] of quadrature filters without a mean."""
    fy, fx = np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.fftfreq(shape[1]), indexing="ij")
    for wavelength, sigma in WAVELENGTHS:
        for angle in DIRECTIONS:
            u, v = np.cos(angle) / wavelength, np.sin(angle) / wavelength
            near = np.exp(-2 * (np.pi * sigma) ** 2 * ((fx - u) ** 2 + (fy - v) ** 2))
            zero = np.exp(-2 * (np.pi * sigma) ** 2 * (fx**2 + fy**2))
            yield near - zero * near[0, 0], 2 * np.pi / wavelength


def phase_based(video, region):
    """[F, 2] pixels right and down."""
    left, upper, right, lower = region
    rows = slice(max(upper - 8, 0), lower + 8)
    columns = slice(max(left - 8, 0), right + 8)
    crop = video[:, rows, columns] / video[:, rows, columns].mean((1, 2), keepdims=True)
    inside = np.zeros(crop.shape[1:], bool)
    inside[upper - rows.start : lower - rows.start, left - columns.start : right - columns.start] = True
    spectra, products, by_phase = np.fft.fft2(crop), np.zeros((2, 2)), np.zeros((len(video), 2))
    for transfer, k in filters(crop.shape[1:]):
        seen = np.fft.ifft2(spectra * transfer)
        mean = seen.mean(0)
        power = np.abs(mean) ** 2 + 1e-30
        slopes = [np.imag(np.conj(mean) * g) / power for g in np.gradient(mean)]
        size = np.hypot(*slopes)
        weight = power * (inside & (power > 0.05 * power[inside].max()) & (size > 0.5 * k) & (size < 1.5 * k))
        moved = np.angle(seen * np.conj(mean))
        g = np.stack([slopes[1], slopes[0]])
        products += np.einsum("ayx,byx,yx->ab", g, g, weight)
        by_phase -= np.einsum("fyx,ayx,yx->fa", moved, g, weight)
    return np.linalg.solve(products + 1e-12 * np.eye(2), by_phase.T).T


def lucas_kanade(video, regions):
    """[R, F, 2], one subset a region."""
    from pyidi import LucasKanade, VideoReader

    out = []
    for left, upper, right, lower in regions:
        side = min(right - left - 4, lower - upper - 4, LARGEST) // 2 * 2 - 1
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
            method = LucasKanade(VideoReader(video.astype(np.uint8), root=folder, fps=1))
            method.set_points(np.array([[(upper + lower) / 2 - 0.5, (left + right) / 2 - 0.5]]))
            method.configure(roi_size=(side, side), verbose=0, show_pbar=False)
            out.append(np.asarray(method.get_displacements(autosave=False))[0][:, ::-1])
    return np.stack(out)


def main(video_path, regions_path, out_path):
    with open(regions_path, encoding="utf-8") as file:
        regions = json.load(file)
    video, found, seconds = pictures(video_path), {}, {}
    methods = {"phase": lambda: np.stack([phase_based(video, r) for r in regions])}
    with contextlib.suppress(ImportError):
        import pyidi  # noqa: F401

        methods["pyidi"] = lambda: lucas_kanade(video, regions)
    for name, method in methods.items():
        began = time.process_time()
        found[name] = method().tolist()
        seconds[name] = time.process_time() - began
    with open(out_path, "w", encoding="utf-8") as file:
        json.dump({**found, "seconds": seconds}, file)


if __name__ == "__main__":
    main(*sys.argv[1:])
