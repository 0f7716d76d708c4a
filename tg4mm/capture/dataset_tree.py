"""Reader of the dataset tree ([3DMM]'s layout): a NeRF-synthetic folder per timestep, and scene.json."""

import re
from dataclasses import replace
from pathlib import Path

from tg4mm.capture import colmap, nerfstudio, transforms
from tg4mm.capture.frames import IMAGE_SUFFIXES, inside
from tg4mm.capture.model import Capture
from tg4mm.capture.scene import SceneDescription, read_scene
from tg4mm.capture.transforms import TransformsFrame, assemble, natural, read_views
from tg4mm.core.errors import CaptureError

LAYOUT = "a dataset tree (scene.json and timestep folders 000, 001, …)"
_PUBLISHED = re.compile(r"mag_([0-9]{1,4})x_test")


def recognises(root: Path) -> bool:
    """Return whether there are numbered folders, or a scene.json without frames of its own beside it."""
    if _numbered(root):
        return True
    single = any(reader.recognises(root) for reader in (transforms, nerfstudio, colmap))
    return (root / "scene.json").is_file() and not single


def load(root: Path, split: str, alpha: int) -> Capture:
    """Load all timesteps of a split, or those of the ground truth in magnified/x<alpha>/ if alpha is not 0.

    Raises CaptureError for a gap in the timesteps of a split, a missing split, no fps or a bad one, or other bad input.
    """
    scene = read_scene(root, needs_fps=True)
    base = root / "magnified" / f"x{alpha:03d}" if alpha else root
    if not base.is_dir() and (published := _published(root).get(alpha)) is not None:
        return _published_truth(root, published, scene)
    if not base.is_dir():
        raise CaptureError(
            f"{base}: does not exist: no ground truth for α = {alpha}; the dataset has {_present(root)}"
        )
    folders = _timestep_folders(root, base, gaps=bool(alpha))
    count = max(folders) + 1
    if alpha:
        count = max(count, scene.n_timesteps or 0)
    elif scene.n_timesteps is not None and scene.n_timesteps != count:
        raise CaptureError(
            f"{root / 'scene.json'}: n_timesteps is {scene.n_timesteps}, "
            f"but {base} holds {count} timestep folders, {folders[0].name} to {folders[count - 1].name}"
        )
    views = [view for t, folder in folders.items() for view in read_views(root, folder, split, t)]
    return assemble(root, split, views, scene, count)


def _published(root: Path) -> dict[int, Path]:
    """Find the folders of timesteps, by α, of ground truth in the layout of [3DMM].

    That is mag_50x_test/SCENE/000 … in the dataset's folder, beside it, or beside its parent. SCENE is the dataset's
    name, or the part of it before `_`.
    """
    found: dict[int, Path] = {}
    top = root.resolve()
    for above in (top, top.parent, top.parent.parent):
        for folder in sorted(above.glob("mag_*x_test")):
            match = _PUBLISHED.fullmatch(folder.name)
            for scene in (folder / top.name, folder / top.name.partition("_")[0]):
                if match and scene.is_dir() and _numbered(scene):
                    found.setdefault(int(match[1]), scene)
    return found


def _published_truth(root: Path, base: Path, scene: SceneDescription) -> Capture:
    """Return its pictures: those of the test views in order of name, unless transforms_test.json says more."""
    folders = _timestep_folders(base, base, gaps=True)
    test: list[TransformsFrame] = []
    views: list[TransformsFrame] = []
    for t, folder in folders.items():
        if (folder / "transforms_test.json").is_file():
            views += read_views(base, folder, "test", t)
            continue
        test = test or read_views(root, _timestep_folders(root, root, gaps=True)[0], "test", 0)
        pictures = sorted(
            (p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES),
            key=lambda p: natural(p.name),
        )
        if len(pictures) != len(test):
            raise CaptureError(
                f"{folder}: holds {len(pictures)} pictures, expected {len(test)}, one for each test view of {root}"
            )
        views += [
            replace(view, path=inside(base, path, "picture"), timestep=t)
            for view, path in zip(test, pictures, strict=True)
        ]
    return assemble(base, "test", views, scene, max(max(folders) + 1, scene.n_timesteps or 0))


def _numbered(base: Path) -> dict[int, Path]:
    found: dict[int, Path] = {}
    for path in sorted(base.iterdir()):
        if re.fullmatch(r"[0-9]{1,9}", path.name) and path.is_dir():
            if int(path.name) in found:
                raise CaptureError(
                    f"{path}: is the same timestep {int(path.name)} as {found[int(path.name)].name}"
                )
            found[int(path.name)] = path
    return found


def _timestep_folders(root: Path, base: Path, gaps: bool) -> dict[int, Path]:
    found = dict(sorted(_numbered(base).items()))
    if not found:
        raise CaptureError(f"{base}: holds no timestep folders 000, 001, …")
    for t in found if gaps else range(len(found)):
        if t not in found:
            raise CaptureError(
                f"{base}: timestep {t:03d} is missing, but there are {len(found)} timesteps, the last one "
                f"{max(found):03d}; restore the missing folder"
            )
        inside(root, found[t], "timestep folder")
    return found


def _present(root: Path) -> str:
    names = sorted(path.name for path in (root / "magnified").glob("x*") if path.is_dir())
    names += [path.parent.name for path in _published(root).values()]
    shown = ", ".join(f"magnified/{name}" if name[0] == "x" else name for name in names)
    return shown or "no magnified/x… folder"


def magnified_alphas(root: Path) -> list[int]:
    """The α above 0 that a dataset has ground truth for, ascending: of its folders magnified/x005."""
    names = (path.name[1:] for path in (root / "magnified").glob("x*") if path.is_dir())
    alphas = {int(n) for n in names if n.isdecimal() and n == f"{int(n):03d}" and int(n)}
    return sorted(alphas | set(_published(root)))
