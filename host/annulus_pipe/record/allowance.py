"""What opening a file may unpack of chunks that are nearly nothing: 8 kB of zeros unpack to 256 MB and cost half a
second. What packs less costs what its bytes do, and is not counted."""

NOTHING_TIMES = 64  # a chunk of so many times its bytes is nearly nothing: pictures pack to a tenth
NOTHING_MAX = 1 << 29  # bytes that are unpacked of all such chunks: 1 s


class Allowance:
    """What is left of it."""

    def __init__(self) -> None:
        self._left = NOTHING_MAX

    def of(self, size: int, packed: int) -> int:
        """Bytes that may be unpacked of a chunk of `size` bytes, `packed` in the file."""
        return self._left if size > NOTHING_TIMES * packed else size

    def took(self, size: int, packed: int, unpacked: int) -> None:
        if size > NOTHING_TIMES * packed:
            self._left -= unpacked

    def take(self, size: int, packed: int) -> bool:
        """Whether all of it may be unpacked; it is taken then."""
        if size > self.of(size, packed):
            return False
        self.took(size, packed, size)
        return True
