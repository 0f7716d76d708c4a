"""Figures of the motion from a camera: peak displacement, laid over what the camera sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tg4mm.core.pages import svg
from tg4mm.core.pages.page import Block, Figure, Text, picture

from .dataset import Dataset, MotionTruth, View, read_picture
from .modes import Track, peak_of_phasor, phasor_maps, together
from .pictures import dotted, enlarged, overlay, ringed
from .pixels import Seen
from .text import hertz, unit_of

_MOST = 6


def mode_maps(
    dataset: Dataset, seen: Mapping[str, Seen], track: Track | None, names: Sequence[str]
) -> list[Block]:
    """A figure for each mode, those that go alike in time together; `names` are what the modes are called.

    From the per-pixel truth `seen` where it tells the modes apart, else from the vertices.
    """
    assert dataset.motion is not None
    motion, groups = together(dataset.motion)
    found = {name: phasor_maps(one, motion) for name, one in seen.items()}
    maps = {name: phasors for name, phasors in found.items() if phasors is not None}
    blocks: list[Block] = []
    for k, group in enumerate(groups[:_MOST]):
        frequency = float(motion.frequencies_hz[k])
        what = f"{_listed([names[i] for i in group])}, {hertz([frequency]) if frequency else 'a drift'}"
        gain = float(np.abs(motion.gains[:, k]).max(initial=0.0))
        if maps:
            amounts = {name: gain * peak_of_phasor(phasors[k]) for name, phasors in maps.items()}
            blocks.append(_truth_map(dataset, seen, track, amounts, what))
        else:
            blocks.append(_vertex_map(dataset, motion, k, gain, what))
    if seen and not maps:
        said = "The per-pixel truth does not tell the modes apart (the camera moves, or there are too few timesteps)."
        blocks.append(Text(said))
    if len(groups) > _MOST:
        blocks.append(Text(f"{len(groups) - _MOST} further modes have no map here."))
    return blocks


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]} together"


def _truth_map(
    dataset: Dataset,
    seen: Mapping[str, Seen],
    track: Track | None,
    amounts: Mapping[str, np.ndarray],
    what: str,
) -> Figure:
    top = max((float(np.nanmax(a)) for a in amounts.values() if not np.isnan(a).all()), default=0.0)
    panels = []
    for name, amount in amounts.items():
        image = read_picture(seen[name].view.image)
        shown = enlarged(overlay(image, amount, top))
        if track is not None and track.view == name:
            shown = ringed(shown, track.pixel, shown.shape[0] // image.shape[0])
        panels.append(picture(shown, f"test {name}", crisp=True))
    unit, factor = unit_of(dataset)
    caption = (
        f"{what}: peak displacement, in 3D, of the surface that each pixel's centre sees, from the per-pixel truth "
        "over the picture in grey. Grey surfaces stand still, and grey pixels at an edge see one surface after "
        "another. The ring marks the point that is shown over time."
    )
    return Figure(panels, caption, legend=svg.colour_bar(top * factor, unit, "peak displacement"))


def _vertex_map(dataset: Dataset, motion: MotionTruth, k: int, gain: float, what: str) -> Figure | Text:
    view = _any_view(dataset)
    if view is None:
        return Text("There is no picture to draw the motion into.")
    points = np.concatenate([body.rest for body in motion.bodies]).astype(np.float64)
    amounts = gain * np.concatenate([peak_of_phasor(body.modes[k]) for body in motion.bodies])
    top = float(amounts.max(initial=0.0))
    unit, factor = unit_of(dataset)
    panel = picture(
        enlarged(dotted(read_picture(view.image), view, points, amounts, top)), view.name, crisp=True
    )
    caption = (
        f"{what}: peak displacement, in 3D, of the vertices in this view, hidden ones too, from truth/motion.npz, "
        "since there is no per-pixel truth that could be used."
    )
    legend = svg.colour_bar(top * factor, unit, "peak displacement")
    return Figure([panel], caption, legend=legend, width="small")


def _any_view(dataset: Dataset) -> View | None:
    views = dataset.views["test"] or dataset.views["train"]
    return next((view for view in views if view.image.is_file()), None)
