"""One dataset's report, from reading the folder to the files in `report/`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

from tg4mm import __version__
from tg4mm.core.pages.page import Page, Stat, render_page
from tg4mm.core.pages.svg import number, size_text
from tg4mm.core.progress import progress
from tg4mm.core.records import write_sealed

from ..tree import whole
from .closing import floor_section, making_section, shares
from .dataset import Dataset, evenly, hertz, length, plural, read_dataset, read_picture
from .modes import still_area, summarise, track_point
from .noise_floor import noise_floor
from .pixels import (
    Seen,
    ViewMotion,
    contact_rows,
    motion_from_truth,
    motion_from_vertices,
    resized,
    seen_motion,
    sheet,
)
from .sections import Findings, motion_section, pictures_section, pixels_section

FORMAT = "tg4mm-dataset-summary"
_SHOWN = 3  # test cameras with maps
_MOST_VIEWS = 40  # per split in the table


def write_report(root: Path) -> Path:
    """See `dataset_gen.report.write_report`."""
    findings = find(read_dataset(root))
    folder = root / "report"
    folder.mkdir(exist_ok=True)
    with progress("page of the set", 2, "parts", brief=True) as update:
        made = sheet(contact_rows(findings.dataset))
        save(folder / "contact_sheet.png", lambda path: made.save(path, "PNG"))
        if (thumbnail := _thumbnail(findings.dataset)) is not None:
            save(folder / "thumbnail.png", lambda path: thumbnail.save(path, "PNG"))
        update(1)
        write_sealed(folder / "summary.json", summary(findings))
        page = render_page(_page(findings, made))
        save(folder / "index.html", lambda path: path.write_text(page, encoding="utf-8"))
        update(2)
    return folder / "index.html"


def find(dataset: Dataset) -> Findings:
    """Reads and measures everything that a report shows."""
    chosen = [
        (split, name, own)
        for split in ("test", "train")
        for name, own in evenly(list(dataset.by_camera(split).items()), _MOST_VIEWS)
    ]
    shown: dict[str, Seen] = {}
    views: list[ViewMotion] = []
    with progress("looking at the set", len(chosen) + 2, "steps", brief=True) as update:
        for done, (split, name, own) in enumerate(chosen, 1):
            seen = seen_motion(dataset, own)
            if seen is not None:
                views.append(motion_from_truth(seen, dataset.amplitude))
                if split == "test" and len(shown) < _SHOWN:
                    shown[name] = seen
            elif dataset.motion is not None:
                views.append(motion_from_vertices(dataset.motion, own, dataset.amplitude))
            update(done)
        modes = tuple(summarise(dataset.motion)) if dataset.motion else ()
        area = still_area(dataset.motion) if dataset.motion else None
        track = track_point(dataset, next(iter(shown.values()), None))
        update(len(chosen) + 1)
        floor = tuple(noise_floor(dataset)) if dataset.views["test"] else ()
        update(len(chosen) + 2)
    return Findings(dataset, shown, tuple(views), modes, area, track, floor)


def summary(f: Findings) -> dict[str, Any]:
    """What the page of all sets, or a script, wants to know of this one."""
    d = f.dataset
    first = (d.views["train"] or d.views["test"])[0]
    test = [v for v in f.views if v.split == "test"] or list(f.views)
    return {
        "format": FORMAT,
        "scene": str(d.scene.get("scene", d.root.name)),
        "frequencies_hz": [mode.frequency_hz for mode in f.modes] or [d.scene.get("frequency_hz")],
        "amplitude": d.amplitude,
        "unit_scale_m": d.unit_scale_m,
        "size": list(first.size),
        "n_timesteps": d.n_timesteps,
        "n_train": len(d.by_camera("train")),
        "n_test": len(d.by_camera("test")),
        "pixels_max": max((v.maximum for v in test), default=None),
        "pixels_p95": max((v.p95 for v in test), default=None),
        "pixels_from": test[0].source if test else None,
        "still_area": f.still_area,
        "bytes": sum(share.on_disk for share in shares(d.root)),
        "scores": [
            {
                "alpha": row.alpha,
                "perfect_psnr_db": row.perfect_psnr_db,
                "perfect_ssim_least": row.pair.ssim if row.pair else None,
                "still_psnr_db": row.still_own_noise.psnr_db if row.still_own_noise else None,
                "still_same_noise_psnr_db": row.still.psnr_db if row.still else None,
            }
            for row in f.floor
        ],
    }


def _page(f: Findings, made: Image.Image) -> Page:
    d = f.dataset
    scene = str(d.scene.get("scene", d.root.name))
    return Page(
        title=f"{scene[:1].upper()}{scene[1:]}: a set with exact motion",
        kicker="vibration dataset, report of its contents",
        summary=_summary_words(f),
        stats=_stats(f),
        lead=[],
        sections=[
            pictures_section(f, made),
            motion_section(f),
            pixels_section(f),
            floor_section(f),
            making_section(f),
        ],
        footer=f"tg4mm {__version__}. {d.root.name}. Written from the files of the set alone.",
    )


def _summary_words(f: Findings) -> str:
    d = f.dataset
    frequencies = [m.frequency_hz for m in f.modes if m.frequency_hz] or [
        float(d.scene.get("frequency_hz") or 0)
    ]
    test = [v for v in f.views if v.split == "test"]
    words = f"It vibrates at {hertz(frequencies)}, by {length(d.amplitude, d.unit_scale_m)} at most"
    if test:
        pixels = max(v.maximum for v in test)
        seen = (
            "as the test cameras see it" if test[0].source == "truth" else "projected into the test cameras"
        )
        words += f", which is {number(pixels)} pixels {seen}"
    return words + "."


def _stats(f: Findings) -> list[Stat]:
    d = f.dataset
    found = summary(f)
    stats = [
        Stat("Cameras", str(found["n_train"]), "training", f"and {plural(found['n_test'], 'test camera')}"),
        Stat("Timesteps", str(d.n_timesteps), "", f"{number(d.fps)} Hz, {number(d.n_timesteps / d.fps)} s"),
        Stat("Largest displacement", number(d.amplitude), "units", "scene units, at any timestep, α = 0"),
    ]
    if found["pixels_max"] is not None:
        note = f"95th percentile of what moves: {number(found['pixels_p95'])}; the view with most"
        stats.append(Stat("Largest motion in a picture", number(found["pixels_max"]), "px", note))
    if f.floor and f.floor[-1].perfect_psnr_db is not None:
        row = f.floor[-1]
        still = row.still_own_noise or row.still
        note = f"nothing moves: {still.psnr_db:.1f} dB" if still else ""
        stats.append(Stat(f"Perfect method, α = {row.alpha:g}", f"{row.perfect_psnr_db:.1f}", "dB", note))
    value, unit = size_text(found["bytes"]).split(" ")
    stats.append(Stat("On disk", value, unit, "equal pictures counted once"))
    return stats


def _thumbnail(d: Dataset, width: int = 320) -> Image.Image | None:
    views = [v for v in (*d.at("train", 0), *d.at("test", 0)) if v.image.is_file()]
    if not views:
        return None
    image = read_picture(views[0].image)
    return resized(image, width, round(width * image.shape[0] / image.shape[1]))


def save(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file of the report, whole or not at all."""
    with whole(path) as temporary:
        write(temporary)
