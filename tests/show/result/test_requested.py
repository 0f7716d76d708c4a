"""`--band auto`, bands without motion and magnification that goes too far, as a library and as a user meets them."""

import json

import numpy as np
import pytest

from tests.helpers.runs import copied
from tests.helpers.synthetic import with_phasors
from tests.show.result.conftest import NOISE
from tg4mm.cli import main
from tg4mm.core.errors import Tg4mmError
from tg4mm.core.magnification import BandGain, Magnification
from tg4mm.show.result.read import result_of
from tg4mm.show.result.reading import reading_of
from tg4mm.show.result.requested import auto_band, refuse_empty, reversed_motion, too_far


def plan(low, high, alpha=10.0, **more):
    return Magnification((BandGain(low, high, alpha),), **more)


def test_auto_is_the_strongest_and_names_the_others(run):
    band, line = auto_band(run)
    strongest, other = result_of(run).vibrations
    assert band == strongest.band
    said = f"--band auto: {band[0]:g} {band[1]:g} Hz, around {strongest.hz:g} Hz, the strongest"
    assert line.startswith(said)
    assert f"{other.hz:g} Hz" in line.split("also")[1]


def test_render_export_and_evaluate_take_auto(run, tmp_path, capsys):
    band = list(result_of(run).band)
    common = ["--alpha", "3", "--band", "auto"]
    assert main(["render", str(run.path), *common, "--orbit", "1", "--out", str(tmp_path / "o")]) == 0
    assert json.loads((tmp_path / "o" / "render.json").read_text())["band_hz"] == band
    sequence = ["--format", "ply-sequence", "--out", str(tmp_path / "s")]
    assert main(["export", str(run.path), *common, *sequence]) == 0
    assert len(list((tmp_path / "s").glob("*.ply"))) == 30
    out = tmp_path / "m.json"
    assert main(["evaluate", str(run.path), "--alphas", "5", "--band", "auto", "--out", str(out)]) == 0
    assert json.loads(out.read_text())["band_hz"] == band
    assert capsys.readouterr().err.count("--band auto: ") == 3


def test_a_band_without_motion_is_refused_with_those_there_are(run):
    said = r"--band 4 5: no motion was found there; there is .*3 Hz \(--band 2 4\)"
    with pytest.raises(Tg4mmError, match=said):
        refuse_empty(run, plan(4, 5))
    refuse_empty(run, plan(2, 5))
    refuse_empty(run, Magnification(everywhere=10.0))


def test_a_band_with_less_than_half_a_period_in_the_record_is_refused(run, capsys):
    """The record lasts a second."""
    said = r"--band 0\.1 0\.4: the record of 1 s contains less than half a period of it"
    with pytest.raises(Tg4mmError, match=said):
        refuse_empty(run, plan(0.1, 0.4))
    refuse_empty(run, plan(0.5, 3.5))
    assert main(["render", str(run.path), "--alpha", "3", "--band", "0.1", "0.4", "--out", "nowhere"]) == 2
    assert capsys.readouterr().err.count("raise the band to 0.5 Hz or above, or film longer") == 1


def test_a_band_that_a_person_gives_is_magnified_though_one_period_is_no_vibration(run, tmp_path, capsys):
    """All Gaussians go to and fro once, by 0.02 units: nothing is found, and the band's amplitude has a large ±."""
    copy = other_motion(run, tmp_path, 0.02, 1.0)
    assert result_of(copy).vibrations == ()
    (asked,) = result_of(copy, (0.8, 1.2)).vibrations
    assert asked.amplitude.value == pytest.approx(0.02, rel=0.1)
    assert 0.1 < asked.amplitude.deviation / asked.amplitude.value < 0.5
    assert "the record holds 1 periods of it" in asked.doubt
    command = ["render", str(copy.path), "--alpha", "3", "--band", "0.8", "1.2", "--orbit", "1"]
    assert main([*command, "--out", str(tmp_path / "o")]) == 0
    assert "--band 0.8 1.2: " in (said := capsys.readouterr().err)
    assert "a drift as large as the motion" in said


def test_a_band_that_holds_noise_alone_is_empty(run, tmp_path):
    """A mode lies in it, but one that is far below the noise."""
    motion = run.load_motion()
    faint = np.full_like(motion.displacement[:1], 0.01 * NOISE)
    noisy = with_phasors(
        motion,
        freqs_hz=np.array([3.0, 5.0, 7.5]),
        displacement=np.concatenate([motion.displacement[:1], faint, motion.displacement[1:]]),
        rotation=np.concatenate([motion.rotation[:1], 0 * faint, motion.rotation[1:]]),
    )
    copy = copied(run, tmp_path / "run")
    copy.save_motion(noisy, {})
    with pytest.raises(Tg4mmError, match=r"--band 4\.5 5\.5: no motion was found there"):
        refuse_empty(copy, plan(4.5, 5.5))


def test_noise_that_is_magnified_beyond_a_pixel_is_said(run, tmp_path):
    """For a motion that does not bend: all Gaussians move alike, so that only noise limits it."""
    copy = other_motion(run, tmp_path, 0.02)
    noise_px = result_of(copy).noise_px
    alpha = 2 / noise_px - 1  # two pixels
    line = too_far(copy, plan(2, 4, alpha))
    assert "noise is magnified to 2 px" in line
    assert "turn" not in line
    assert too_far(copy, plan(2, 4, 0.9 / noise_px - 1)) is None
    assert f"α = {float(f'{1 / noise_px - 1:.2g}'):g} is the limit" in line


def test_turns_beyond_half_a_radian_are_said(run):
    """The post bends by 2·0.02/1.3 rad at its top: at α = 100 by 3 rad."""
    line = too_far(run, plan(2, 4, 100.0))
    assert "α = 100: the largest motion becomes " in line
    turned = float(line.split("turn or shear by ")[1].split()[0])
    assert turned == pytest.approx(101 * 2 * 0.02 / 1.3, rel=0.3)
    limits = reading_of(run).limits(np.array([101.0, 0.0]))
    assert f"becomes {limits.pixels:.3g} px" in line


def other_motion(run, tmp_path, amplitude, hz=3.0):
    """All Gaussians alike along x."""
    copy, motion = copied(run, tmp_path / "run"), run.load_motion()
    displacement = np.zeros_like(motion.displacement[:1])
    displacement[..., 0] = amplitude
    fields = {"displacement": displacement, "rotation": 0 * displacement}
    copy.save_motion(with_phasors(motion, freqs_hz=np.array([hz]), **fields), {})
    return copy


def test_a_factor_below_minus_one_says_that_motion_is_reversed(run, tmp_path, capsys):
    assert reversed_motion(plan(2, 4, -1.0)) is None
    assert reversed_motion(Magnification()) is None
    assert "α = -5: the motion is shown reversed, 4 times as large" in str(reversed_motion(plan(2, 4, -5.0)))
    options = ["--alpha", "-5", "--band", "2", "4", "--orbit", "1", "--out", str(tmp_path / "o")]
    assert main(["render", str(run.path), *options]) == 0
    assert "reversed" in capsys.readouterr().err
