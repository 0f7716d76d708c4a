"""All that runs with --device cuda, on a pretended GPU: everything on one device, and no transfer in an iteration."""

from __future__ import annotations

import sys
import types
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils import backend_registration
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

from tests.fit.rasterize.oracle import assert_close
from tests.helpers.space_cuda import spherical_harmonics
from tests.helpers.synthetic import make_synthetic_dataset, moving_run
from tg4mm.capture import load_capture, load_images
from tg4mm.core.magnification import Magnification
from tg4mm.core.pictures.decode import read_png
from tg4mm.fit.gaussians import Gaussians
from tg4mm.fit.motion import MotionConfig
from tg4mm.fit.space import SpaceConfig, rest_views
from tg4mm.fit.space import train as space_stage
from tg4mm.fit.space import train as stage
from tg4mm.research.bench.methods.deformed import fit_motion
from tg4mm.research.bench.methods.tracking import TrackingConfig, track, track_along
from tg4mm.research.paper import space as paper_space
from tg4mm.research.paper.model import PaperConfig
from tg4mm.research.paper.motion import train_timesteps
from tg4mm.research.paper.space import Fit, first_views, train_triplane
from tg4mm.run import Run
from tg4mm.run.stages import train_motion, train_space
from tg4mm.show.render.cameras import capture_cameras
from tg4mm.show.render.sequence import RenderRequest, render_sequence

NAME = "pretended"
_aten = torch.ops.aten
_FETCHES = (_aten._local_scalar_dense.default, _aten.equal.default)
# how many numbers they give is known only once the device has worked it out
_WAITS = (
    _aten.nonzero.default,
    _aten.masked_select.default,
    _aten._unique2.default,
    _aten.unique_dim.default,
    _aten.unique_consecutive.default,
    _aten.repeat_interleave.Tensor,
    _aten.bincount.default,
)
_BY_INDEX = (_aten.index.Tensor, _aten.index_put_.default)  # by a mask they wait, too
# Others take a number of the CPU's.
_WITHOUT_SCALARS = (_aten.cat.default, _aten.stack.default, _aten.copy_.default)
FIRST = 1e-4  # of the largest gradient, at the first step
LATER = 1e-3  # the same at later steps, whose parameters have gone apart already
MOVED = 1e-2  # of the largest change of a parameter
# Rounding of a gradient is up to 3e-5 of its tensor's largest entry: 3e-3 of an entry of this share of it.
FLOOR = 1e-2
LEAST = 0.05  # of a tensor's entries must be compared: a comparison of nothing would hold

SHORT = SpaceConfig(iterations=12, max_gaussians=500, init_points=300, dssim=0.2)
# Small rates: Adam's first steps are as long for a gradient of rounding as for any other, and later gradients tell.
PAPER = PaperConfig(
    channels=4, resolution=32, iterations=12, warm_up=6, motion_iterations=10, shared=True,
    learning_rate=1e-5, motion_learning_rate=1e-5,
)  # fmt: skip
FEW = MotionConfig(components=2, iterations=4, tolerance=1e-6)


@cache
def register() -> None:
    """Once in a process: torch knows the device."""
    backend_registration._setup_privateuseone_for_python_backend(NAME)


class There(Tensor):
    """A tensor of the pretended GPU; `here` holds its numbers."""

    here: Tensor
    is_cuda = property(lambda self: True)  # type: ignore[assignment]
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, here: Tensor) -> There:
        strided = here.layout == torch.strided
        return Tensor._make_wrapper_subclass(  # type: ignore[attr-defined, no-any-return]
            cls, here.size(), strides=here.stride() if strided else None, dtype=here.dtype, device=f"{NAME}:0"
        )

    def __init__(self, here: Tensor) -> None:
        self.here = here

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise AssertionError(f"{func} outside of the pretended GPU")

    def __repr__(self) -> str:
        return f"There({self.here!r})"


