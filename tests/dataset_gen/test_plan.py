"""Every file of the set comes from exactly one shot, and equal states are rendered once."""

import os
import subprocess
import sys

import numpy as np
import pytest

from dataset_gen.effects.record import moments
from dataset_gen.options import parser, request_from
from dataset_gen.plan import shots
from dataset_gen.prepare import builtin_bodies, motion_of


def plan(arguments=""):
    settings = request_from(parser().parse_args(["mic", *arguments.split(), "--out", "x"])).sets[0]
    return settings, shots(settings, motion_of(settings, builtin_bodies("mic")))


def test_the_demo_set_costs_155_renders():
    _, every = plan()
    assert sum(shot.split == "train" for shot in every) == 90
    assert sum(shot.split == "test" for shot in every) == 65
    assert sum(len(shot.pictures) for shot in every) == 30 * 30 + 30 * 5 * 6


def test_with_noise_of_its_own_every_picture_is_a_render_and_truth_is_not_rendered_twice():
    _, every = plan("--noise picture")
    own, shared = ([s for s in every if bool(s.pictures) == wanted] for wanted in (True, False))
    assert len({s.seed_offset for s in own}) == len(own) == 30 * 30 + 30 * 5 * 6
    assert not any(s.seed_offset == 0 for s in own)
    assert sorted(name for s in shared for name in s.truth) == sorted(n for s in plan()[1] for n in s.truth)
    assert len(shared) == 15  # three states, five test cameras


def test_an_exposure_shows_the_motion_times_the_sinc_of_it():
    _, every = plan("--shutter 33.3 --points 0")
    blurred = [s for s in every if s.blur]
    assert {s.split for s in blurred} == {"train"}
    shares = [share for share, _ in moments(0.0333)]
    assert sum(shares) == pytest.approx(1)
    shown = [np.dot(shares, [state.gains[0] for state in s.blur]) for s in blurred]
    true = [s.state.gains[0] * np.sinc(5 * 0.0333) for s in blurred]
    np.testing.assert_allclose(shown, true, rtol=1e-6, atol=1e-9)


def test_every_process_plans_the_same_order():
    """Workers receive positions in the plan: frames 1 and 2 of a hand-held camera show one state, and nothing may
    decide between them that differs from process to process.
    """
    code = (
        "from dataset_gen.options import parser, request_from; from dataset_gen.plan import shots\n"
        "from dataset_gen.prepare import builtin_bodies, motion_of\n"
        "words = 'mic --cameras handheld --timesteps 12 --out x'.split()\n"
        "settings = request_from(parser().parse_args(words)).sets[0]\n"
        "print([s.files for s in shots(settings, motion_of(settings, builtin_bodies('mic')))])"
    )
    orders = set()
    for seed in ("0", "1", "2", "3"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=True)
        orders.add(done.stdout)
    assert len(orders) == 1
