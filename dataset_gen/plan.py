"""The render plan: distinct pictures to render, and duplicates that are linked.

The principle that makes a dataset cheap: images depend on time and on α only through the motion state, that
is the gain of each mode at t, times (1 + α) where it is magnified. The renderer is deterministic for a fixed
seed, so timesteps of equal state are equal byte for byte. Every distinct (state, camera) is rendered once and
its file is hard-linked (copied where the file system has no links) to all the places that show it. A sine of
5 Hz at 30 frames per second has three states, 0 and ±sin 60°; the state 0 serves every α. 30 × 30 training
images then cost 90 renders. What a camera does to its pictures (shake, gain, noise, codec) makes files differ, and
costs encodings, not renders; with `--noise picture` every picture is a
render.

Linked files share their bytes: replace a file, do not write into it.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from .cameras import CameraSetup, SceneCamera, cameras_at, films, scene_time
from .effects import RecordingEffects
from .effects.record import bands, moments
from .pictures import generator
from .settings import Settings
from .vibration import Motion, State

RANGE = 300  # shots per process at most: memory of a renderer that runs for hours grows
UNCODED = ".uncoded"  # working folder: pictures before they go through a video
_PAINTERS = 60  # views that colour the points, at most about so many

_Seen = tuple[State, str, SceneCamera, tuple[State, ...], tuple[State, ...]]  # and `Shot.rows`, `Shot.blur`
_Key = tuple[_Seen, int]  # and `Shot.seed_offset`


@dataclass(frozen=True)
class PlannedPicture:
    """One image file: where it goes, relative to the dataset's folder, and what it shows."""

    path: str
    timestep: int
    alpha: float  # 0: the capture as it was


@dataclass(frozen=True)
class Shot:
    """One distinct picture: what to render, and where the files go."""

    split: str
    camera: SceneCamera
    state: State
    pictures: tuple[PlannedPicture, ...]
    truth: tuple[str, ...]  # EXR files, relative; empty where no truth is wanted
    paints: bool = False  # its colours go to points3d.ply
    seed_offset: int = 0
    rows: tuple[State, ...] = ()  # of the bands, read in turn; empty: all show `state`
    blur: tuple[State, ...] = ()  # at the moments of `effects.record`, whose mean is shown; empty: `state` is

    @property
    def files(self) -> tuple[str, ...]:
        """All files of the shot, relative to the dataset's folder."""
        return (*(picture.path for picture in self.pictures), *self.truth)


def magnified_folder(alpha: float) -> str:
    """Folder of the ground truth at a magnification factor, "magnified/x005"."""
    return f"magnified/x{int(alpha):03d}"


def picture_path(settings: Settings, timestep: int, camera: SceneCamera, split: str = "train") -> str:
    """Return the path of a picture at α = 0, relative to the dataset's folder."""
    return f"{timestep:03d}/{split}/{camera.name}{settings.pictures.suffix}"


def shots(settings: Settings, motion: Motion) -> list[Shot]:
    """All distinct pictures, sorted by state (moving geometry costs more than moving the camera).

    The truth of a camera that shakes is what it saw where it really was: shots without pictures.
    """
    record = RecordingEffects(settings.effects, settings.cameras, settings.size, settings.seed)
    pictures: dict[_Key, list[PlannedPicture]] = defaultdict(list)
    truth: dict[_Seen, list[str]] = defaultdict(list)
    for t in range(settings.timesteps):
        for split, cameras in cameras_at(settings.cameras, t).items():
            for alpha in (0, *(settings.alphas if split == "test" else ())):
                for camera in cameras:
                    state = _state(settings.cameras, motion, split, camera, t, alpha)
                    where = _folder(settings, split, camera, alpha) + picture_path(settings, t, camera, split)
                    rows, blur = _times(settings, motion, split, camera, t, state)
                    seen = state, split, camera, rows, blur
                    pictures[seen, _own_seed(settings, where)].append(PlannedPicture(where, t, alpha))
                    if not alpha and settings.truth in (split, "all"):
                        seen = state, split, record.true_camera(split, camera, t), rows, ()
                        truth[seen].append(f"truth/{split}/{t:03d}/{camera.name}.exr")
    # Not a set: its order, which decides between equal keys, would differ from one render process to the next.
    ordered = sorted(dict.fromkeys([*pictures, *((seen, 0) for seen in truth)]), key=_order)
    painters = _painters(sorted(pictures, key=_order)) if settings.points else set()
    return [
        Shot(
            split=key[0][1],
            camera=key[0][2],
            state=key[0][0],
            pictures=tuple(pictures.get(key, ())),
            truth=() if key[1] else tuple(truth.get(key[0], ())),
            paints=key in painters,
            seed_offset=key[1],
            rows=key[0][3],
            blur=key[0][4],
        )
        for key in ordered
    ]


