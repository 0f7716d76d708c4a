"""The page as a file: fields and numbers to their stated errors, whole, alone, and refused where it could not be."""

import base64
import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.capture.conftest import edit
from tests.helpers.runs import made_run
from tests.helpers.synthetic import moving_run as moving_run_of
from tg4mm.cli import main
from tg4mm.core.errors import RunError, Tg4mmError
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.show.web.pack import SH_STEP, MotionFields, motion_fields, pack, packed_within, unpack
from tg4mm.show.web.write import export_html, make_page, render


@pytest.fixture(scope="module")
def packed(moving_run):
    motion = moving_run.load_motion()
    return pack(moving_run.load_space(), motion_fields(motion), motion.appearance)


def test_shape_and_colour_come_back_to_their_stated_errors(moving_run, packed):
    values = unpack(packed.block, packed.layout)[1].astype(np.float64)
    gaussians = moving_run.load_space()
    np.testing.assert_allclose(np.exp(values[:, :3]), gaussians.scales, rtol=4e-3)
    quats = torch.nn.functional.normalize(gaussians.quats, dim=1).numpy()
    np.testing.assert_allclose(values[:, [6, 3, 4, 5]], quats, atol=5e-4)
    sh = values[:, 7 : 7 + 48].reshape(-1, 16, 3)
    np.testing.assert_allclose(sh[:, 0], gaussians.sh[:, 0], rtol=5e-4, atol=1e-6)
    np.testing.assert_allclose(sh[:, 1:], gaussians.sh[:, 1:], atol=SH_STEP / 2 + 1e-6)


def test_motion_and_light_come_back(moving_run, packed):
    values = unpack(packed.block, packed.layout)[1].astype(np.float64)
    motion = moving_run.load_motion()
    fields, layout = motion_fields(motion), packed.layout
    first = 7 + 3 * layout.sh_count
    last = first + 6 * layout.n_fields
    held = values[:, first:last].reshape(-1, layout.n_fields, 6).transpose(1, 0, 2)
    np.testing.assert_allclose(held, fields.fields, rtol=5e-4, atol=1e-7)
    light = values[:, last:].reshape(-1, layout.n_lights, layout.light_count, 3).transpose(1, 0, 2, 3)
    light = light * packed.light_sizes[:, None, None, None]
    np.testing.assert_allclose(light, motion.appearance.shapes, rtol=5e-4, atol=1e-8)


def test_more_fields_than_a_page_holds_are_refused(moving_run):
    gaussians = moving_run.load_space()
    shapes = np.zeros((97, len(gaussians), 6), np.float32)
    fields = MotionFields(shapes, np.ones((97, 2)), np.ones((60, 97), complex))
    with pytest.raises(RunError, match="has 97 independent fields; a page holds up to 96"):
        pack(gaussians, fields)


def modal(displacement, rotation):
    freqs = np.arange(1.0, 1 + len(displacement))
    return ModalMotion.of_phasors(
        freqs, displacement.astype(np.complex64), rotation.astype(np.complex64), 30.0, 30
    )


def phasors(found):
    sized = found.fields * found.sizes.repeat(3, axis=1)[:, None]
    return np.tensordot(found.series, sized, axes=1)


def noise(*shape, seed=3):
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def relative_error(found, motion):
    both = phasors(found)
    pairs = (both[..., :3], motion.displacement), (both[..., 3:], motion.rotation)
    return [float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in pairs]


@pytest.mark.parametrize("n", [50, 10_000])
def test_phasors_come_back(n):
    motion = modal(1e-3 * noise(2, n, 3), 5 * noise(2, n, 3, seed=4))
    found = motion_fields(motion)
    assert found.fields.shape == (4, n, 6)
    assert max(relative_error(found, motion)) < 1e-5
    assert max(relative_error(found, modal(1.01 * motion.displacement, motion.rotation))) > 5e-3


def test_a_weak_field_is_kept_and_a_negligible_one_left_out():
    strong, weak = noise(1, 40, 3), noise(1, 40, 3, seed=4)
    assert len(motion_fields(modal(np.concatenate([strong, 1e-3 * weak]), np.zeros((2, 40, 3)))).fields) == 4
    assert len(motion_fields(modal(np.concatenate([strong, 1e-5 * weak]), np.zeros((2, 40, 3)))).fields) == 2


def scene_of(text):
    return json.loads(re.search(r'<script type="application/json" id="scene">(.*?)</script>', text).group(1))


