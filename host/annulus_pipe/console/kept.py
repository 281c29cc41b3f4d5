"""What the daemon told once and a page may ask for later: the wall's rows, pictures of defects, frames. All bounded."""

from collections import OrderedDict
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.console import wire

ROWS_MAX = {"recent": 2400, "whole": 2048}  # the daemon has 2000 and 2048
ROWS_AT_ONCE = 128  # 92 kB
COLUMNS_MAX = 720
CLOSEUPS_MAX = 16 << 20  # bytes
SEEN_MAX = 16 << 20  # bytes of pictures that saw a defect
BUDGET = 56 << 20  # bytes of both and of the latest pictures, which make room: what is kept is soon all it will ever be
SEEN_EACH = 4  # frames of a defect


class Bounded:
    """Bytes by key; of more than there is room for the oldest go."""

    def __init__(self, limit: int) -> None:
        self.limit, self.size = limit, 0
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()

    def put(self, key: Hashable, value: Any, size: int) -> None:
        self.drop(key)
        self._kept[key] = value, size
        self.size += size
        while self.size > self.limit and self._kept:
            self.size -= self._kept.popitem(last=False)[1][1]

    def drop(self, key: Hashable) -> None:
        if key in self._kept:
            self.size -= self._kept.pop(key)[1]

    def get(self, key: Hashable) -> Any:
        found = self._kept.get(key)
        return None if found is None else found[0]

    def clear(self) -> None:
        self._kept.clear()
        self.size = 0


@dataclass(frozen=True, slots=True)
class WallPart:
    """Rows of the wall, as told."""

    of: str
    scan: int
    first: int
    step_mm: float
    radius_mm: float
    columns: int
    rows: tuple[bytes, ...]

    @classmethod
    def parse(cls, body: Any, part: bytes) -> "WallPart":
        """Raises ValueError."""
        content = untrusted.mapping(body, "wall")
        of = content.get("of")
        if not isinstance(of, str) or of not in wire.WALLS:
            raise ValueError(f"wall: of is {untrusted.shown(of)}, expected recent or whole")
        columns = untrusted.whole(content.get("columns"), "wall: columns", 1, COLUMNS_MAX)
        count = untrusted.whole(content.get("rows"), "wall: rows", 0, 4096)
        if len(part) != 2 * columns * count:
            raise ValueError(f"wall: {len(part)} bytes, expected {2 * columns * count}")
        return cls(
            of,
            untrusted.whole(content.get("scan"), "wall: scan", 0, 2**32 - 1),
            untrusted.whole(content.get("first"), "wall: first", -(2**30), 2**30),
            untrusted.within(content.get("step_mm"), "wall: step_mm", 1e-3, 1e6),
            untrusted.within(content.get("radius_mm"), "wall: radius_mm", 1.0, 1e4),
            columns,
            tuple(part[i : i + 2 * columns] for i in range(0, len(part), 2 * columns)),
        )

    def message(self) -> bytes:
        return wire.wall(self.of, self.first, self.step_mm, self.radius_mm, self.scan, self.columns, self.rows)


class WallRows:
    """One of the two grids, as far as it was told."""

    def __init__(self, of: str) -> None:
        self._of = of
        self._like: WallPart | None = None
        self._rows: OrderedDict[int, bytes] = OrderedDict()

    def put(self, part: WallPart) -> None:
        like = self._like
        if like is None or (like.scan, like.step_mm, like.columns) != (part.scan, part.step_mm, part.columns):
            self._rows.clear()
        self._like = part
        for row, data in enumerate(part.rows, part.first):
            self._rows[row] = data
            self._rows.move_to_end(row)
        while len(self._rows) > ROWS_MAX[self._of]:
            self._rows.popitem(last=False)

    def clear(self) -> None:
        self._like = None
        self._rows.clear()

    def messages(self) -> Iterator[bytes]:
        """All of it, made while it is asked for."""
        waiting = sorted(self._rows)
        while waiting and (like := self._like) is not None:
            first = waiting[0]
            run = 1
            while run < min(len(waiting), ROWS_AT_ONCE) and waiting[run] == first + run:
                run += 1
            rows = [self._rows[row] for row in waiting[:run] if row in self._rows]
            if len(rows) == run:
                yield wire.wall(like.of, first, like.step_mm, like.radius_mm, like.scan, like.columns, rows)
            del waiting[:run]


@dataclass(frozen=True, slots=True)
class CloseUp:
    """A defect from close by. Lengths in mm, None where nothing was seen."""

    numbers: Mapping[str, Any]
    lines: Mapping[str, bytes]  # float32: as lists they would take eight times the room
    picture: bytes  # PNG

    @property
    def size(self) -> int:
        """Bytes, about."""
        return len(self.picture) + sum(map(len, self.lines.values())) + 1000

    def for_page(self) -> dict[str, Any]:
        """For a page; not a number where nothing was seen."""
        lines = {name: np.frombuffer(data, "<f4").tolist() for name, data in self.lines.items()}
        return {**self.numbers, **{name: [round(value, 3) for value in line] for name, line in lines.items()}}

    @classmethod
    def parse(cls, body: Any, part: bytes) -> "CloseUp":
        """Raises ValueError."""
        content = untrusted.mapping(body, "closeup")
        numbers: dict[str, Any] = {
            "scan": untrusted.whole(content.get("scan"), "closeup: scan", 0, 2**32 - 1),
            "id": untrusted.whole(content.get("id"), "closeup: id", 0, 2**32 - 1),
        }
        lines = {}
        for name in ("section_mm", "along_mm"):
            data = content.get(name, b"")
            if not isinstance(data, bytes) or len(data) % 4 or len(data) > 4 * 4096:
                raise ValueError(f"closeup: {name} must be at most 4096 float32")
            lines[name] = data
        for name in ("along_from_mm", "along_step_mm", "nominal_mm"):
            value = content.get(name)
            numbers[name] = None if value is None else untrusted.number(value, f"closeup: {name}", 1e9)
        return cls(numbers, lines, part)


class Frames:
    """Pictures of half size: the latest, and those that saw a defect. They share their room with `closeups`."""

    def __init__(self, closeups: Bounded) -> None:
        self._recent, self._seen, self._closeups = Bounded(BUDGET), Bounded(SEEN_MAX), closeups

    def put(self, camera: int, index: int, jpeg: bytes) -> None:
        self._recent.limit = BUDGET - self._seen.size - self._closeups.size
        self._recent.put((camera, index), jpeg, len(jpeg))

    def keep(self, indices: list[int], cameras: range) -> None:
        """Those that saw a defect; of many a few, spread over them."""
        step = max(1, -(-len(indices) // SEEN_EACH))
        for index in indices[::step]:
            for camera in cameras:
                jpeg = self._recent.get((camera, index))
                if jpeg is not None and self._seen.get((camera, index)) is None:
                    self._seen.put((camera, index), jpeg, len(jpeg))

    def get(self, camera: int, index: int) -> bytes | None:
        found: bytes | None = self._seen.get((camera, index)) or self._recent.get((camera, index))
        return found

    def clear(self) -> None:
        self._recent.clear()
        self._seen.clear()
