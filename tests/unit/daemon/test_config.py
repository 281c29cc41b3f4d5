"""Promises of head.toml: what is wrong is named, in one line, with what was expected."""

import json
from pathlib import Path

import pytest
import zmq

from annulus_pipe.controller import HOST_TIMEOUT_DEFAULT_MS
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.config import (
    HOST_TIMEOUT_LEAST_MS,
    LogConfig,
    RecordConfig,
    SensorConfig,
    SocketConfig,
    load_config,
)
from annulus_pipe.daemon.controller_line import interlock_for, pins_for, stage_of
from annulus_pipe.link.head import PING_NS
from annulus_pipe.link.messages import Interlock, InterlockFlag
from annulus_pipe.link.pins import AS_WIRED, pins_of
from annulus_pipe.qualification.pod import pod_json
from annulus_pipe.vocabulary import AnnulusError
from tests.unit.qualification.known_heads import signed_file
from tests.unit.qualification.test_pod import study

CALIBRATION = {
    "format": "annulus-calibration/1",
    "camera": {"model": "pinhole", "width": 640, "height": 480, "fx": 300.0, "fy": 300.0, "cx": 320.0, "cy": 240.0},
    "pattern": {"colours": "RG"},
    "rings": [{"theta_full_deg": 40.0, "axis": [0, 0, 1], "vertex_mm": [0, 0, -50]}],
    "pipe": {"radius_mm": 76.2},
}

TWO_CAMERAS = {
    **{key: CALIBRATION[key] for key in ("rings", "pipe")},
    "format": "annulus-calibration/2",
    "pattern": {"kind": "slits", "colours": "RG"},
    "cameras": [
        {
            **CALIBRATION["camera"],
            "id": number,
            "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
            "translation_mm": [0, 0, 0],
        }
        for number in (0, 1)
    ],
}


def write(folder: Path, text: str) -> Path:
    path = folder / "head.toml"
    path.write_text(text)
    return path


def test_the_example_in_the_readme_is_valid(tmp_path: Path) -> None:
    readme = Path(__file__).parents[3] / "host/annulus_pipe/daemon/README.md"
    example = readme.read_text().split("```toml\n")[1].split("```")[0]
    secret = zmq.curve_keypair()[1].decode()
    (tmp_path / "publish.key").write_text(secret + "\n")
    (tmp_path / "publish.key").chmod(0o600)
    (tmp_path / "head-7.json").write_text(
        json.dumps({**CALIBRATION, "camera": {**CALIBRATION["camera"], "width": 1664, "height": 1232}})
    )
    signed_file(tmp_path)
    (tmp_path / "pod.json").write_text(pod_json(study()))
    config = load_config(write(tmp_path, example))
    assert config.qualification.certificate is not None and config.qualification.pod is not None
    assert config.port == "/dev/ttyACM0" and config.lamps.ratio == 4 and config.timing.fps == 25
    assert config.record_folder == tmp_path / "scans"
    assert config.publish is not None and config.publish.keys is not None
    assert secret not in json.dumps(config.to_dict())
    assert config.control == SocketConfig("tcp://127.0.0.1:5602") and config.autostart
    assert config.sensors[0] == SensorConfig("remote", "ipc:///run/head/sensors")
    assert [(one.kind, one.name) for one in config.sensors[1:]] == [
        ("fdc2214", "capacitance"),
        ("ina226", "supply"),
        ("mpu6050", "imu"),
    ]
    assert config.cameras == (CameraConfig(colour_gains=(1.9, 1.6)),)
    assert config.record == RecordConfig() and config.realtime is None
    assert config.log == LogConfig(tmp_path / "head.log")


def test_the_interlock_has_one_input_unless_head_toml_says_two(tmp_path: Path) -> None:
    assert not load_config(write(tmp_path, "")).interlock_antivalent
    assert interlock_for(load_config(write(tmp_path, ""))) is None
    config = load_config(write(tmp_path, "[interlock]\nantivalent = true\n"))
    assert interlock_for(config) == Interlock(InterlockFlag.ANTIVALENT)
    with pytest.raises(AnnulusError, match="antivalent is 1, expected true or false"):
        load_config(write(tmp_path, "[interlock]\nantivalent = 1\n"))


def test_the_shortest_host_timeout_leaves_room_for_a_lost_ping() -> None:
    assert HOST_TIMEOUT_LEAST_MS * 1_000_000 >= 2 * PING_NS