def _is_there(device: Any) -> bool:
    return device is not None and torch.device(device).type == NAME


class Generator(torch.Generator):
    """torch has none for a device that is written in Python: the CPU's."""

    def __new__(cls, device: Any = "cpu") -> Generator:
        return super().__new__(cls, "cpu" if _is_there(device) else device)


class Gpu(TorchDispatchMode):
    """Operations on the device, while it is active: `counts` of what crosses to and from the host, and of waits."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: Counter[str] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        asked = kwargs.get("device")
        tensors = [t for t in tree_leaves((args, kwargs)) if isinstance(t, Tensor)]
        there = [t for t in tensors if isinstance(t, There)]
        if not there and not _is_there(asked):
            return func(*args, **kwargs)
        self._watch(func, args, asked, tensors)
        comes_back = asked is not None and not _is_there(asked)
        if asked is not None:
            kwargs["device"] = "cpu"
        args, kwargs = tree_map_only(There, lambda t: t.here, (args, kwargs))
        out = func(*args, **kwargs)
        if comes_back:
            return out.clone() if any(out is t.here for t in there) else out
        known = {id(t.here): t for t in there} | {id(t): t for t in tensors if not isinstance(t, There)}
        return tree_map_only(Tensor, lambda t: known[id(t)] if id(t) in known else There(t), out)

    def _watch(self, func: Any, args: Any, asked: Any, tensors: list[Tensor]) -> None:
        left = [t for t in tensors if not isinstance(t, There) and (t.dim() or func in _WITHOUT_SCALARS)]
        if func is _aten.copy_.default and left:
            self.counts["up" if isinstance(args[0], There) else "down"] += 1
        elif func is _aten._to_copy.default:
            is_there, goes_there = isinstance(args[0], There), _is_there(asked)
            if asked is not None and is_there != goes_there:
                self.counts["up" if goes_there else "down"] += 1
        elif left and len(left) < len(tensors):
            shapes = ", ".join(str(tuple(t.shape)) for t in left)
            raise RuntimeError(f"{func}: expected all tensors on one device, found {shapes} on the CPU")
        is_mask = func in _BY_INDEX and any(t.dtype == torch.bool and t.dim() for t in tensors[1:])
        self.counts["down"] += func in _FETCHES
        self.counts["waits"] += func in _WAITS or is_mask

    def made_here(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """`function` of CPU tensors as one of the device's, gradients included; nothing of it is counted."""

        class Down(torch.autograd.Function):
            @staticmethod
            def forward(ctx: Any, value: Tensor) -> Tensor:
                assert isinstance(value, There)
                return value.here.clone()

            @staticmethod
            def backward(ctx: Any, gradient: Tensor) -> Tensor:
                return There(gradient)

        class Up(torch.autograd.Function):
            @staticmethod
            def forward(ctx: Any, value: Tensor) -> Tensor:
                return There(value.clone())

            @staticmethod
            def backward(ctx: Any, gradient: Tensor) -> Tensor:
                assert isinstance(gradient, There)
                return gradient.here

        def called(*args: Any, **kwargs: Any) -> Any:
            args, kwargs = tree_map_only(Tensor, lambda t: Down.apply(t), (args, kwargs))
            return tree_map_only(Tensor, lambda t: Up.apply(t), function(*args, **kwargs))

        return called


