"""Commands that can be killed: tiny inputs, and what of the files is not final while they work."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.helpers.synthetic import make_synthetic_dataset, moving_run


@dataclass(frozen=True)
class Command:
    """`prepare(folder)` makes what is given to the command; of its words, F is the folder. It writes there, too."""

    prepare: Callable[[Path], object]
    words: str
    passing: tuple[str, ...] = ()  # patterns of files that are not what they will be while it works


def _dataset(folder):
    make_synthetic_dataset(
        folder / "set", n_views=3, n_timesteps=6, size=24, freqs=(5.0,), amplitude=0.03, alphas=(), n_test=0
    )


def _scored(folder):
    make_synthetic_dataset(
        folder / "sway_5Hz_0_03", n_views=5, n_timesteps=6, size=32, freqs=(5.0,), alphas=(5,), n_test=1
    )


def _run(folder):
    from tests.show.measure.filmed import modes, of_parts, run_of, sine

    run_of(folder, of_parts(ball=sine(5.0, [0.01, 0, 0])), modes({}, 8), n_timesteps=8, n_views=3)


def _video(folder):
    from tests.capture.sfm.videos import still, write_video

    write_video(folder / "a.mp4", still(12))


def _moving(folder):
    moving_run(folder, n_views=3, n_timesteps=8, size=24, freqs=(5.0,), amplitude=0.03, n_test=1, alphas=(5,))


def _long_video(folder):
    from tests.capture.sfm.videos import still, write_video

    write_video(folder / "a.mp4", still(30))


def _photographs(folder):
    from tests.capture.sfm.scenes import intrinsics, orbit, picture, save

    (folder / "in").mkdir()
    for i, viewmat in enumerate(orbit(8, turn=1.8)):
        shown = picture(viewmat, intrinsics(240, 180, 250.0), (240, 180), 0.0, False)
        save(folder / "in" / f"p_{i}.png", shown)


TRAIN = "train F/set --out F/out --set space.max_gaussians=300 --set "
BENCH = " --set ".join(
    ("", "space.iterations=60", "space.max_gaussians=300", "motion.iterations=4", "motion.components=2")
)
PAPER = "channels=2 resolution=16 iterations=80 warm_up=40 motion_iterations=20".replace(" ", " --set paper.")
GENERATE = "--size 16 --samples 1 --timesteps 3 --views 3 --test-views 1 --alphas 5 --truth none --points 0"
STAGES = ("out/*.safetensors", "out/*.json")
COMMANDS = {
    "train": Command(_dataset, f"{TRAIN}space.iterations=120 --set motion.iterations=3", STAGES),
    "train-paper-tuned": Command(_dataset, f"{TRAIN}paper.{PAPER} --preset paper-tuned", STAGES),
    "render": Command(_run, "render F/run --alpha 0 --split train --out F/out"),
    "measure": Command(_run, "measure F/run --out F/out --sensor all"),
    "sfm": Command(_video, "sfm F/a.mp4 --out F/out"),
    "sfm-photographs": Command(
        _photographs,
        "sfm F/in --out F/out",
        ("out/sfm/*.tmp*", "out/sfm/.*", "out/sfm/sparse/.*", "out/sfm/database.db*"),
    ),
    "look": Command(_long_video, "look F/a.mp4 --out F/out"),
    "process": Command(_long_video, "process F/a.mp4 --out F/out --quick", ("out/process.json", "out/run/*")),
    "evaluate": Command(_moving, "evaluate F/run --out F/out.json"),
    "export-usd": Command(_moving, "export F/run --format usd --out F/out.usdc"),
    "convert-colmap": Command(_dataset, "convert F/set --to colmap --out F/out"),
    "bench": Command(
        _scored,
        f"bench scenes F/sway_5Hz_0_03 --out F/out --same-time never --methods modal,linear-2d --alphas 5{BENCH}",
        ("out/.warm-up-*", "out/results*", "out/*.svg", "out/tables/*", "out/runs/*"),
    ),
    "generate": Command(lambda folder: None, f"generate mic --out F/out {GENERATE}", ("*/.parts/*",)),
}
