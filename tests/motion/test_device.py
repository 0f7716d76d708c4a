"""The motion stage off the CPU: the same problem as the kernels', executed here on torch's CPU tensors."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.cuda import needs_cuda
from tests.motion.test_problem import draw, inner, problem
from tests.motion.test_view_jacobian import COLUMNS, SCENES, motion_of, view_of
from tests.rasterize.oracle import assert_close, make_scene
from tests.space.test_train import Killed, killed_after
from tests.synthetic import make_synthetic_dataset
from tg4mm.capture import load_capture, load_images
from tg4mm.errors import Tg4mmError
from tg4mm.motion import MotionConfig
from tg4mm.motion import fit as fitting
from tg4mm.motion import train as stage
from tg4mm.motion.animate import animator
from tg4mm.motion.jacobian import contributions
from tg4mm.motion.jacobian.contributions import DeviceViewJacobian, device_view_jacobian
from tg4mm.motion.jacobian.packed import DOF
from tg4mm.motion.jacobian.view import ViewJacobian
from tg4mm.motion.posing import pose
from tg4mm.motion.solver import device
from tg4mm.motion.solver.device import DeviceProblem
from tg4mm.motion.solver.pcg import start, step
from tg4mm.motion.train import train_motion
from tg4mm.runs import Run

EVERY_SCENE = {
    **SCENES,
    "light spent": make_scene(19, n=250, spread=0.3, scale=(0.1, 0.4), opacity=(0.3, 0.95)),
    "nearly opaque": make_scene(6, opacity=(0.9995, 1.0), scale=(0.05, 0.5)),
}
EXACT, HALF = 2e-5, 2e-3  # of the largest entry: float32 sums in another order; entries of 11 bits
SHORT = MotionConfig(components=2, iterations=3, tolerance=1e-6)


def pushed(view: DeviceViewJacobian, motion: np.ndarray) -> torch.Tensor:
    return view.jvp(torch.from_numpy(motion).to(view.means.device)).cpu()


def pulled(view: ViewJacobian | DeviceViewJacobian, picture: np.ndarray, n: int) -> torch.Tensor:
    if isinstance(view, ViewJacobian):
        total = np.zeros((n, DOF), np.float32)
        view.vjp(picture[None], total[None])
        return torch.from_numpy(total)
    place = view.means.device
    there = torch.zeros(n, DOF, device=place)
    view.vjp(torch.from_numpy(picture).to(place), there)
    return there.cpu()


def compare(name: str, columns: str, where: str, storage: torch.dtype, tolerance: float) -> None:
    """`jvp` and `vjp` of both kinds of view, and that a thousandth more would be noticed at EXACT."""
    scene = EVERY_SCENE[name]
    view, motion = view_of(scene), motion_of(scene, COLUMNS[columns])
    other = device_view_jacobian(view, where, storage)
    expected = torch.from_numpy(view.jvp(motion[None])[0])
    assert expected.abs().max() > 0.1
    assert_close("jvp", pushed(other, motion), expected, tolerance)
    shape = (scene.height, scene.width, 3)
    picture = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    back = pulled(view, picture, len(motion))
    assert_close("vjp", pulled(other, picture, len(motion)), back, tolerance)
    with pytest.raises(AssertionError):
        assert_close("jvp", 1.001 * expected, expected, EXACT)


@pytest.mark.parametrize("name", EVERY_SCENE)
@pytest.mark.parametrize("columns", COLUMNS)
def test_it_pushes_and_pulls_as_the_kernels(name: str, columns: str) -> None:
    compare(name, columns, "cpu", torch.float32, EXACT)


@pytest.mark.parametrize("name", EVERY_SCENE)
def test_half_precision_storage_costs_no_more_than_its_digits(name: str) -> None:
    compare(name, "both", "cpu", torch.float16, HALF)


@needs_cuda
@pytest.mark.parametrize(("storage", "tolerance"), [(torch.float32, 1e-4), (torch.float16, HALF)])
@pytest.mark.parametrize("name", EVERY_SCENE)
def test_on_cuda_it_pushes_and_pulls_as_the_kernels(
    name: str, storage: torch.dtype, tolerance: float
) -> None:
    compare(name, "both", "cuda", storage, tolerance)


def test_working_in_parts_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = SCENES["crowded"]
    view, motion = view_of(scene), motion_of(scene, COLUMNS["both"])
    whole = device_view_jacobian(view, "cpu", torch.float32)
    monkeypatch.setattr(contributions, "_AT_ONCE", 1000)  # less than one tile's list
    parts = device_view_jacobian(view, "cpu", torch.float32)
    assert len(parts.pixel) == len(whole.pixel) > 5 * 1000
    assert_close("jvp", pushed(parts, motion), pushed(whole, motion), 1e-5)
    picture = np.ones((scene.height, scene.width, 3), np.float32)
    assert_close("vjp", pulled(parts, picture, 120), pulled(whole, picture, 120), 1e-5)


def test_a_view_that_sees_nothing_says_nothing() -> None:
    scene = make_scene(0, distance=-20.0)
    view = device_view_jacobian(view_of(scene), "cpu", torch.float16)
    assert len(view.pixel) == 0
    assert not pushed(view, motion_of(scene, COLUMNS["both"])).any()
    assert not pulled(view, np.ones((scene.height, scene.width, 3), np.float32), 40).any()


@pytest.mark.parametrize("storage", [torch.float32, torch.float16])
def test_the_operator_stays_symmetric(storage: torch.dtype) -> None:
    """Whatever the storage: what was rounded is the same in both directions."""
    p, a, b = DeviceProblem(problem(), "cpu", storage), draw(1), draw(2)
    ta, tb = torch.from_numpy(a), torch.from_numpy(b)
    scale = np.sqrt(inner(a, p.normal(ta).numpy()) * inner(b, p.normal(tb).numpy()))
    assert abs(inner(a, p.normal(tb).numpy()) - inner(b, p.normal(ta).numpy())) < 1e-5 * scale


def check_problem(where: str, tolerance: float, weighted: bool) -> None:
    ours, theta = problem(weighted=weighted), draw(1)
    other = DeviceProblem(ours, where, torch.float32)
    there = torch.from_numpy(theta).to(where)
    assert_close("field", other.field(there).cpu(), torch.from_numpy(ours.field(theta)), tolerance)
    assert_close("normal", other.normal(there).cpu(), torch.from_numpy(ours.normal(theta)), tolerance)
    height, width = ours.views[0].transmittance.shape
    pictures = np.random.default_rng(2).normal(size=(2, height, width, 3)).astype(np.float32)
    expected = torch.from_numpy(np.asarray(ours.right_hand_side(pictures), np.float32))
    assert_close("right-hand side", other.right_hand_side(pictures).cpu(), expected, tolerance)
    mine, theirs = start(ours.right_hand_side(pictures)), start(other.right_hand_side(pictures))
    for _ in range(5):
        mine, theirs = step(mine, ours.normal), step(theirs, other.normal)
    assert isinstance(theirs.x, torch.Tensor)
    assert theirs.relative_residual == pytest.approx(mine.relative_residual, rel=1e-3)
    assert_close("solution", theirs.x.cpu(), torch.from_numpy(mine.x), 50 * tolerance)


@pytest.mark.parametrize("weighted", [False, True])
def test_it_is_the_same_problem(weighted: bool) -> None:
    check_problem("cpu", EXACT, weighted)


@needs_cuda
@pytest.mark.parametrize("weighted", [False, True])
def test_on_cuda_it_is_the_same_problem(weighted: bool) -> None:
    check_problem("cuda", 1e-4, weighted)


def test_memory_that_is_too_small_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(*_: object) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.\nmore lines")

    monkeypatch.setattr(device, "device_view_jacobian", exhausted)
    with pytest.raises(Tg4mmError, match=r"\A[^\n]*device cpu has: it holds 0 of 2 views[^\n]*\Z"):
        DeviceProblem(problem(), "cpu")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Run:
    root = tmp_path_factory.mktemp("device")
    gaussians, _ = make_synthetic_dataset(
        root / "data", n_views=3, n_timesteps=5, size=32, freqs=(6.0,), alphas=(), n_test=0
    )
    run = Run.create(root / "run", root / "data", "modal", {})
    run.save_space(gaussians, {})
    return run


@pytest.fixture
def new_run(made: Run, tmp_path: Path) -> Callable[[], Run]:
    def copy() -> Run:
        path = tmp_path / f"run{len(list(tmp_path.iterdir()))}"
        shutil.copytree(made.path, path)
        return Run.open(path)

    return copy


@pytest.fixture
def another_device(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> list[DeviceProblem]:
    """`cuda` means tensors on the CPU: everything but the device is what runs on a GPU. Holds the problems made."""
    problems: list[DeviceProblem] = []

    def on_cpu(of: object, where: str) -> DeviceProblem:
        assert where == "cuda"
        storage = getattr(request, "param", torch.float32)
        problems.append(DeviceProblem(of, "cpu", storage))  # type: ignore[arg-type]
        return problems[-1]

    real = fitting.placed
    monkeypatch.setattr(pose, "DeviceProblem", on_cpu)
    # a torch.device is not the string "cpu", for which arrays would stay arrays
    to_tensors = lambda state, where: state if where == "cpu" else real(state, torch.device("cpu"))  # noqa: E731
    monkeypatch.setattr(fitting, "placed", to_tensors)
    monkeypatch.setattr(stage, "gpu_figures", lambda _: {"peak_gpu_memory_mib": 1.0})
    monkeypatch.setattr(stage, "reset_gpu_peak", lambda _: None)
    return problems


def fit(run: Run, where: str, config: MotionConfig = SHORT) -> np.ndarray:
    capture = load_capture(run.dataset)
    return train_motion(run, capture, load_images(capture), config, where).displacement


@pytest.mark.parametrize(
    ("another_device", "tolerance"),
    [(torch.float32, 1e-3), (torch.float16, 3e-3)],
    indirect=["another_device"],
)
def test_the_stage_finds_the_same_motion(
    tolerance: float, new_run: Callable[[], Run], another_device: list[DeviceProblem]
) -> None:
    run = new_run()
    there, here = fit(run, "cuda"), fit(new_run(), "cpu")
    assert len(another_device) == 1
    assert np.abs(here).max() > 1e-4
    assert np.abs(there - here).max() < tolerance * np.abs(here).max()
    assert another_device[0].views[0].weight.dtype == (torch.float32 if tolerance < 2e-3 else torch.float16)
    assert run.log()["motion"]["peak_gpu_memory_mib"] == 1.0


@pytest.mark.parametrize("killed_at", [2, 6])
def test_killed_it_goes_on_to_the_bit(
    killed_at: int, new_run: Callable[[], Run], another_device: list[DeviceProblem],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Tensors to a checkpoint and back; here sums have one order, which atomics on a GPU do not keep."""
    monkeypatch.setattr(stage, "CHECKPOINT_EVERY_S", -1.0)
    expected, run = fit(new_run(), "cuda"), new_run()
    with monkeypatch.context() as patch:
        patch.setattr(stage, "progress", killed_after(killed_at))
        with pytest.raises(Killed):
            fit(run, "cuda")
    np.testing.assert_array_equal(fit(run, "cuda"), expected)