def gsplat_of(gpu: Gpu, harmonics: Callable[..., Tensor]) -> types.ModuleType:
    """A gsplat whose calls are our CPU path's."""
    from tg4mm.fit.rasterize import rasterization

    def rasterize(*args: Any, packed: bool, **kwargs: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
        renders, alphas, _ = rasterization(*args, **kwargs)
        return renders, alphas, {}

    module = types.ModuleType("gsplat")
    module.rasterization = gpu.made_here(rasterize)  # type: ignore[attr-defined]
    module.spherical_harmonics = gpu.made_here(harmonics)  # type: ignore[attr-defined]
    return module


@contextmanager
def pretended_gpu(monkeypatch: pytest.MonkeyPatch, harmonics: Callable[..., Tensor]) -> Iterator[Gpu]:
    with Gpu() as gpu:
        monkeypatch.setitem(sys.modules, "gsplat", gsplat_of(gpu, harmonics))
        monkeypatch.setattr(torch, "Generator", Generator)
        real = torch.tensor  # makes its result where no mode sees it

        def tensor(data: Any, device: Any = None, **kwargs: Any) -> Tensor:
            made = real(data, **kwargs)
            return made if device is None else made.to(device)

        monkeypatch.setattr(torch, "tensor", tensor)
        yield gpu


@dataclass
class Steps:
    """What each step left, by parameter; tensors stay on their device, so that nothing crosses for being watched."""

    start: dict[str, Tensor]
    end: dict[str, Tensor] = field(default_factory=dict)
    means: list[dict[str, Tensor]] = field(default_factory=list)  # Adam's, of the gradient
    squares: list[dict[str, Tensor]] = field(default_factory=list)  # and of its square

    def add(self, parameters: Mapping[str, Tensor], moments: Mapping[str, Tensor]) -> None:
        """The state after a step; moments are called `<name>.m` and `<name>.v`."""
        self.end = copied(parameters)
        self.means.append({name: moments[f"{name}.m"].clone() for name in parameters})
        self.squares.append({name: moments[f"{name}.v"].clone() for name in parameters})


def copied(parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name: p.detach().clone() for name, p in parameters.items()}


def watch_paper(monkeypatch: pytest.MonkeyPatch) -> list[Steps]:
    """The steps of each `Fit` that is made from now on, in the order of their making."""
    watched: list[Steps] = []
    start, step = Fit.__init__, Fit.step

    def started(fit: Fit, *arguments: Any) -> None:
        start(fit, *arguments)
        watched.append(Steps(copied(fit.parameters)))

    def stepped(fit: Fit, loss: Tensor) -> None:
        step(fit, loss)
        tensors = fit.tensors()  # m.<name>, v.<name>
        watched[-1].add(fit.parameters, {f"{k[2:]}.{k[0]}": v for k, v in tensors.items() if k[1] == "."})

    monkeypatch.setattr(Fit, "__init__", started)
    monkeypatch.setattr(Fit, "step", stepped)
    return watched


def watch_space(monkeypatch: pytest.MonkeyPatch) -> list[Steps]:
    """The steps of each space stage that is run from now on. Its Gaussians start `oblong`."""
    watched: list[Steps] = []
    iterate, initial = space_stage._iterate, space_stage.initial_parameters

    def iterated(fit: Any, *arguments: Any) -> None:
        if fit.iteration == 0:
            watched.append(Steps(copied(fit.adam.parameters)))
        iterate(fit, *arguments)
        watched[-1].add(fit.adam.parameters, fit.adam.moments())

    def started(*arguments: Any) -> dict[str, Tensor]:
        made = initial(*arguments)
        return made | {"log_scales": made["log_scales"] + _stretches(made["log_scales"].shape)}

    monkeypatch.setattr(space_stage, "_iterate", iterated)
    monkeypatch.setattr(space_stage, "initial_parameters", started)
    return watched


def _stretches(shape: torch.Size) -> Tensor:
    return 0.5 * torch.randn(shape, generator=torch.Generator().manual_seed(1))


def oblong(gaussians: Gaussians) -> Gaussians:
    """The same with unequal axes: the picture then shows every turn, so gradients by quaternions exceed rounding."""
    return replace(gaussians, scales=gaussians.scales * _stretches(gaussians.scales.shape).exp())


def certain(squares: list[Tensor]) -> Tensor:
    """Entries whose steps hang on no rounding: their root mean squares, once not zero, were never small."""
    roots = torch.stack(squares).cpu().double().sqrt()
    largest = roots.flatten(1).amax(1).reshape(-1, *[1] * squares[0].dim())
    return ((roots == 0) | (roots > FLOOR * largest)).all(0) & (roots[-1] > 0)


def assert_same_steps(found: Steps, expected: Steps) -> None:
    """`found` has the gradients of `expected`, step by step, and moved its parameters as far; but for rounding."""
    assert len(found.means) == len(expected.means) > 0
    for name in expected.start:
        for k, (a, b) in enumerate(zip(found.means, expected.means, strict=True)):
            bound = LATER if k else FIRST
            assert_close(f"step {k + 1}, gradient by {name}", a[name], b[name].cpu(), bound)
        sure = certain([squares[name] for squares in expected.squares])
        assert sure.double().mean() > LEAST, f"{name}: too many gradients hang on rounding"
        moved, wanted = ((steps.end[name] - steps.start[name]).cpu() for steps in (found, expected))
        assert_close(f"change of {name}", moved * sure, wanted * sure, MOVED)


register()  # while tests are collected: before any backward pass


@pytest.fixture
def gpu(monkeypatch):
    for module in (stage, paper_space):
        for name in ("SHOW_EVERY_S", "CHECKPOINT_EVERY_S"):  # what is shown or saved is fetched
            monkeypatch.setattr(module, name, 1e9)
    with pretended_gpu(monkeypatch, spherical_harmonics) as there:
        yield there


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset that moves, and a run with its exact Gaussians and motion."""
    root = tmp_path_factory.mktemp("pretended")
    run = moving_run(root, n_views=6, n_timesteps=6, size=32, freqs=(5.0,), alphas=(5,), n_test=2)
    return root / "data", run


def counted(gpu):
    found = dict(gpu.counts)
    gpu.counts.clear()
    return found


def trained_space(data, path, iterations, device):
    capture = load_capture(data)
    views = rest_views(capture, load_images(capture))
    config = replace(SHORT, iterations=iterations)
    return train_space(Run.create(path, data, "modal", {}), views, capture.points, config, device)


def test_the_space_stage(made, tmp_path, gpu, monkeypatch):
    watched = watch_space(monkeypatch)
    trained_space(made[0], tmp_path / "there", 12, NAME)
    of_twelve = counted(gpu)
    trained_space(made[0], tmp_path / "here", 12, "cpu")
    assert not counted(gpu)
    assert_same_steps(*watched)
    counted(gpu)  # what the comparison fetched
    trained_space(made[0], tmp_path / "longer", 24, NAME)
    assert counted(gpu) == of_twelve  # twice the iterations bring nothing more to the host, nor to the device


@pytest.mark.slow
def test_the_motion_stage(made, tmp_path, gpu):
    data, source = made
    capture = load_capture(data)
    images, found, crossed = load_images(capture), [], []
    # After 4 iterations folds agree on less, and other transfers follow than after 8 or 12.
    for place, iterations in ((NAME, 8), ("cpu", 8), (NAME, 12)):
        run = Run.create(tmp_path / f"{place}{iterations}", data, "modal", {})
        run.save_space(source.load_space(), {})
        counted(gpu)
        motion = train_motion(run, capture, images, replace(FEW, iterations=iterations), place)
        found.append(torch.view_as_real(torch.from_numpy(motion.displacement)))
        crossed.append(counted(gpu))
    assert_close("displacement", found[0], found[1], 1e-2)
    # By two halves of the cameras.
    solved = 2 * int(Run.open(tmp_path / f"{NAME}8").log()["motion"]["components"])
    assert crossed[1] == {}
    sums = 2 * 4 * solved  # two of every step of conjugate gradients
    assert crossed[2] == crossed[0] | {"down": crossed[0]["down"] + sums}


@pytest.mark.slow
def test_motion_of_more_than_a_pixel(tmp_path, gpu):
    """One Gauss-Newton iteration: refining the scene at rest forks from the last digits."""
    gaussians, _ = make_synthetic_dataset(
        tmp_path / "data", n_views=6, n_timesteps=5, size=32, freqs=(6.0,), amplitude=0.2, alphas=(), n_test=0
    )
    capture = load_capture(tmp_path / "data")
    images, found = load_images(capture), []
    config = replace(FEW, components=1, smoothness_weight=300.0, gauss_newton=1)
    for place in ("cpu", NAME):
        run = Run.create(tmp_path / place, tmp_path / "data", "modal", {})
        run.save_space(gaussians, {})
        motion = train_motion(run, capture, images, config, place)
        assert run.log()["motion"]["gauss_newton"] == 1
        found.append(torch.view_as_real(torch.from_numpy(motion.displacement)))
    assert_close("displacement", found[1], found[0], 1e-2)


def test_pictures(made, tmp_path, gpu):
    data, run = made
    cameras = capture_cameras(load_capture(data, split="test"))
    request = RenderRequest(Magnification.of(5))
    here, there = (
        render_sequence(run, cameras, request, tmp_path / place, video=False, device=place)
        for place in ("cpu", NAME)
    )
    pictures = sorted(here.rglob("*.png"))
    assert len(pictures) == gpu.counts["down"] > 0  # a picture crosses once
    assert gpu.counts["waits"] == 0
    for path in pictures:
        a, b = read_png(path).astype(int), read_png(there / path.relative_to(here)).astype(int)
        assert np.abs(a - b).max() <= 1


def scattered(gaussians):
    """A little off their places: of two at the same depth, rounding would decide which is in front."""
    noise = torch.randn(gaussians.means.shape, generator=torch.Generator().manual_seed(2))
    return replace(gaussians, means=gaussians.means + 0.01 * noise)


def test_the_preset_paper(made, tmp_path, gpu, monkeypatch):
    data, source = made
    capture = load_capture(data)
    images, counts, base = load_images(capture), [], scattered(oblong(source.load_space()))
    watched = watch_paper(monkeypatch)
    for place, times in ((NAME, 1), ("cpu", 1), (NAME, 2)):
        run = Run.create(tmp_path / f"{place}{times}", data, "paper", {})
        config = replace(PAPER, iterations=6 + 6 * times, motion_iterations=PAPER.motion_iterations * times)
        counted(gpu)
        views = first_views(capture, images)
        run.save_space(base, {})
        model = train_triplane(run, base, views, config, place)
        train_timesteps(run, model, capture, images, config, place)
        counts.append(counted(gpu))
        if times == 1:
            out = render_sequence(
                run, capture_cameras(load_capture(data, split="test"))[:1], RenderRequest(Magnification.of(5)),
                tmp_path / f"pictures_{place}", video=False, device=place,
            )  # fmt: skip
            assert any(out.rglob("*.png"))
    assert counts[1] == {}
    n_fits = capture.n_timesteps  # phase 1, and phase 2 of each timestep but the first
    for found, expected in zip(watched[:n_fits], watched[n_fits : 2 * n_fits], strict=True):
        assert_same_steps(found, expected)
    assert counts[2] == counts[0]


@pytest.mark.parametrize("fit", [track, track_along])
def test_the_method_tracking(fit, made, tmp_path, gpu):
    data, source = made
    capture = load_capture(data)
    images, base, found = load_images(capture), scattered(oblong(source.load_space())), []
    config = TrackingConfig(iterations=5, resolution=8, levels=1, channels=4, width=8)
    for place in ("cpu", NAME):
        run = Run.create(tmp_path / place, data, "modal", {})
        run.save_space(base, {})
        fit_motion(run, capture, images, fit, config, place)
        found.append(torch.view_as_real(torch.from_numpy(run.load_motion().displacement)))
        assert bool(counted(gpu)) == (place == NAME)
    assert found[0].abs().max() > 0
    assert_close("displacement", found[1], found[0], 1e-2)
