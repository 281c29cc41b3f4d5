"""Opening a boot loader cleared halts that were none, which may reset the data toggle on one side only (d010992). Fails
when clear_halt is sent without asking for the endpoint's status."""

from boot_rom import Board, Bus

from annulus_pipe.flash.picoboot import PicoBoot, choose, find_boot_loaders


def test_an_endpoint_that_is_not_halted_is_left_alone() -> None:
    cleared = []

    class Watched(Bus):
        def clear_halt(self, board: Board, endpoint: int) -> None:
            cleared.append(endpoint)
            super().clear_halt(board, endpoint)

    with PicoBoot(choose(find_boot_loaders(Watched(Board())))):
        assert cleared == []
