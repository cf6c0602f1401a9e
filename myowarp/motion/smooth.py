"""Noise and derivatives of recordings: a low-pass filter without delay, and splines.

A Butterworth filter of third order runs forwards and backwards over times in equal steps, as OpenSim's
`Storage::lowpassIIR`; the first rows of each way stay as they are. Before, half of the recording is put at
each end, turned about its first and last value as OpenSim's `Storage::pad` does. Splines are natural ones of
fifth degree, as OpenSim's `GCVSpline` without an error variance.

Sources: Winter, *Biomechanics and Motor Control of Human Movement* (2009), section 3.4.4; Woltring (1986),
doi:10.1016/0141-1195(86)90098-7.
"""

from __future__ import annotations

from typing import Any

import numpy as np

ORDER = 3
"""Of the filter, in each direction."""

UNEVEN = 1e-9
"""[s] between the mean and the shortest time step up to which steps count as equal."""

LEAST = 6
"""Frames that a spline of fifth degree needs."""

LOWEST = 1e-4
"""Of half of the rate, frequencies of the filter: below, float64 does not hold its coefficients."""

MOST = 2**19
"""Even steps, at the shortest one, that uneven ones are filled up to."""


def spline(time: np.ndarray, values: np.ndarray) -> Any:
    """Return the natural spline of fifth degree through rows; called with times and an order of derivative.

    Raises:
        ValueError: There are fewer than six rows.
    """
    from scipy.interpolate import make_interp_spline

    if len(time) < LEAST:
        raise ValueError(f"a spline of fifth degree needs at least {LEAST} frames, got {len(time)}")
    nothing = [(order, np.zeros(values.shape[1:])) for order in (3, 4)]
    return make_interp_spline(time, values, k=5, bc_type=(nothing, nothing))


def padded(values: np.ndarray, count: int) -> np.ndarray:
    """Return rows with `count` more at each end, turned about the first and the last row."""
    before = 2 * values[0] - values[count:0:-1]
    after = 2 * values[-1] - values[-2 : -count - 2 : -1]
    return np.concatenate([before, values, after])


def check_cutoff(cutoff: float, rate: float) -> None:
    """Check the frequency of a filter [Hz] against the rate of a recording [Hz].

    Raises:
        ValueError: The filter cannot have it.
    """
    if not LOWEST * rate / 2 <= cutoff < rate / 2:
        raise ValueError(
            f"the filter's frequency must be at least {LOWEST * rate / 2:g} and below {rate / 2:g} Hz, half "
            f"of the rate, got {cutoff:g}"
        )


def lowpass(time: np.ndarray, values: np.ndarray, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what is left below a frequency, at equal steps, with half of the recording more at each end.

    Args:
        time: [s], shape (rows,).
        values: Shape (rows, columns).
        cutoff: [Hz].

    Raises:
        ValueError: There are too few rows, steps differ too much, or the frequency is not below half of the
            rate.
    """
    from scipy import signal

    if len(time) < LEAST:
        raise ValueError(f"the filter needs at least {LEAST} frames, got {len(time)}")
    longer, rows = padded(time, len(time) // 2), padded(values, len(time) // 2)
    steps = np.diff(longer)
    if steps.mean() - steps.min() > UNEVEN:
        if longer[-1] - longer[0] > MOST * steps.min():
            near = int(np.diff(time).argmin())
            raise ValueError(
                f"the filter needs steps that are nearly equal: the frames at {time[near]:.9g} and "
                f"{time[near + 1]:.9g} s are {steps.min():g} s apart, others {steps.mean():g} s; leave one "
                "out"
            )
        even = longer[0] + steps.min() * np.arange(1 + int((longer[-1] - longer[0]) / steps.min() + 1e-9))
        longer, rows = even, spline(longer, rows)(even)
    rate = (len(longer) - 1) / (longer[-1] - longer[0])
    check_cutoff(cutoff, rate)
    b, a = signal.butter(ORDER, cutoff, fs=rate)

    def passed(x: np.ndarray) -> np.ndarray:
        """Return what the filter lets pass, from the first rows on, which stay."""
        begin = np.stack([signal.lfiltic(b, a, *[column[ORDER - 1 :: -1]] * 2) for column in x.T], axis=1)
        return np.concatenate([x[:ORDER], signal.lfilter(b, a, x[ORDER:], axis=0, zi=begin)[0]])

    return longer, passed(passed(rows)[::-1])[::-1]


def derivatives(
    time: np.ndarray, values: np.ndarray, at: np.ndarray, cutoff: float | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return values, rates and second derivatives of the spline through a recording.

    Args:
        time: [s], increasing, shape (rows,).
        values: Shape (rows, columns).
        at: Times [s] within those, shape (frames,).
        cutoff: Frequency below which the filter leaves what is there [Hz]; None: no filter.

    Returns:
        Three arrays of shape (frames, columns).

    Raises:
        ValueError: There are too few rows, or the frequency is not below half of the rate.
    """
    curve = spline(*((time, values) if cutoff is None else lowpass(time, values, cutoff)))
    return curve(at), curve(at, 1), curve(at, 2)
