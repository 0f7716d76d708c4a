"""The sensor: its noise has the variance and mean that physics says, is seeded, and leaves alpha alone."""

import numpy as np
import pytest

from dataset_gen.errors import GenerateError
from dataset_gen.pictures import ImageSensor, capture, expose, generator, to_display, to_integers

KEY = (0, "train", 3, 1, 0)
CLEAN = ImageSensor(full_well=1e7, read_noise=0.0, adc_bits=24)  # shot noise of 1/3000: next to nothing


def flat(value, size=128):
    return np.full((size, size, 3), value, np.float32)


@pytest.mark.parametrize("exposure", [1.0, 0.25])
def test_variance_is_affine_in_the_mean_with_the_gain_as_slope(exposure):
    sensor = ImageSensor(full_well=2000.0, read_noise=6.0, exposure=exposure, adc_bits=16)
    white = 2000.0 * exposure
    levels = np.array([0.1, 0.2, 0.4, 0.6, 0.8])
    read = [expose(sensor, flat(x), (0, i)) for i, x in enumerate(levels)]
    means, variances = np.array([(r.mean(), r.var()) for r in read]).T
    np.testing.assert_allclose(means, levels, atol=4 * np.sqrt(levels.max() / white / read[0].size))
    slope, intercept = np.polyfit(means, variances, 1)
    assert slope == pytest.approx(1 / white, rel=0.03)
    assert variances[0] == pytest.approx((0.1 * white + 36.0) / white**2, rel=0.03)
    assert intercept == pytest.approx(36.0 / white**2, abs=0.03 / white)


def test_the_same_key_gives_the_same_bytes_and_every_part_of_it_counts():
    sensor, light = ImageSensor(), flat(0.3, 16)
    first = capture(sensor, light, None, KEY)
    assert capture(sensor, flat(0.3, 16), None, (0, "train", 3, 1, 0)).tobytes() == first.tobytes()
    for i, other in enumerate((1, "test", 4, 2, 5)):
        assert capture(sensor, light, None, (*KEY[:i], other, *KEY[i + 1 :])).tobytes() != first.tobytes()
    assert generator((1, 12)).random() != generator((11, 2)).random()
    assert generator(("1",)).random() != generator((1,)).random()


@pytest.mark.parametrize(("bits", "kind"), [(8, np.uint8), (16, np.uint16)])
def test_without_noise_it_is_the_display_encoding(bits, kind):
    ramp = np.linspace(0, 1, 256, dtype=np.float32)
    light = np.broadcast_to(ramp[:, None, None], (256, 4, 3))
    got = capture(CLEAN, light, None, KEY, bits)
    assert got.dtype == kind
    expected = to_integers(to_display(light.astype(np.float64)), bits).astype(int)
    off = np.abs(got.astype(int) - expected)
    assert off[64:].max() <= (1 if bits == 8 else 120)  # shot noise of one part in 1600 where it is dark
    assert got[0].max() == 0


def test_the_converter_has_as_many_steps_as_it_has_bits():
    light = np.linspace(0, 1, 3 * 10_000, dtype=np.float32).reshape(100, 100, 3)
    sensor = ImageSensor(full_well=1e7, read_noise=0.0, adc_bits=6)
    values = np.unique(expose(sensor, light, KEY))
    assert len(values) == 64
    np.testing.assert_allclose(np.diff(values), 1 / 63)
    shown = np.unique(capture(sensor, light, None, KEY, 16))
    np.testing.assert_array_equal(shown, to_integers(to_display(np.arange(64) / 63), 16))


def test_alpha_gets_no_noise_and_clear_pixels_stay_black():
    alpha = np.linspace(0, 1, 64, dtype=np.float32).reshape(8, 8)
    picture = capture(ImageSensor(full_well=50.0), flat(0.5, 8), alpha, KEY)
    np.testing.assert_array_equal(picture[..., 3], to_integers(alpha, 8))
    assert (picture[0, 0] == 0).all()
    assert len(np.unique(picture[..., 0])) > 5
    np.testing.assert_array_equal(
        picture[1:, :, :3], capture(ImageSensor(full_well=50.0), flat(0.5, 8), None, KEY)[1:]
    )


def test_jpeg_changes_the_picture_a_little_and_repeatably():
    pytest.importorskip("PIL")
    rng = np.random.default_rng(0)
    light = np.repeat(np.repeat(rng.random((8, 8, 3)), 8, 0), 8, 1).astype(np.float32)
    plain = capture(CLEAN, light, None, KEY).astype(int)
    rough = [
        capture(ImageSensor(full_well=1e7, read_noise=0, adc_bits=24, jpeg_quality=q), light, None, KEY)
        for q in (95, 20)
    ]
    errors = [np.abs(r - plain).mean() for r in rough]
    assert 0.1 < errors[0] < errors[1] < 40
    assert rough[0].dtype == np.uint8
    again = capture(ImageSensor(full_well=1e7, read_noise=0, adc_bits=24, jpeg_quality=95), light, None, KEY)
    np.testing.assert_array_equal(again, rough[0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"full_well": 0.0}, "full_well 0.0 is not in"),
        ({"full_well": float("nan")}, "full_well nan"),
        ({"read_noise": -1.0}, "read_noise -1.0"),
        ({"read_noise": 1e6}, "read_noise 1000000.0"),
        ({"exposure": 0.0}, "exposure 0.0"),
        ({"exposure": float("nan")}, "exposure nan"),
        ({"adc_bits": 3}, "adc_bits 3"),
        ({"jpeg_quality": 0}, "jpeg_quality 0"),
    ],
)
def test_unusable_sensors_are_refused(changes, message):
    with pytest.raises(GenerateError, match=message):
        ImageSensor(**changes)
