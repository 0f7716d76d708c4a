"""What is exported is what was trained: splat files read back, numbered files show the magnified motion."""

import numpy as np
import pytest
import torch

from tests.helpers.synthetic import moving_run, with_phasors
from tg4mm.core.magnification import Magnification
from tg4mm.core.splatfile import positions_at, read_splat
from tg4mm.show.export.splat import export_ply, export_ply_sequence
from tg4mm.show.render.sequence import RenderRequest
from tg4mm.show.result.model import mode_deviations


@pytest.fixture
def run(tmp_path):
    return moving_run(tmp_path, n_views=1, n_timesteps=5, size=16, freqs=(3.0, 6.0))


def test_a_splat_file_rests_at_the_motions_own_zero(run, tmp_path):
    """A mode of 0 Hz is where that lies: every viewer then plays and magnifies as `tg4mm render` does."""
    motion = run.load_motion()
    offset = np.full_like(motion.displacement[:1], 0.25)
    displacement = np.concatenate([offset, motion.displacement])
    fields = {"displacement": displacement, "rotation": np.concatenate([0.2 * offset, motion.rotation])}
    run.save_motion(with_phasors(motion, freqs_hz=np.array([0.0, *motion.freqs_hz]), **fields), {})
    splat = read_splat(export_ply(run, tmp_path / "splat.ply"))
    np.testing.assert_array_equal(splat.freqs_hz, [3.0, 6.0])
    np.testing.assert_allclose(splat.means, run.load_space().means + 0.25, atol=1e-6)
    assert np.abs(splat.quats - run.load_space().quats.numpy()).max() > 0.01
    request = RenderRequest(Magnification.of(4.0))
    frames = export_ply_sequence(run, tmp_path / "frames", request, timesteps=[1])
    shown = read_splat(frames / "frame_0001.ply").means
    np.testing.assert_allclose(positions_at(splat, 1, 4.0, None), shown, atol=1e-6)


def test_a_killed_sequence_goes_on(run, tmp_path):
    out = export_ply_sequence(run, tmp_path / "frames", RenderRequest(Magnification.of(4.0)))
    before = {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in out.iterdir()}
    (out / "frame_0002.ply").unlink()
    export_ply_sequence(run, out, RenderRequest(Magnification.of(4.0)))
    after = {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in out.iterdir()}
    assert [name for name in before if before[name] != after[name]] == ["frame_0002.ply"]
    assert before["frame_0002.ply"][0] == after["frame_0002.ply"][0]


def with_uncertainty(run, deviation, noise):
    n = len(run.load_space())
    parts = {"displacement": torch.full((n,), deviation), "noise": torch.full((n,), noise)}
    run.save_part("uncertainty", parts)


def test_modes_of_noise_alone_are_not_written_and_the_others_say_how_sure_they_are(run, tmp_path):
    motion = run.load_motion()
    faint = np.complex64(1e-4) * motion.displacement[:1]
    names = ("displacement", "rotation")
    fields = {name: np.concatenate([getattr(motion, name), faint]) for name in names}
    more = with_phasors(motion, freqs_hz=np.array([3.0, 6.0, 9.0]), **fields)
    run.save_motion(more, {})
    assert read_splat(export_ply(run, tmp_path / "unknown.ply")).freqs_hz.tolist() == [3.0, 6.0]
    with_uncertainty(run, 5e-4, 3e-4)
    splat = read_splat(export_ply(run, tmp_path / "known.ply"))
    assert splat.freqs_hz.tolist() == [3.0, 6.0]
    scale = np.abs(motion.displacement).max()
    np.testing.assert_allclose(splat.displacement, motion.displacement, rtol=0, atol=1e-6 * scale)
    np.testing.assert_allclose(splat.deviation, mode_deviations(more, *sure(run))[:2], rtol=1e-6)
    assert (splat.deviation > np.sqrt(2) * 3e-4 - 1e-9).all()
    assert (splat.deviation < 8e-4).all()
    with_uncertainty(run, 5e-7, 3e-7)  # and what is known well enough is written, however small
    assert read_splat(export_ply(run, tmp_path / "small.ply")).freqs_hz.tolist() == [3.0, 6.0, 9.0]
    assert len(run.load_motion().freqs_hz) == 3


def sure(run):
    return run.load_uncertainty(), run.load_noise()
