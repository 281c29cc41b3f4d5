"""Chips on I2C at the level of registers: what is played comes out in its unit; every fault is bounded and counted."""

import errno
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.sensors.fdc2214 import Ads1115, Fdc2214, Tank
from annulus_pipe.sensors.i2c import BACK_OFF_S, TRIES, I2cError, I2cSensors
from annulus_pipe.sensors.imu import Mpu6050
from annulus_pipe.sensors.ina226 import Ina226, Rail
from annulus_pipe.twin.i2c_chips import TwinBus, ads1115, fdc2214, ina226, mpu6050

TANK = Tank()


def head() -> tuple[TwinBus, dict[str, float]]:
    plays = {
        "c1_pf": 4.8,
        "c2_pf": 4.85,
        "c3_pf": 4.57,
        "cref_pf": 4.7,
        "loss1_ff": 20.0,
        "loss2_ff": 0.0,
        "loss3_ff": 30.0,
        "voltage_v": 5.02,
        "current_a": 0.8,
        "x_g": 0.0,
        "y_g": -1.0,
        "z_g": 0.0,
        "temperature_c": 21.0,
    }
    chips = {0x2A: fdc2214(plays, TANK), 0x48: ads1115(plays, TANK), 0x40: ina226(plays, 10.0), 0x68: mpu6050(plays)}
    return TwinBus(chips), plays


def test_sectors_reference_and_loss_come_out_as_they_were_played() -> None:
    bus, plays = head()
    chip = Fdc2214(bus, adc=Ads1115(bus))
    chip.set_up()
    values, units = chip.values()
    for name in ("c1_pf", "c2_pf", "c3_pf", "cref_pf"):
        assert values[name] == pytest.approx(plays[name], abs=2e-6) and units[name] == "pF"  # 28 bits of 33 pF
    for name in ("loss1_ff", "loss2_ff", "loss3_ff"):
        assert values[name] == pytest.approx(plays[name], abs=0.3) and units[name] == "fF"  # 62 uV of 1.5 V
    assert bus.chips[0x2A].held[0x1A] & 0x2000 == 0 and bus.chips[0x2A].held[0x1B] == 0xC20D


@given(st.floats(0.1, 60.0))
def test_a_capacitance_is_told_to_a_count(pf: float) -> None:
    data = TANK.data(pf)
    assert 0 < data < 1 << 28
    one = abs(TANK.capacitance_pf(data + 1) - TANK.capacitance_pf(data))
    assert abs(TANK.capacitance_pf(data) - pf) <= one
    assert 6e6 < 8e7 * TANK.data(4.8) / 2**28 < 7e6  # the source's 6.5 MHz


@given(st.floats(0.0, 200.0), st.floats(1.0, 20.0))
def test_loss_and_amplitude_are_each_others_inverse(loss: float, pf: float) -> None:
    volts = TANK.amplitude_v(loss, pf)
    assert 0 < volts < 1.8 and TANK.loss_ff(volts, pf) == pytest.approx(loss, abs=1e-6)


def test_a_tank_that_stands_still_is_no_number_and_the_others_are() -> None:
    bus, plays = head()
    chip = Fdc2214(bus)
    chip.set_up()
    plays["c2_pf"] = math.nan
    values, _ = chip.values()
    assert math.isnan(values["c2_pf"]) and values["c1_pf"] == pytest.approx(4.8, abs=1e-4)
    assert chip.faults["tank stands still"] == 1


@pytest.mark.parametrize(
    ("volts", "amperes", "lit", "wrong"),
    [
        (5.0, 0.8, None, set()),
        (4.5, 0.8, None, {"undervoltage"}),
        (5.0, 3.5, None, {"overcurrent"}),
        (5.0, -0.2, None, set()),
        (5.0, 0.01, True, {"draws_nothing"}),
        (5.0, 0.01, False, set()),
    ],
)
def test_a_rail_says_what_is_wrong_with_it(volts: float, amperes: float, lit: bool | None, wrong: set[str]) -> None:
    bus, plays = head()
    plays |= {"voltage_v": volts, "current_a": amperes}
    chip = Ina226(bus, rail=Rail(draws_ma=100.0))
    chip.set_up()
    chip.lit = lit
    values, units = chip.values()
    assert values["voltage_v"] == pytest.approx(volts, abs=1e-3) and units["voltage_v"] == "V"
    assert values["current_a"] == pytest.approx(amperes, abs=3e-4) and units["current_a"] == "A"
    assert {name for name in ("undervoltage", "overcurrent", "draws_nothing") if values[name]} == wrong


