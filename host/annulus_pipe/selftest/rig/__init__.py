"""A controller tested by a second Pico: what it promises, seen at its pins to 10 ns.

`board` is what a promise is tried on; `lamps`, `microwave`, `motion`, `variants` and `line` are the promises, functions
of a board; `on_rig` is the board at the other end of the jumpers (`wire` the rig's line, `recording` what its words
mean), and tests/emulator has another. `wiring` finds jumpers that are missing or wrong, `run` asks everything.
"""