def test_a_run_begun_there_ends_here(
    new_run: Callable[[], Run], another_device: list[DeviceProblem], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stage, "CHECKPOINT_EVERY_S", -1.0)
    expected, run = fit(new_run(), "cpu"), new_run()
    with monkeypatch.context() as patch:
        patch.setattr(stage, "progress", killed_after(3))
        with pytest.raises(Killed):
            fit(run, "cuda")
    assert run.load_checkpoint("motion") is not None
    assert np.abs(fit(run, "cpu") - expected).max() < 1e-3 * np.abs(expected).max()


@needs_cuda
def test_the_stage_on_cuda_finds_the_same_motion(new_run: Callable[[], Run]) -> None:
    there, here = fit(new_run(), "cuda"), fit(new_run(), "cpu")
    assert np.abs(there - here).max() < 1e-2 * np.abs(here).max()


@needs_cuda
def test_a_mover_on_cuda_moves_as_on_the_cpu(new_run: Callable[[], Run]) -> None:
    run = new_run()
    fit(run, "cpu")
    gaussians, motion = run.load_space(), run.load_motion()
    here, there = (animator(gaussians.to(d), motion)(2.5, 20.0, (4.0, 8.0)) for d in ("cpu", "cuda"))
    assert there.means.is_cuda
    assert_close("means", there.means, here.means, 1e-6)
    assert_close("quats", there.quats, here.quats, 1e-6)
