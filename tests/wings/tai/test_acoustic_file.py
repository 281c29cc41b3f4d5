"""Acoustic data come back as they were written, strangers' too, and nothing broken passes for data."""

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord, load_acoustic, save_acoustic


def record(positions=12, samples=64, **more):
    signals = np.random.default_rng(1).standard_normal((positions, samples)).astype(np.float32)
    return AcousticRecord(signals, np.arange(positions) * 7.2, 40.0, 25e6, 1e-6, **more)


@pytest.mark.parametrize("name", ["sweep.npz", "sweep.hdf5"])
def test_a_record_survives_the_disk(tmp_path, name):
    written = record(
        sound_speed_m_s=1480.0, code="10010", chip_s=5e-7, averages=256, extra={"sample": "agar", "power_kw": 3.0}
    )
    save_acoustic(tmp_path / name, written)
    read = load_acoustic(tmp_path / name)
    assert np.array_equal(read.signals, written.signals)
    assert np.array_equal(read.angles_deg, written.angles_deg)
    for key in ("radius_mm", "sampling_rate_hz", "t0_s", "sound_speed_m_s", "code", "chip_s", "averages", "extra"):
        assert getattr(read, key) == getattr(written, key), key
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_the_formats_own_tool_finds_nothing_wrong(tmp_path):
    """pacfish checks that what is there is of the right kind and range; complete it cannot be: there is no laser."""
    pacfish = pytest.importorskip("pacfish")
    save_acoustic(tmp_path / "sweep.hdf5", record(sound_speed_m_s=1480.0, chip_s=5e-7))
    data = pacfish.load_data(str(tmp_path / "sweep.hdf5"))
    checker = pacfish.ConsistencyChecker()
    assert checker.check_acquisition_meta_data(data.meta_data_acquisition)
    assert checker.check_device_meta_data(data.meta_data_device)
    assert checker.check_binary_data(data.binary_time_series_data)
    missing = [
        tag.tag
        for tag in pacfish.MetadataAcquisitionTags.TAGS
        if tag.mandatory and data.meta_data_acquisition.get(tag.tag) is None
    ]
    assert missing == []
    assert len(data.get_detector_position()) == 12


def strangers(path, places, values, rate=40e6):
    """An IPASC file as another lab would write it: names that do not sort as they count."""
    with h5py.File(path, "w") as root:
        root["binary_time_series_data"] = values
        root["meta_data/ad_sampling_rate"] = rate
        for i, place in enumerate(places):
            root[f"meta_data_device/detectors/element{i}/detector_position"] = place


def test_a_strangers_arc_is_understood(tmp_path):
    """In metres, about a centre of its own, in the x-z plane, with a wavelength and repeated frames."""
    turn = np.radians(np.linspace(20, 250, 31))
    places = np.stack([0.001 + 0.0405 * np.cos(turn), np.full(31, 0.003), 0.01 + 0.0405 * np.sin(turn)], axis=1)
    values = np.arange(31)[:, None, None, None] + np.zeros((31, 50, 1, 2))
    strangers(tmp_path / "arc.hdf5", places, values)
    read = load_acoustic(tmp_path / "arc.hdf5")
    assert read.radius_mm == pytest.approx(40.5, rel=1e-6)
    assert np.allclose(np.mod(read.angles_deg, 360), np.degrees(turn))
    assert np.array_equal(read.signals[:, 0], np.arange(31))
    assert read.sound_speed_m_s is None


def test_receivers_on_a_line_are_refused(tmp_path):
    strangers(tmp_path / "line.hdf5", np.stack([np.arange(9.0), np.zeros(9), np.zeros(9)], axis=1), np.zeros((9, 50)))
    with pytest.raises(AnnulusError, match="do not stand on a circle"):
        load_acoustic(tmp_path / "line.hdf5")


@pytest.mark.parametrize("name", ["sweep.npz", "sweep.hdf5"])
@settings(deadline=None, max_examples=30)
@given(cut=st.floats(0.01, 0.99))
def test_a_file_cut_short_is_one_line(tmp_path_factory, name, cut):
    path = tmp_path_factory.mktemp("cut") / name
    save_acoustic(path, record())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(cut * len(whole))])
    with pytest.raises(AnnulusError, match=str(path)):
        load_acoustic(path)


def test_senseless_files_are_named(tmp_path):
    def npz(**named):
        path = tmp_path / "x.npz"
        np.savez(path, **named)
        return path

    good = {"signals": np.zeros((4, 32)), "angles_deg": np.arange(4), "radius_mm": 40.0, "sampling_rate_hz": 2e7}
    assert load_acoustic(npz(**good)).t0_s == 0.0
    for change, text in (
        ({"signals": np.zeros(32)}, "expected numbers"),
        ({"angles_deg": np.arange(5)}, "5 angles for 4 traces"),
        ({"radius_mm": np.nan}, "radius_mm"),
        ({"sampling_rate_hz": np.array(["fast"])}, "sampling_rate_hz"),
        ({"signals": np.array([[object()] * 32])}, "cannot be read"),
    ):
        with pytest.raises(AnnulusError, match=text):
            load_acoustic(npz(**(good | change)))
    good.pop("radius_mm")
    with pytest.raises(AnnulusError, match='"radius_mm" is missing'):
        load_acoustic(npz(**good))
    with pytest.raises(AnnulusError, match="no such file"):
        load_acoustic(tmp_path / "none.hdf5")
    with pytest.raises(AnnulusError, match="ending in"):
        save_acoustic(tmp_path / "x.csv", record())
    (tmp_path / "text.hdf5").write_text("no HDF5 at all")
    with pytest.raises(AnnulusError, match="cannot be read"):
        load_acoustic(tmp_path / "text.hdf5")
