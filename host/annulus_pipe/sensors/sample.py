"""What any sensor of a head says: one moment, named values, their units."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from annulus_pipe import untrusted

VALUES_MAX = 64  # of one sample: bounds what a stranger can make us hold
NAME_MAX = 64  # characters


@dataclass(frozen=True, slots=True)
class Sample:
    """Values that one sensor read at one moment.

    `sensor` names it within the head ("imu", "supply", "odometer"); `host_ns` is on the host's monotonic clock, as
    frames' timestamps are. Every value has its unit ("deg", "V", "A", "counts"); NaN is a value that was not to be had.
    """

    sensor: str
    host_ns: int
    values: Mapping[str, float]
    units: Mapping[str, str]

    def __post_init__(self) -> None:
        if self.values.keys() != self.units.keys():
            raise ValueError(f"sample of {self.sensor}: values {sorted(self.values)} but units {sorted(self.units)}")

    def to_dict(self) -> dict[str, Any]:
        """Plain types, as msgpack and JSON carry them."""
        return {"sensor": self.sensor, "host_ns": self.host_ns, "values": dict(self.values), "units": dict(self.units)}

    @classmethod
    def from_dict(cls, data: object) -> "Sample":
        """Check and convert. Raises ValueError naming the field that is wrong."""
        top = untrusted.mapping(data, "sample")
        values = untrusted.mapping(top.get("values"), "sample: values")
        units = untrusted.mapping(top.get("units"), "sample: units")
        if len(values) > VALUES_MAX:
            raise ValueError(f"sample: {len(values)} values, expected at most {VALUES_MAX}")
        return cls(
            untrusted.text(top.get("sensor"), "sample: sensor", NAME_MAX),
            untrusted.whole(top.get("host_ns"), "sample: host_ns", 0, 2**63 - 1),
            {untrusted.text(k, "sample: name", NAME_MAX): _value(v, k) for k, v in values.items()},
            {k: untrusted.text(v, f"sample: unit of {k}", NAME_MAX) for k, v in units.items()},
        )


class Sensor(Protocol):
    """One sensor behind the daemon's samples. Nothing here waits."""

    name: str

    def poll(self) -> list[Sample]:
        """What was read since the last call, oldest first. Raises AnnulusError when the sensor is gone."""

    def close(self) -> None: ...


def _value(value: object, name: str) -> float:
    return value if isinstance(value, float) and value != value else untrusted.number(value, f"sample: {name}")
