"""Electromyograms of a known envelope and delay."""

from pathlib import Path

import numpy as np
import pytest

from myowarp.apps.cli.motion.emg import Emg
from myowarp.apps.cli.motion.said import of_emg
from myowarp.motion.emg import Comparison, agreement, envelopes
from myowarp.motion.storage import Storage, read_storage, write_storage

OSIM = Path(__file__).parents[1] / "data/osim"
LEG, ARM = (OSIM / f"{name}.osim" for name in ("leg6dof9musc", "arm26"))
TIME = np.arange(0.0, 4.0, 1e-3)


def bursts(time, phase):
    """Return activity that rises and falls once a second."""
    return 0.5 - 0.5 * np.cos(2.0 * np.pi * (time - phase))


def recording():
    """Return raw signals: noise under an envelope, and a drift."""
    random = np.random.default_rng(0)
    raw = [bursts(TIME, phase) * random.normal(size=len(TIME)) for phase in (0.0, 0.3)]
    drift = 5.0 * np.sin(2.0 * np.pi * 0.5 * TIME)
    return Storage(("soleus_r", "tib_ant_r", "vas_int_r"), TIME, np.stack([*raw, drift], axis=1) + 2.0)


def activations(delay):
    time = np.arange(0.5, 3.5, 1 / 60)
    columns = [bursts(time - delay, 0.0), bursts(time - delay, 0.8), np.full(len(time), 0.01)]
    return Storage(("soleus_r", "tib_ant_r", "vas_int_r"), time, np.stack(columns, axis=1))


def test_envelopes():
    """The envelope is found again; an offset and a slow drift are no activity."""
    found = envelopes(recording())
    assert found.values.min() >= 0.0
    np.testing.assert_allclose(found.values.max(axis=0), 1.0)
    for column, phase in ((0, 0.0), (1, 0.3)):
        inside = slice(200, -200)
        assert np.corrcoef(found.values[inside, column], bursts(TIME, phase)[inside])[0, 1] > 0.97


@pytest.mark.parametrize("delay", [0.02, 0.09])
def test_delay_and_correlation(delay):
    """The delay is found; a muscle that works at other times comes before, and one at rest first."""
    found = agreement(envelopes(recording()), activations(delay))
    assert [one.muscle for one in found] == ["vas_int_r", "tib_ant_r", "soleus_r"]
    rest, other, same = found
    assert np.isnan(rest.correlation)
    assert other.correlation < 0.0
    assert same.correlation > 0.97
    assert same.delay == pytest.approx(delay, abs=0.015)


def test_the_command(tmp_path, capsys):
    write_storage(tmp_path / "raw.sto", "raw", recording())
    options = {"emg": tmp_path / "raw.sto", "output": tmp_path}
    with pytest.raises(
        ValueError, match=r"has no activations\.sto; write it with myowarp motion forces or track"
    ):
        Emg(LEG, **options)()
    write_storage(tmp_path / "activations.sto", "a", activations(0.05))
    Emg(LEG, **options)()
    with pytest.raises(ValueError, match=r"has the muscle 'soleus_r', which the model '.*' has not"):
        Emg(ARM, **options, overwrite=True)()
    assert read_storage(tmp_path / "emg.sto").values.max() == 1.0
    lines = (tmp_path / "emg_agreement.csv").read_text().splitlines()
    assert lines[0] == "muscle,delay [s],correlation"
    assert lines[-1].startswith("soleus_r,0.0")
    assert (tmp_path / "emg.png").stat().st_size > 10_000
    assert "vas_int_r" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: Storage(s.labels, s.time + 0.01 * (s.time > 2.0), s.values), "needs times in equal steps"),
        (lambda s: Storage(s.labels, s.time[::20], s.values[::20]), "needs a rate of 80 Hz at least, got 50"),
        (lambda s: Storage(s.labels, s.time[:5], s.values[:5]), "too short to filter, got 5 rows"),
    ],
)
def test_bad_recordings(change, message):
    with pytest.raises(ValueError, match=message):
        envelopes(change(recording()))


@pytest.mark.parametrize("later", [2.55, 3.4, 100.0])
def test_clocks_of_their_own_are_refused(later):
    """Two curves that share three frames correlate by 0.9 and more, whatever they are."""
    sought, found = envelopes(recording()), activations(0.05)
    delayed = Storage(found.labels, found.time + later, found.values)
    message = (
        rf"from 0 to 3.999 s, and the activations, from {0.5 + later:.4g} to .* s, must share 0.5 s; give"
    )
    if later > 3.0:
        with pytest.raises(ValueError, match=message):
            agreement(sought, delayed)
        return
    *_, one = agreement(sought, delayed)
    assert np.isfinite(one.correlation)


def test_envelopes_are_no_raw_recordings(caplog):
    raw = recording()
    smooth = np.stack([bursts(TIME, phase) for phase in (0.0, 0.3)], axis=1)
    mixed = Storage(raw.labels[:2], TIME, np.stack([raw.values[:, 0], smooth[:, 1]], axis=1))
    envelopes(mixed)
    (said,) = (record.getMessage() for record in caplog.records)
    assert said.startswith("column 'tib_ant_r' of the electromyogram has ")
    assert said.endswith(" % of its deviation between 20 and 450 Hz: is it an envelope already?")


@pytest.mark.parametrize("level", [0.0, 3.0, -1e6])
def test_a_channel_that_is_off_agrees_with_nothing(level, caplog):
    """What filters make of a constant is rounding; scaled to its greatest value it would look like work."""
    raw = recording()
    raw.values[:, 0] = level
    with caplog.at_level("WARNING", "myowarp"):
        found = envelopes(raw)
    assert not found.values[:, 0].any()
    assert found.values[:, 1].max() == 1.0
    assert "column 'soleus_r' of the electromyogram has no signal" in caplog.messages
    compared = Comparison(found, activations(0.02), agreement(found, activations(0.02)))
    assert {one.muscle for one in compared.found if np.isnan(one.correlation)} == {"soleus_r", "vas_int_r"}
    said = "soleus_r: no correlation, as its electromyogram or its activation does not change"
    assert said in of_emg(compared)


def test_columns_of_no_muscle_are_said(caplog):
    raw = recording()
    raw = Storage(("soleus_r", "soleus_L", "vas_int_r"), raw.time, raw.values)
    with caplog.at_level("WARNING", "myowarp"):
        agreement(envelopes(raw), activations(0.02))
    assert "no muscle has the name of these columns of the electromyogram: soleus_L" in caplog.messages


def test_no_muscle_in_common():
    with pytest.raises(ValueError, match="has no column of a muscle; it has soleus_r"):
        agreement(envelopes(recording()), Storage(("psoas_r",), TIME, np.ones((len(TIME), 1))))
