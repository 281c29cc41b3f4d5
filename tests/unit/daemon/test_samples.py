"""Promises about sensors: a dead one is noticed, counted and said, and nothing waits for it."""

from annulus.daemon.account import Account
from annulus.daemon.observer import Observer
from annulus.daemon.samples import RETRY_NS, SILENT_NS, Samples
from annulus.labelling.navigation import Navigation
from annulus.sensors.sample import Sample
from annulus.vocabulary import AnnulusError

S = 1_000_000_000


class Scripted:
    """A sensor that gives what it was given."""

    def __init__(self, name: str) -> None:
        self.name, self.next, self.malformed, self.polls = name, [], 0, 0

    def poll(self) -> list[Sample]:
        self.polls += 1
        if isinstance(self.next, Exception):
            raise self.next
        given, self.next = self.next, []
        return given

    def close(self) -> None: ...


class Listener(Observer):
    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.told: list[str] = []

    def sample(self, sample: Sample) -> None:
        self.samples.append(sample)

    def event(self, kind: str, text: str) -> None:
        assert kind == "sensor"
        self.told.append(text)


class Rig:
    def __init__(self, *names: str) -> None:
        self.sensors = [Scripted(name) for name in names]
        self.account, self.heard, self.navigation = Account(), Listener(), Navigation(0.05)
        self.samples = Samples(self.sensors, self.navigation, self.account, self.heard)

    def poll(self, now_ns: int, *values: tuple[str, float], sensor: int = 0) -> None:
        if values:
            self.sensors[sensor].next = [Sample(name, now_ns, {"u": value}, {"u": "V"}) for name, value in values]
        self.samples.poll(now_ns)


def test_samples_go_to_who_listens_and_the_last_ones_into_the_telemetry() -> None:
    rig = Rig("ipc://x", "ipc://y")
    rig.poll(0, ("supply", 12.0), ("other", float("nan")))
    rig.poll(1, ("supply", 11.5))
    assert [sample.sensor for sample in rig.heard.samples] == ["supply", "other", "supply"]
    assert rig.samples.numbers() == {"supply": {"u": 11.5}, "other": {"u": None}}
    assert rig.account.samples == {"supply": 2, "other": 1}
    rig.sensors[1].malformed = 3
    rig.poll(2)
    rig.poll(3)
    assert rig.account.drops == {"sensor_malformed": 3}


def test_silence_is_said_and_counted_once_and_so_is_its_end() -> None:
    rig = Rig("ipc://x")
    rig.poll(0, ("imu", 1.0), ("supply", 1.0))
    for tenth in range(1, 41):
        rig.poll(tenth * S // 10, ("supply", 1.0))
    assert rig.heard.told == ["sensor imu is silent"]
    rig.poll(5 * S, ("imu", 1.0), ("supply", 1.0))
    assert rig.heard.told[1:] == ["sensor imu is back"]
    rig.poll(5 * S + SILENT_NS + 1)
    assert sorted(rig.heard.told[2:]) == ["sensor imu is silent", "sensor supply is silent"]
    assert rig.account.drops == {"sensor_silent": 3}


def test_an_address_where_nobody_ever_spoke_is_said_too() -> None:
    rig = Rig("ipc://nobody")
    rig.poll(0)
    rig.poll(SILENT_NS + 1)
    assert rig.heard.told == ["sensor ipc://nobody is silent"]
    rig.poll(3 * S, ("imu", 1.0))
    rig.poll(4 * S, ("imu", 1.0))
    assert rig.heard.told[1:] == ["sensor ipc://nobody is back"]
    rig.poll(4 * S + SILENT_NS + 1)
    assert rig.heard.told[2:] == ["sensor imu is silent"]


def test_a_sensor_that_breaks_costs_only_itself_and_is_looked_at_again() -> None:
    rig = Rig("a", "b")
    for trouble, says in ((AnnulusError("bus gone"), "sensor a broke: bus gone"), (OSError("no"), "OSError: no")):
        rig.sensors[0].next = trouble
        rig.sensors[0].polls = 0
        begun = 10 * S if isinstance(trouble, OSError) else 0
        for step in range(100):
            rig.poll(begun + step * RETRY_NS // 50, ("b", 1.0), sensor=1)
        assert rig.sensors[0].polls == 2 and says in rig.heard.told[0] and len(rig.heard.told) == 1
        rig.sensors[0].next = []
        rig.poll(begun + 5 * RETRY_NS, ("b", 1.0), sensor=1)
        assert rig.heard.told == [rig.heard.told[0], "sensor a can be read again"]
        rig.heard.told.clear()
    assert rig.account.samples == {"b": 202}


def test_whoever_gives_roll_in_degrees_is_the_attitude_sensor() -> None:
    rig = Rig("a")
    rig.sensors[0].next = [
        Sample("imu", 0, {"roll_deg": 3.0, "pitch_deg": 1.0}, {"roll_deg": "deg", "pitch_deg": "deg"}),
        Sample("imu", 1, {"roll_deg": float("nan")}, {"roll_deg": "deg"}),
        Sample("odd", 2, {"roll_deg": 50.0}, {"roll_deg": "rad"}),
    ]
    rig.samples.poll(2)
    assert rig.navigation.roll.at(2) == 3.0
