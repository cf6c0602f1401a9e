"""The filter and the splines against closed forms."""

import numpy as np
import pytest

from myowarp.motion.smooth import derivatives, lowpass

TIME = np.arange(400) / 100.0
INSIDE = slice(100, 300)


def sine(hertz):
    return np.sin(2 * np.pi * hertz * TIME)[:, None]


@pytest.mark.parametrize("hertz", [1.0, 6.0, 15.0])
def test_the_filter_has_its_gain_and_no_delay(hertz):
    """Twice through an order of three: gain 1 / (1 + (tan(pi f T) / tan(pi f_c T))^6), phase 0."""
    time, values = lowpass(TIME, sine(hertz), 6.0)
    ratio = np.tan(np.pi * hertz / 100.0) / np.tan(np.pi * 6.0 / 100.0)
    clean = values[200:600][INSIDE]
    np.testing.assert_allclose(time[200:600], TIME, atol=1e-12)
    np.testing.assert_allclose(clean, sine(hertz)[INSIDE] / (1.0 + ratio**6), atol=2e-4)


def test_splines_have_the_derivatives_of_a_sine():
    """Also where times are uneven."""
    random = np.random.default_rng(1)
    time = TIME + 0.003 * random.uniform(-1, 1, TIME.shape)
    at = TIME[INSIDE]
    value, rate, second = derivatives(time, np.sin(3.0 * time)[:, None], at)
    np.testing.assert_allclose(value[:, 0], np.sin(3 * at), atol=1e-9)
    np.testing.assert_allclose(rate[:, 0], 3 * np.cos(3 * at), atol=1e-6)
    np.testing.assert_allclose(second[:, 0], -9 * np.sin(3 * at), atol=1e-4)


def test_the_filter_makes_uneven_times_even():
    time = TIME.copy()
    time[1::2] += 2e-3
    value, _, _ = derivatives(time, np.sin(2 * np.pi * time)[:, None], TIME[INSIDE], 6.0)
    np.testing.assert_allclose(value[:, 0], np.sin(2 * np.pi * TIME[INSIDE]), atol=2e-4)


def test_what_cannot_be_filtered():
    with pytest.raises(ValueError, match="needs at least 6 frames, got 5"):
        lowpass(TIME[:5], sine(1.0)[:5], 6.0)
    with pytest.raises(ValueError, match="needs at least 6 frames, got 3"):
        derivatives(TIME[:3], sine(1.0)[:3], TIME[:1])
    with pytest.raises(ValueError, match=r"must be at least 0.005 and below 50 Hz, half of the rate, got 60"):
        lowpass(TIME, sine(1.0), 60.0)


@pytest.mark.parametrize("apart", [1e-6, 1e-7])
def test_two_frames_that_nearly_coincide(apart):
    """Steps at the shortest one would be millions."""
    time = np.sort(np.append(np.arange(60) / 60.0, 29 / 60.0 + apart))
    with pytest.raises(
        ValueError, match=r"nearly equal: the frames at 0\.483333333 and 0\.48333.* s are 1e-0[67] s"
    ):
        lowpass(time, np.sin(time)[:, None], 6.0)


def test_frequencies_that_float64_does_not_hold():
    for cutoff in (0.0, -1.0, np.nan, np.inf, 1e-300, 1e-3):
        with pytest.raises(
            ValueError, match=f"at least 0.005 and below 50 Hz, half of the rate, got {cutoff:g}"
        ):
            lowpass(TIME, sine(1.0), cutoff)