def test_the_command_writes_the_page_and_prints_its_name(moving_run, tmp_path, capsys):
    target = tmp_path / "deep" / "mic.html"
    assert main(["export", str(moving_run.path), "--format", "html", "--out", str(target)]) == 0
    assert capsys.readouterr().out == f"{target}\n"
    text = target.read_text(encoding="utf-8")
    scene = scene_of(text)
    assert scene["layout"]["n_gaussians"] == len(moving_run.load_space())
    assert scene["motion"]["freqs_hz"] == [3.0, 6.0]
    assert sorted(round(p["hz"]) for p in scene["motion"]["peaks"]) == [3, 6]
    assert scene["camera"]["width"] == 96
    assert [path.name for path in target.parent.iterdir()] == ["mic.html"]


def test_the_page_lets_only_its_own_program_run(page_file):
    text = page_file.read_text(encoding="utf-8")
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1)
    program = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert len(program) == 1
    digest = base64.b64encode(hashlib.sha256(program[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}' 'wasm-unsafe-eval';" in policy
    assert "http" not in policy
    assert "default-src 'none'" in policy


def test_words_of_the_dataset_cannot_become_markup(moving_run):
    page = make_page(moving_run)
    bad = "</script><script>alert(1)</script><b>"
    text = render(replace(page, scene={**page.scene, "title": bad}))
    assert scene_of(text)["title"] == bad
    assert "<b>" not in text.replace(text[text.index("<script>") :], "")
    assert text.count("<script") == render(page).count("<script")


def test_an_offset_of_0_hz_is_not_magnified(moving_run, tmp_path):
    motion = replace(moving_run.load_motion(), freqs_hz=np.array([0.0, 6.0]))
    run = made_run(tmp_path / "run", moving_run.dataset, moving_run.load_space(), motion)
    assert make_page(run).scene["motion"]["magnified"] == [False, True]


def test_the_page_opens_with_a_camera_that_stays_put(tmp_path):
    """A picture of a sweep, from close by, would show more motion, but nothing was recorded from there."""
    run = moving_run_of(tmp_path, n_views=3, n_timesteps=6, size=16)
    for t in range(1, 6):
        file = run.dataset / f"{t:03d}" / "transforms_train.json"
        edit(file, lambda values: values.update(frames=values["frames"][:1]))
    assert make_page(run).scene["camera"]["name"] == "r_000"


def test_bad_outs_are_refused_and_nothing_is_written(moving_run, tmp_path):
    with pytest.raises(Tg4mmError, match=r"is a folder; expected a file such as .*scene\.html"):
        export_html(moving_run, tmp_path)
    with pytest.raises(Tg4mmError, match=r"a\.ply: expected a name that ends in \.html"):
        export_html(moving_run, tmp_path / "a.ply")
    assert not list(tmp_path.iterdir())


# The program: built from what lies beside it, with the licences of what is in it.


def stale(player):
    """Files that are not those of which the bundle says that it was made, and the bundle if it is another."""
    made = json.loads((player / "dist" / "sources.json").read_text())
    there = {f"src/{path.name}" for path in (player / "src").iterdir()}
    digests = {name: hashlib.sha256((player / name).read_bytes()).hexdigest() for name in made}
    changed = {name for name, digest in made.items() if digests[name] != digest}
    return sorted(changed | (there ^ {name for name in made if name.startswith("src/")}))


def test_the_program_is_built_from_its_sources(repo_root):
    found = stale(repo_root / "tg4mm" / "show" / "web" / "player")
    assert not found, "changed since the last build: make player"


def test_a_page_within_a_size_loses_what_is_not_seen_then_colours_then_what_counts_least(moving_run):
    gaussians = moving_run.load_space()
    n = len(gaussians)
    fields, weights = motion_fields(moving_run.load_motion()), np.arange(n) / 4.0
    whole = pack(gaussians, fields)
    assert packed_within(gaussians, fields, None, weights, 10**9).layout == whole.layout
    size = len(whole.block)
    seen = packed_within(gaussians, fields, None, weights, size - 1)
    assert (seen.layout.n_gaussians, seen.layout.sh_count) == (n - 2, 16)  # weights 0 and .25 are not seen
    coarse = packed_within(gaussians, fields, None, weights, int(0.6 * size))
    assert (coarse.layout.n_gaussians, coarse.layout.sh_count) == (n - 2, 4)
    few = packed_within(gaussians, fields, None, weights, int(0.2 * size))
    assert len(few.block) <= 0.2 * size
    assert few.layout.sh_count == 4
    exact, _ = unpack(few.block, few.layout)
    assert np.array_equal(exact[:, :3], gaussians.means.numpy()[-few.layout.n_gaussians :])  # the heaviest