def test_the_controller_is_told_how_long_to_wait_for_the_daemon(tmp_path: Path) -> None:
    assert stage_of(load_config(write(tmp_path, ""))).host_timeout == HOST_TIMEOUT_DEFAULT_MS
    assert stage_of(load_config(write(tmp_path, "[lamps]\nhost_timeout_ms = 250"))).host_timeout == 250


def test_an_empty_file_is_a_camera_without_a_controller(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, ""))
    assert config.port is None and config.calibration is None and config.record_folder is None
    json.dumps(config.to_dict())


@pytest.mark.parametrize(
    "text, says",
    [
        ("[camera", "not TOML"),
        ("[camra]", "camra"),
        ("camera = 3", "section"),
        ("[camera]\nfsp = 3", "fsp"),
        ('[camera]\nfps = "fast"', "fps is 'fast'"),
        ("[camera]\nfps = nan", "fps"),
        ("[camera]\nfps = 1000", "1..500"),
        ("[camera]\nwidth = 99.5", "whole"),
        ('[camera]\nkind = "webcam"', "webcam"),
        ("[lamps]\nratio = 16", "0..15"),
        ("[lamps]\nratio = true", "ratio"),
        ("[lamps]\nslides = 5", "slides is 5, expected a number in 1..4"),
        ("[lamps]\nslides = 0", "slides is 0"),
        ("[lamps]\nslides = 3", r"3 slides do not share 4 projector frames a cycle evenly, expected 1, 2, 4"),
        ("[lamps]\nslides = 2\nratio = 0", r"2 slides do not share 0 projector frames a cycle evenly, expected 1"),
        ("[camera]\nslides = 1", "slides is 1, expected a list of at most 4 numbers"),
        ('[camera]\nslides = ["a"]', r"\[camera\] slides"),
        ("[camera]\nslides = [1]", "names 1, expected none where"),
        ("[camera]\nslides = [2]\n[lamps]\nslides = 2", "slides of camera 0 names 2, expected 0 to 1"),
        ("[lamps]\nhost_timeout_ms = 100", "host_timeout_ms is 100, expected a number in 200..5000"),
        ("[lamps]\nhost_timeout_ms = 250.5", "whole"),
        ("[record]\npart_minutes = -1", "part_minutes"),
        ("[record]\npart_minutes = 0.001", "expected 0 or a number in 0.01..100000"),
        ('[record]\npart_gb = "2"', "part_gb is '2'"),
        ("[record]\nsync_s = 1e9", "sync_s"),
        ("[record]\nmin_free_gb = nan", "min_free_gb"),
        ("[record]\nmin_free_minutes = -5", "min_free_minutes is -5"),
        ("[record]\nreserve_mb = true", "reserve_mb"),
        ('[record]\ncodec = "h264"', "codec is 'h264', expected one of raw, zstd, jpeg"),
        ("[record]\nexpect_minutes = -1", "expect_minutes is -1"),
        ("[log]\nmax_mb = 10", r"\[log\] file is missing"),
        ('[log]\nfile = "head.log"\nkeep = 0', "keep is 0"),
        ('[log]\nfile = "head.log"\nmax_mb = 0', "max_mb is 0"),
        ('[daemon]\nrealtime = "yes"', 'expected true, false or "auto"'),
        ("[daemon]\nrealtime = 1", "realtime is 1"),
        ('[controller]\nport = ""', "port"),
        ('[controller]\nport = "x"\n[lamps]\nprojector_delay_us = 100', "leaves the window"),
        ('[controller]\nport = "x"\n[camera]\nexposure_us = 20000', "readout"),
        ('[calibration]\nfile = "none.json"', "none.json"),
        ('[calibration]\nfile = "c.json"', "640x480"),
        ('[publish]\nkey_file = "none.key"', "none.key"),
        ('[publish]\nkey_file = "c.json"', "Z85"),
        ("[workers]\ncount = 0", "1..64"),
        ("[[camera]]\nfps = 25\n[[camera]]\nfps = 10", "one frame-sync"),
        ("[[camera]]\n" * 9, "at most 8"),
        ("[[camera]]\n[[camera]]\ncolour = 1", "colour"),
        ("camera = [3]", "section"),
        ("[[controller]]\n", "section"),
        ('[controller]\nport = "x"\n[[camera]]\n[[camera]]\nreadout_us = 36000', "leaves the window"),
        ('[[sensor]]\nkind = "thermometer"', "thermometer"),
        ("[[sensor]]", "device is missing"),
        ('[[sensor]]\nkind = "ina226"\ndevice = "/dev/spi0"', "no I2C bus"),
        ('[[sensor]]\nkind = "remote"\ndevice = "ipc://@x"\naddress = 3', "address does not go with kind 'remote'"),
        ('[[sensor]]\nkind = "mpu6050"\ndevice = "/dev/i2c-1"\nshunt_mohm = 3.0', "does not go with kind 'mpu6050'"),
        ('[[sensor]]\nkind = "ina226"\ndevice = "/dev/i2c-1"\naddress = 200', "address is 200"),
        ('[[sensor]]\nkind = "ina226"\ndevice = "/dev/i2c-1"\nname = "a b"', "name is 'a b'"),
        ('[[sensor]]\nkind = "ina226"\ndevice = "/dev/i2c-1"\nshunt_mohm = 0.0', "shunt_mohm is 0"),
        (2 * '[[sensor]]\nkind = "ina226"\ndevice = "/dev/i2c-1"\n', "name supply is there twice"),
        ("[control]\nautostart = false", "nobody could start"),
        ("[control]\nautostart = 1", "true or false"),
        ('[calibration]\nfile = "crop.json"', "sensor_crop"),
        ('[calibration]\nfile = "two.json"\n[camera]\nwidth = 640\nheight = 480', "a camera 1"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "c.json").write_text(json.dumps(CALIBRATION))
    (tmp_path / "c.json").chmod(0o600)  # one row takes it for a key
    cropped = {**CALIBRATION, "camera": {**CALIBRATION["camera"], "sensor_crop": [0, -2, 3280, 2464]}}
    (tmp_path / "crop.json").write_text(json.dumps(cropped))
    (tmp_path / "two.json").write_text(json.dumps(TWO_CAMERAS))
    with pytest.raises(AnnulusError, match=says) as caught:
        load_config(write(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="cannot be read"):
        load_config(tmp_path / "head.toml")


def test_two_cameras_of_two_sizes_share_the_window_in_which_all_their_rows_expose(tmp_path: Path) -> None:
    text = """
[[camera]]
device = "/dev/video0"
[[camera]]
kind = "remote"
device = "@other"
width = 640
height = 480
exposure_us = 36000
readout_us = 20000
"""
    config = load_config(write(tmp_path, text))
    assert [(camera.kind, camera.device, camera.width) for camera in config.cameras] == [
        ("v4l2", "/dev/video0", 1664),
        ("remote", "@other", 640),
    ]
    assert (config.timing.fps, config.timing.exposure_us, config.timing.readout_us) == (25.0, 36_000.0, 28_000.0)


def test_colours_of_the_camera_and_of_the_pipe_come_from_the_file(tmp_path: Path) -> None:
    path = tmp_path / "head.toml"
    path.write_text('[camera]\nkind = "picamera2"\ncolour_gains = [1.9, 1.6]\n')
    [camera] = load_config(path).cameras
    assert (camera.format, camera.colour_gains) == ("raw", (1.9, 1.6))
    for wrong in ("1.9", "[1.9]", "[1.9, 0]", '["a", 1.0]', "[1.9, nan]"):
        path.write_text(f'[camera]\nkind = "picamera2"\ncolour_gains = {wrong}\n')
        with pytest.raises(AnnulusError, match=r"\[camera\] colour_gains is"):
            load_config(path)
    path.write_text('[calibration]\ncolour = "paint.json"\n')
    with pytest.raises(AnnulusError, match=r"paint\.json: no such file.*annulus calibrate colour"):
        load_config(path)


def test_a_job_is_read_by_the_names_of_before_too(tmp_path: Path) -> None:
    path = tmp_path / "head.toml"
    path.write_text('[job]\nwho = "J. Doe"\nclient = "The Works"\nsdr = 11\ndate = 2026-11-25\n')
    config = load_config(path)
    told = {"client": "The Works", "sdr": 11.0, "operator": "J. Doe", "date": "2026-11-25"}
    assert config.job.to_dict() == told == config.to_dict()["job"]
    for wrong, match in (
        ('whom = "J. Doe"', r"head.toml: \[job\] whom is not known, expected one of client"),
        ('who = "a"\noperator = "b"', r"\[job\] operator is there twice"),
        ("sdr = 1e9", r"\[job\] sdr is 1000000000.0, expected a number in 3..100"),
        ('date = "25.11.26"', r"\[job\] date is '25.11.26', expected a day"),
        (f'site = "{"x" * 301}"', r"\[job\] site must be a text of at most 300"),
    ):
        path.write_text(f"[job]\n{wrong}\n")
        with pytest.raises(AnnulusError, match=match) as caught:
            load_config(path)
        assert "\n" not in str(caught.value)


def test_the_calibrations_field_of_view_is_asked_of_the_camera(tmp_path: Path) -> None:
    field = [8, 16, 1280, 960]
    cropped = {**CALIBRATION, "camera": {**CALIBRATION["camera"], "sensor_crop": field}}
    (tmp_path / "c.json").write_text(json.dumps(cropped))
    path = tmp_path / "head.toml"
    path.write_text('[calibration]\nfile = "c.json"\n[camera]\nwidth = 640\nheight = 480\n')
    config = load_config(path)
    assert [camera.sensor_crop for camera in config.cameras] == [tuple(field)]
    assert config.calibration is not None
    assert config.calibration.to_dict()["camera"]["sensor_crop"] == field


def test_chips_on_a_bus_are_told_their_own_and_keep_their_usual(tmp_path: Path) -> None:
    text = """
[[sensor]]
kind = "fdc2214"
device = "/dev/i2c-1"
adc_address = 0x48
inductance_uh = 22.0
period_ms = 20
[[sensor]]
kind = "ina226"
device = "/dev/i2c-1"
name = "lamps"
address = 0x41
draws_ma = 50.0
"""
    sectors, lamps = load_config(write(tmp_path, text)).sensors
    assert (sectors.name, sectors.address, sectors.period_ms) == ("capacitance", 0x2A, 20.0)
    assert sectors.settings == {"adc_address": 0x48, "inductance_uh": 22.0}
    assert (lamps.name, lamps.address, lamps.period_ms, lamps.settings) == ("lamps", 0x41, 25.0, {"draws_ma": 50.0})


def test_pins_that_may_be_inverted_are_named_and_those_that_watch_never_are(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, '[controller]\nport = "/dev/null"\ninverted = ["sync", "led"]\n'))
    assert pins_for(config) == pins_of("sync,led") and config.to_dict()["inverted"] == ["sync", "led"]
    for wrong, why in (
        ('["interlock"]', "a broken wire must say unsafe, expected of sync"),
        ('"sync"', "a list of"),
        ('["led", "led"]', "each pin once"),
    ):
        with pytest.raises(AnnulusError, match=why):
            load_config(write(tmp_path, f"[controller]\ninverted = {wrong}\n"))


def test_a_camera_that_takes_a_trigger_gets_one_as_long_as_its_exposure_and_room_for_its_readout(
    tmp_path: Path,
) -> None:
    head = '[controller]\nport = "/dev/null"\n[camera]\ntrigger = "xtrig"\nfps = 25\n'
    lamps = "[lamps]\nprojector_delay_us = 30100\nled_delay_us = 30100\n"
    config = load_config(write(tmp_path, head + "exposure_us = 10014.26\nreadout_us = 14300\n" + lamps))
    assert pins_for(config) == AS_WIRED.triggering("xtrig", 10_000.0)
    assert stage_of(config).exposure == 1_000_000 and stage_of(config).readout == 0
    for wrong, why in (
        ("exposure_us = 30000\nreadout_us = 14300\n", "one after the other do not fit 40000 us"),
        ("exposure_us = 15\nreadout_us = 14300\n", "the camera adds 14.26 us to its trigger"),
        ("exposure_us = 5000\nreadout_us = 14300\n", "leaves the window 35014.3..40000 us"),
    ):
        with pytest.raises(AnnulusError, match=why):
            load_config(write(tmp_path, head + wrong + lamps))
    with pytest.raises(AnnulusError, match="expected one of none, xtrig, pulse"):
        load_config(write(tmp_path, head.replace("xtrig", "yes")))
    outside = head.replace("xtrig", "pulse_on_sync") + "exposure_us = 10000\nreadout_us = 14300\n"
    config = load_config(write(tmp_path, outside + "[lamps]\nprojector_delay_us = 29600\nled_delay_us = 29600\n"))
    assert pins_for(config) == AS_WIRED.triggering("pulse_on_sync", 10_000.0, 29_590.0)  # 1 % and 10 us before 40 ms
    stage = stage_of(config)
    assert (stage.exposure, stage.readout, stage.tolerance) == (1_041_000, 41_000, 10)
    early = outside.replace("= 10000", "= 25500") + lamps
    with pytest.raises(AnnulusError, match="an outside clock that may be 1 % early, do not fit 40000 us"):
        load_config(write(tmp_path, early))
    two = '[[camera]]\ntrigger = "xtrig"\nexposure_us = 10000\nreadout_us = 14300\n[[camera]]\n'
    with pytest.raises(AnnulusError, match="one line for all"):
        load_config(write(tmp_path, two))