@pytest.mark.parametrize("roll", [-170.0, -30.0, 0.0, 45.0, 120.0])
def test_roll_is_the_heads_as_a_pose_has_it(roll: float) -> None:
    bus, plays = head()
    plays |= {"x_g": -math.sin(math.radians(roll)), "y_g": -math.cos(math.radians(roll))}
    chip = Mpu6050(bus)
    chip.set_up()
    values, _ = chip.values()
    assert values["roll_deg"] == pytest.approx(roll, abs=0.02) and values["temperature_c"] == pytest.approx(
        21, abs=0.01
    )
    assert values["vibration_m_s2"] == 0
    plays |= {"x_g": 0.01, "y_g": 0.0, "z_g": 1.0}  # on end
    assert math.isnan(chip.values()[0]["roll_deg"])


def test_a_brown_out_is_noticed_counted_and_set_up_anew() -> None:
    bus, _ = head()
    for chip, address in ((Fdc2214(bus), 0x2A), (Ina226(bus), 0x40), (Mpu6050(bus), 0x68)):
        chip.set_up()
        before = dict(bus.chips[address].held)
        bus.chips[address].brown_out()
        chip.values()
        assert chip.faults["brown-out"] == 1
        assert all(bus.chips[address].held.get(k) == v for k, v in before.items())


def test_another_chip_at_the_address_is_named() -> None:
    bus, _ = head()
    bus.chips[0x2A].held[0x7F] = 0x3054
    with pytest.raises(I2cError, match=r"capacitance at 0x2a: register 0x7f is 0x3054, expected 0x3055: another chip"):
        Fdc2214(bus).set_up()
    bus.chips[0x68].held[0x75] = 0x71
    with pytest.raises(I2cError, match="imu at 0x68: register 0x75 is 0x71"):
        Mpu6050(bus).set_up()


def test_a_glitch_is_retried_and_a_stuck_bus_ends_within_a_bound() -> None:
    bus, _ = head()
    chip = Ina226(bus)
    chip.set_up()
    bus.faults = [errno.EREMOTEIO] * (TRIES - 1)
    chip.values()
    assert chip.faults["retried"] == TRIES - 1 and chip.faults["no answer"] == 0
    bus.stuck, before = True, bus.transfers
    with pytest.raises(I2cError, match=r"register 0x00 is not answered \(Connection timed out\), 3 times"):
        chip.values()
    assert bus.transfers - before == TRIES and chip.faults["no answer"] == 1


def test_a_chip_that_is_gone_costs_its_own_samples_and_is_told_once() -> None:
    bus, _ = head()
    supply, imu = Ina226(bus), Mpu6050(bus)
    sensors = I2cSensors("i2c", bus, [supply, imu], 0.1)
    sensors.step(0.0, 1)
    assert [sample.sensor for sample in sensors.poll()] == ["supply", "imu"]
    gone = bus.chips.pop(0x40)
    for k in range(20):  # two seconds
        sensors.step(0.1 * (k + 1), k)
    assert {sample.sensor for sample in sensors.poll()} == {"imu"}
    assert supply.faults["no answer"] == 2  # tried again once a second, no more
    with pytest.raises(I2cError, match="supply at 0x40"):
        sensors.poll()
    assert sensors.poll() == []
    gone.brown_out()
    bus.chips[0x40] = gone
    sensors.step(2.0 + BACK_OFF_S, 50)
    back = sensors.poll()
    assert [sample.sensor for sample in back] == ["supply", "imu"] and back[0].values["faults"] > 0
    for _ in range(300):
        sensors.step(10.0, 60)
    assert sensors.dropped == 2 * 300 - 256
    sensors.close()
    assert bus.closed
