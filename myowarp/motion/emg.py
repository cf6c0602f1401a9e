"""Electromyograms beside activations: envelopes, and how late and how alike they are.

An envelope is the recording between two frequencies, rectified and smoothed, all by a Butterworth filter of
fourth order that runs forwards and backwards, over its greatest value. A muscle follows its excitation by the
electromechanical delay; the delay with the highest correlation is sought within `DELAYS`.

Sources: Hermens et al. (2000), doi:10.1016/S1050-6411(00)00027-4 (SENIAM); Winter, *Biomechanics and Motor
Control of Human Movement* (2009), section 10.3; delays: Cavanagh, Komi (1979), doi:10.1007/BF00431022.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from myowarp.motion.results import Result
from myowarp.motion.storage import Storage, Tables, logger
from myowarp.process import listed

BAND = (20.0, 450.0)
"""Frequencies of a surface electromyogram [Hz]; the upper one is at most 0.45 times the rate."""

SMOOTH = 6.0
"""Of the envelope [Hz]."""

ORDER = 2
"""Of the filter, in each direction."""

DELAYS = (0.0, 0.15)
"""By which an activation may follow its electromyogram [s]."""

SHARED = 0.5
"""Time that both have at least [s]: three periods of the envelope, below which any two are alike."""

FAINT = 0.02
"""Share of a recording's standard deviation in the band below which it is no raw electromyogram."""

SILENT = 1e-9
"""Share of a recording's size below which what it has in the band is rounding: a channel that is off."""

UNEVEN = 0.01
"""Share of the time step by which steps may differ."""


SHOWN = 5
"""Columns that are named."""


@dataclass(frozen=True)
class Agreement:
    """Agreement of an activation with an electromyogram.

    Attributes:
        muscle: Name.
        delay: [s].
        correlation: Pearson's at this delay; NaN where one of both does not change.
    """

    muscle: str
    delay: float
    correlation: float


@dataclass(frozen=True, eq=False)
class Comparison(Result):
    """Electromyograms beside activations.

    Attributes:
        envelope: From `envelopes`.
        activation: Over time.
        found: Their agreement, the least alike first.
    """

    envelope: Storage
    activation: Storage
    found: Sequence[Agreement]

    def put(self, tables: Tables) -> None:
        """Write `emg.sto` and `emg_agreement.csv`."""
        tables.write("emg.sto", "envelopes of electromyograms", self.envelope)
        rows = [(one.muscle, f"{one.delay:.3f}", f"{one.correlation:.4f}") for one in self.found]
        tables.write_rows("emg_agreement.csv", [("muscle", "delay [s]", "correlation"), *rows])


def compare(recording: Storage, activation: Storage) -> Comparison:
    """Compare raw electromyograms with activations.

    Raises:
        As `envelopes` and `agreement`.
    """
    envelope = envelopes(recording)
    return Comparison(envelope, activation, agreement(envelope, activation))


def envelopes(recording: Storage) -> Storage:
    """Return envelopes, each from 0 to 1; 0 where a column has no signal, which is said.

    Args:
        recording: Raw electromyograms over time, in any unit.

    Raises:
        ValueError: Steps are not equal, the rate is too low, or the recording is too short.
    """
    from scipy import signal

    steps = np.diff(recording.time)
    if len(steps) < 2 or np.ptp(steps) > UNEVEN * steps.mean():
        raise ValueError("an electromyogram needs times in equal steps, at least three")
    rate = 1.0 / steps.mean()
    if rate < 4.0 * BAND[0]:
        raise ValueError(
            f"an electromyogram has {BAND[0]:g} to {BAND[1]:g} Hz, and needs a rate of {4 * BAND[0]:g} Hz at "
            f"least, got {rate:g}; columns that are envelopes are activations already"
        )
    band = signal.butter(ORDER, (BAND[0], min(BAND[1], 0.45 * rate)), "bandpass", fs=rate, output="sos")
    low = signal.butter(ORDER, SMOOTH, fs=rate, output="sos")
    try:
        raw = signal.sosfiltfilt(band, recording.values, axis=0)
        smoothed = np.maximum(signal.sosfiltfilt(low, np.abs(raw), axis=0), 0.0)
    except ValueError as error:
        raise ValueError(
            f"the electromyogram is too short to filter, got {len(recording.time)} rows"
        ) from error
    silent = raw.std(axis=0) <= SILENT * np.abs(recording.values).max(axis=0)
    smoothed[:, silent] = 0.0
    for name, off, whole, part in zip(
        recording.labels, silent, recording.values.std(axis=0), raw.std(axis=0), strict=True
    ):
        if off:
            logger.warning("column %r of the electromyogram has no signal", name)
        elif part < FAINT * whole:
            logger.warning(
                "column %r of the electromyogram has %.2g %% of its deviation between %g and %g Hz: is it an "
                "envelope already?",
                *(name, 100.0 * part / whole, *BAND),
            )
    most = smoothed.max(axis=0)
    return Storage(recording.labels, recording.time, smoothed / np.where(most > 0.0, most, 1.0))


def agreement(envelope: Storage, activation: Storage) -> list[Agreement]:
    """Return how activations follow envelopes, for the muscles that both have, the least alike first.

    Args:
        envelope: From `envelopes`.
        activation: Over time.

    Raises:
        ValueError: Both share no muscle, or hardly any time.
    """
    shared = [name for name in envelope.labels if name in activation.labels]
    if not shared:
        raise ValueError(
            f"the electromyogram has no column of a muscle; it has {', '.join(envelope.labels)}, muscles are "
            f"{', '.join(activation.labels)}"
        )
    if unread := [name for name in envelope.labels if name not in shared]:
        logger.warning(
            "no muscle has the name of these columns of the electromyogram: %s", listed(unread, SHOWN)
        )
    spans = [(one.time[0], one.time[-1]) for one in (envelope, activation)]
    begins, ends = zip(*spans, strict=True)
    if min(ends) - max(begins) < SHARED:
        (first, last), (begin, end) = spans
        raise ValueError(
            f"the electromyogram, from {first:.4g} to {last:.4g} s, and the activations, from {begin:.4g} to "
            f"{end:.4g} s, must share {SHARED:g} s; give both the same clock"
        )
    tried = np.arange(DELAYS[0], DELAYS[1] + 1e-9, 1e-3)
    found = []
    for name in shared:
        wanted = envelope.values[:, envelope.labels.index(name)]
        own = activation.values[:, activation.labels.index(name)]
        scores = np.full(len(tried), np.nan)
        for k, delay in enumerate(tried):
            there = activation.time - delay
            inside = (there >= envelope.time[0]) & (there <= envelope.time[-1])
            if not inside.any() or np.ptp(there[inside]) < SHARED:
                continue
            pair = np.interp(there[inside], envelope.time, wanted), own[inside]
            if min(map(np.ptp, pair)) > 0.0:
                scores[k] = np.corrcoef(*pair)[0, 1]
        best = int(np.nanargmax(scores)) if np.isfinite(scores).any() else 0
        found.append(Agreement(name, float(tried[best]), float(scores[best])))
    return sorted(found, key=lambda one: np.nan_to_num(one.correlation, nan=-2.0))