def _own_seed(settings: Settings, path: str) -> int:
    """Added to the seed of a picture's render, 0 where pictures share one; whatever the order of rendering."""
    if settings.noise == "state":
        return 0
    return int(generator((settings.seed, path)).integers(1, 2**31))


def _folder(settings: Settings, split: str, camera: SceneCamera, alpha: float) -> str:
    """Return the renderer's output folder, "" or ending in a slash."""
    if alpha:
        return f"{magnified_folder(alpha)}/"
    coded = settings.effects.coded and split == "train" and films(settings.cameras, camera)
    return f"{UNCODED}/" if coded else ""


def _state(
    setup: CameraSetup, motion: Motion, split: str, camera: SceneCamera, timestep: int, alpha: float
) -> State:
    """Return the motion state that a camera sees at a timestep, on a training camera's own clock."""
    if split == "test":
        return motion.state(timestep, alpha)
    time_s = scene_time(setup, camera, timestep)
    return motion.rest if time_s is None else motion.state(time_s * setup.fps, alpha)


def _times(
    settings: Settings, motion: Motion, split: str, camera: SceneCamera, timestep: int, middle: State
) -> tuple[tuple[State, ...], tuple[State, ...]]:
    """Return the states seen by row bands (rolling shutter) or during an exposure; empty if only `middle`."""
    effects, setup = settings.effects, settings.cameras
    times = (
        [delay for _, delay in bands(settings.size, effects.readout_ms / 1e3)] if effects.readout_ms else [],
        [delay for _, delay in moments(effects.shutter_ms / 1e3)] if effects.shutter_ms else [],
    )
    if split == "test" or not any(times) or (time_s := scene_time(setup, camera, timestep)) is None:
        return (), ()
    rows, blur = (tuple(motion.state((time_s + delay) * setup.fps) for delay in delays) for delays in times)
    return () if set(rows) == {middle} else rows, () if set(blur) == {middle} else blur


def _order(key: _Key) -> tuple[bool, tuple[float, ...], bool, int, tuple[tuple[float, ...], ...], int]:
    (state, split, camera, rows, blur), seed = key
    times = tuple(r.gains for r in (*rows, *blur))
    return not state.at_rest, state.gains, split != "train", camera.index, times, seed


def _painters(keys: Sequence[_Key]) -> set[_Key]:
    """Return each training camera's picture nearest to rest, because the points are those of the rest scene.

    Of very many cameras (each frame of a hand-held one is a camera) an evenly spread subset is used.
    """
    nearest: dict[SceneCamera, _Key] = {}
    for key in keys:
        state, split, camera, *_ = key[0]
        if split == "train" and (camera not in nearest or _reach(state) < _reach(nearest[camera][0][0])):
            nearest[camera] = key
    found = list(nearest.values())
    step = -(-len(found) // _PAINTERS)
    return set(found[::step])


def _reach(state: State) -> float:
    return sum(gain * gain for gain in state.gains)


def ranges(count: int, parts: int) -> list[range]:
    """`count` shots cut into `parts` neighbouring, equal ranges; neighbours share a state."""
    edges = [count * i // parts for i in range(parts + 1)]
    return [range(a, b) for a, b in pairwise(edges)]
