"""What a head knows of time and place, shared by all its cameras: edges in host time, odometer, roll, frame numbers."""

from dataclasses import replace

from annulus_pipe.capture.history import EdgeHistory
from annulus_pipe.labelling.evidence import Journal, Write
from annulus_pipe.link.head import EdgeSeen, HeadEvent, LampsCut
from annulus_pipe.link.messages import Fault, FaultCode
from annulus_pipe.link.session import EventReceived
from annulus_pipe.sensors.odometer import MAX_SPEED_MM_S, Odometer
from annulus_pipe.sensors.roll import Roll
from annulus_pipe.sensors.sample import Sample

ROLL = "roll_deg"  # a sensor that gives this value is the head's attitude sensor
INDICES_KEPT = 256  # flashes; cameras are no further apart than that


class Navigation:
    """Sans-I/O: fed with the controller's events and the sensors' samples, asked by the cameras' labels."""

    def __init__(self, mm_per_count: float, max_speed_mm_s: float = MAX_SPEED_MM_S) -> None:
        """`max_speed_mm_s`: the winch's."""
        self.edges = EdgeHistory()
        self.odometer = Odometer(mm_per_count, max_speed_mm_s)
        self.roll = Roll()
        self.journal = Journal()
        self._next_index = 0  # never begins again: what is late is not taken for another scan's
        self._indices: dict[object, tuple[int, set[int]]] = {}  # key -> index, cameras that have it

    def write_down(self, write: Write | None) -> None:
        """From now on everything that labels follow from is written down, beginning with what is known already."""
        self.journal.write_to(write)
        if write is None:
            return
        with self.journal.known():
            self.journal.note("odometer", **self.odometer.remembered())
            for from_ns, to_ns in self.edges.invalid:
                self.journal.note("cut", from_ns=from_ns, to_ns=to_ns, why="before")
            for edge in self.edges.edges:
                self.journal.edge(EdgeSeen(edge.flash, edge.host_ns, 0, edge.boot_epoch))
            self.journal.cameras()

    def remember(self) -> None:
        """Where z stands, and whose frames are labelled: for a reader who lacks some of what was before."""
        with self.journal.known():
            self.journal.note("odometer", again=True, **self.odometer.remembered())
            self.journal.cameras()

    def cut(self, which: int) -> None:
        """Some of what came is missing, for the `which`-th time: edges before are no guide, nor is z. Labellings that
        have these edges have to be made anew.
        """
        self.edges = EdgeHistory(self.edges.preambled)
        self.odometer.cut(which)

    def zero(self) -> None:
        """z is 0 at the next edge."""
        self.journal.note("zero")
        self.odometer.zero()

    def heard(self, event: HeadEvent) -> None:
        """What concerns us among what the controller says."""
        self.journal.heard(event)
        match event:
            case EdgeSeen():
                flash = event.flash
                if flash.epoch != event.boot_epoch:
                    flash = replace(flash, epoch=event.boot_epoch)
                self.edges.edge(flash, event.host_ns, event.boot_epoch)
                self.odometer.edge(flash, event.host_ns, event.nonce)
            case EventReceived(Fault(fault=FaultCode.ODOMETER, detail=counts)):
                self.odometer.lost(counts)
            case LampsCut():
                self.edges.invalidate(event.from_ns, event.to_ns)

    def index(self, camera: int, key: object) -> int:
        """Of a camera's frame: that of other cameras' frames with the same key, else the next one."""
        known = self._indices.get(key)
        if known is not None and camera not in known[1]:
            known[1].add(camera)
            return known[0]
        index = self._next_index
        self._next_index += 1
        if key is not None:
            self._indices[key] = index, {camera}
            if len(self._indices) > INDICES_KEPT:
                del self._indices[next(iter(self._indices))]
        return index

    def sampled(self, sample: Sample) -> None:
        roll_deg = sample.values.get(ROLL)
        if roll_deg is not None and roll_deg == roll_deg and sample.units[ROLL] == "deg":
            self.journal.note("roll", host_ns=sample.host_ns, roll_deg=roll_deg)
            self.roll.add(sample.host_ns, roll_deg)
