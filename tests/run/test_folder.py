"""The run folder: files read back as written, a kill costs nothing finished, foreign files are refused."""

import json
import re
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, safe_open, save_file

from tests.helpers.runs import SETTINGS, gaussians, modal, refused
from tests.helpers.synthetic import make_synthetic_dataset
from tg4mm.cli import main
from tg4mm.fit.motion.modes import ModalMotion
from tg4mm.run import Run
from tg4mm.run.tensor_file import model_hash

HOLD = """
import sys, time
from tg4mm.run.folder import work_folder
with work_folder(sys.argv[1]).locked("trains it"):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def run(tmp_path):
    (tmp_path / "data").mkdir()
    return Run.create(tmp_path / "run", tmp_path / "data", "modal", SETTINGS)


class TestResults:
    def test_motion_read_back_equals_that_written(self, run):
        run.save_space(gaussians(), {})
        assert run.load_motion() is None
        run.save_motion(modal(), {})
        back = run.load_motion()
        assert run.has_motion
        for name in ("freqs_hz", "displacement", "rotation"):
            written, read = getattr(modal(), name), getattr(back, name)
            assert read.dtype == written.dtype
            np.testing.assert_array_equal(read, written)
        assert (back.fps, back.n_timesteps) == (30.0, 30)

    def test_many_modes_of_few_fields_take_little_room_and_read_back(self, run):
        """15 modes of 2 fields: as large as 1 mode, and the same to the digits of float32."""
        rng, n = np.random.default_rng(2), 500
        fields = rng.normal(size=(2, n, 6)) * [1e-3, 1e-3, 1e-3, 5, 5, 5]
        series = rng.normal(size=(15, 2)) + 1j * rng.normal(size=(15, 2))
        both = np.tensordot(series, fields, 1).astype(np.complex64)
        motion = ModalMotion.of_phasors(np.arange(1.0, 16), both[..., :3], both[..., 3:], 30.0, 30)
        run.save_space(gaussians(n), {})
        run.save_motion(motion, {})
        back = run.load_motion()
        assert back is not None
        for name in ("displacement", "rotation"):
            written, read = getattr(motion, name), getattr(back, name)
            np.testing.assert_allclose(read, written, atol=1e-6 * np.abs(written).max())
        one = motion.selected(np.arange(15) == 0)
        size = (run.path / "motion.safetensors").stat().st_size
        assert size < 1.2 * (one.displacement.nbytes + one.rotation.nbytes)

    @pytest.mark.parametrize(
        ("fields", "series", "message"),
        [
            ((2, 7, 6), (3, 1), r"fields \(2, 7, 6\) and series \(3, 1\), expected \[R, N, 6\] and \[3, R\]"),
            ((2, 7, 5), (3, 2), r"fields \(2, 7, 5\)"),
            ((7, 6), (3, 7), r"fields \(7, 6\)"),
            ((2, 8, 6), (3, 2), "a motion of 8 Gaussians, expected the 7 in"),
            ((1, 7000, 6), (200_000, 1), "200000 modes of 7000 Gaussians would take 62 GiB"),
        ],
    )
    def test_fields_that_do_not_fit_are_refused(self, run, fields, series, message):
        run.save_space(gaussians(), {})
        tensors = {
            "freqs_hz": torch.arange(series[0], dtype=torch.float64),
            "fields": torch.ones(fields),
            "series": torch.ones(series, dtype=torch.complex128),
        }
        run.save_part("motion", tensors, fps=30.0, n_timesteps=30)
        with refused(message):
            run.load_motion()

    def test_motion_before_space_is_refused(self, run):
        with refused("has no space.safetensors"):
            run.save_motion(modal(), {})

    def test_motion_of_other_gaussians_is_refused(self, run):
        run.save_space(gaussians(7), {})
        with refused("a motion of 8 Gaussians, expected the 7 in"):
            run.save_motion(modal(8), {})
        run.save_motion(modal(7), {})
        run.save_space(gaussians(6), {})
        with refused(r"motion.safetensors: a motion of 7 Gaussians, expected the 6 in"):
            run.load_motion()

    @pytest.mark.parametrize("keep", [0, 4, 100, -1])
    def test_truncated_file_is_refused(self, run, keep):
        run.save_space(gaussians(), {})
        file = run.path / "space.safetensors"
        file.write_bytes(file.read_bytes()[:keep])
        with refused("space.safetensors is truncated or not a safetensors file"):
            run.load_space()

    def test_foreign_safetensors_file_is_refused(self, run):
        save_file({"means": torch.zeros(1, 3)}, run.path / "space.safetensors", metadata={"format": "pt"})
        with refused("was not written by tg4mm: format 'pt'"):
            run.load_space()

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"version": "2"}, "has version 2, expected 1"),
            ({"kind": '"motion"'}, "has kind 'motion', expected 'space'"),
            ({"config": "3"}, "has config 3, expected an object"),
            ({"kind": "{"}, "has a header that is not JSON"),
        ],
    )
    def test_wrong_header_is_refused(self, run, change, message):
        meta = {"format": "tg4mm", "kind": '"space"', "version": "1", "config": "{}"} | change
        save_file({"means": torch.zeros(1, 3)}, run.path / "space.safetensors", metadata=meta)
        with refused(re.escape(message)):
            run.load_space()

    def test_value_that_is_not_finite_is_refused(self, run):
        bad = gaussians()
        bad.scales[3, 1] = float("nan")
        run.save_space(bad, {})
        with refused("space.safetensors: scales holds a value that is not finite"):
            run.load_space()


class TestCreate:
    def test_other_preset_or_dataset_is_refused(self, run, tmp_path):
        with refused('preset = "modal", not "paper"'):
            Run.create(run.path, run.dataset, "paper", SETTINGS)
        with refused(f'dataset = "{tmp_path}/data", not "{str(tmp_path)[:60]}'):
            Run.create(run.path, tmp_path / "other", "modal", SETTINGS)


class TestOpen:
    def test_missing_folder_and_folder_without_config_are_refused(self, tmp_path):
        with refused("nowhere does not exist"):
            Run.open(tmp_path / "nowhere")
        with refused("is not a run folder: it has no config.json"):
            Run.open(tmp_path)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ('{"format": "tg', "is not readable JSON"),
            ("[1]", "holds list, expected an object"),
            ('{"scene": "mic"}', "is not a tg4mm run: format None, kind None"),
            ('{"format": "tg4mm", "kind": "run", "version": 9}', "has version 9; this program reads 1"),
            ('{"format": "tg4mm", "kind": "run", "version": 1, "dataset": 5}', "dataset is 5, expected text"),
        ],
    )
    def test_bad_config_is_refused(self, tmp_path, text, message):
        (tmp_path / "config.json").write_text(text)
        with refused(re.escape(message)):
            Run.open(tmp_path)

    def test_dataset_and_run_may_be_moved_together(self, tmp_path):
        (tmp_path / "here" / "data").mkdir(parents=True)
        Run.create(tmp_path / "here" / "run", tmp_path / "here" / "data", "modal", {})
        (tmp_path / "here").rename(tmp_path / "there")
        assert Run.open(tmp_path / "there" / "run").dataset == tmp_path / "there" / "data"
        Run.create(tmp_path / "there" / "run", tmp_path / "there" / "data", "modal", {})


class TestCheckpoint:
    def test_reads_back_every_kind_of_tensor_and_the_state(self, run):
        base = torch.arange(6.0)
        tensors = {
            "view": base.view(2, 3),
            "same": base,  # shares memory with the view
            "bytes": torch.get_rng_state(),
            "complex": torch.complex(base, -base),
            "empty": torch.zeros(0, 3),
            "strided": base.view(2, 3).T,
            "grad": torch.ones(2, requires_grad=True),
            "scalar": torch.tensor(3, dtype=torch.int64),
        }
        state = {"iteration": 7, "losses": [0.5, 0.25], "nested": {"k": None}}
        run.save_checkpoint("space", tensors, state)
        loaded = run.load_checkpoint("space")
        assert loaded[1] == state
        assert loaded[0].keys() == tensors.keys()
        for name, tensor in tensors.items():
            assert torch.equal(loaded[0][name], tensor.detach()), name
            assert loaded[0][name].dtype == tensor.dtype

    def test_checkpoint_of_other_settings_or_stage_is_refused(self, run, tmp_path):
        other = Run.create(tmp_path / "other", run.dataset, "modal", {**SETTINGS, "seed": 5})
        other.save_checkpoint("space", {}, {})
        run.save_checkpoint("motion", {}, {})
        file = run.path / "checkpoint_space.safetensors"
        for source in (other.path / file.name, run.path / "checkpoint_motion.safetensors"):
            file.write_bytes(source.read_bytes())
            with refused("belongs to a run with other settings, or to another stage"):
                run.load_checkpoint("space")


class TestLog:
    def test_seconds_add_up_memory_keeps_the_most_the_rest_is_replaced(self, run):
        assert run.log() == {}
        run.record("space", {"seconds": 2.0, "peak_memory_mib": 300.0, "psnr": 20.0})
        Run.open(run.path).record("space", {"seconds": 3.5, "peak_memory_mib": 200.0, "psnr": 25.0})
        run.record("motion", {"seconds": 1})
        space = {"seconds": 5.5, "peak_memory_mib": 300.0, "psnr": 25.0}
        assert run.log() == {"space": space, "motion": {"seconds": 1.0}}


@contextmanager
def held(run):
    """Another process that holds the run."""
    words = [sys.executable, "-c", HOLD, str(run)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


def test_a_second_process_gets_one_line_and_exit_code_2(tmp_path, capsys):
    data, run = tmp_path / "data", tmp_path / "run"
    make_synthetic_dataset(data, n_views=2, n_timesteps=1, size=24, alphas=(), n_test=0)
    command = ["train", str(data), "--out", str(run), "--set", "space.iterations=5"]
    with held(run) as other:
        assert main(command) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert f"{run} is in use: another process trains it" in error
        assert [p.name for p in run.iterdir()] == [".lock"]
        other.kill()
        other.wait()
        assert main(command) == 0, capsys.readouterr().err  # what a killed one left blocks nobody
    assert {p.name for p in run.iterdir()} == {"config.json", "log.json", "space.safetensors"}


def written(folder, settings=SETTINGS, scale=1.0, fps=30.0):
    run = Run.create(folder, folder.parent, "modal", settings)
    run.save_space(gaussians(), {"seconds": 1.0})
    motion = modal()
    motion = type(motion).of_phasors(
        motion.freqs_hz, motion.displacement * np.float32(scale), motion.rotation, fps, 30
    )
    run.save_motion(motion, {})
    return run.path


def reordered(file):
    """The same file as another writer may make it: keys of the header in another order."""
    with safe_open(file, framework="pt") as opened:
        meta = opened.metadata()
    data = file.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    turned = dict(reversed(header.items())) | {"__metadata__": dict(sorted(meta.items(), reverse=True))}
    text = json.dumps(turned).encode()
    text += b" " * (-len(text) % 8)
    file.unlink()  # tensors read before are maps of it
    file.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])


def test_equal_models_in_other_folders_with_other_settings_have_one_digest(tmp_path):
    a, b = written(tmp_path / "a"), written(tmp_path / "b", {"seed": 5})
    assert model_hash(a) == model_hash(b)


def test_the_order_of_a_files_header_does_not_matter(tmp_path):
    run = written(tmp_path / "run")
    before, tensors = model_hash(run), load_file(run / "space.safetensors")
    bytes_before = (run / "space.safetensors").read_bytes()
    reordered(run / "space.safetensors")
    assert (run / "space.safetensors").read_bytes() != bytes_before
    assert all(torch.equal(v, tensors[k]) for k, v in load_file(run / "space.safetensors").items())
    assert model_hash(run) == before


def test_another_value_another_frame_rate_and_a_missing_motion_give_other_digests(tmp_path):
    variants = [
        written(tmp_path / "a"),
        written(tmp_path / "b", scale=1.5),
        written(tmp_path / "c", fps=25.0),
    ]
    digests = {model_hash(run) for run in variants}
    (variants[0] / "motion.safetensors").unlink()
    assert len(digests | {model_hash(variants[0])}) == 4
