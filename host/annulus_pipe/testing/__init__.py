"""Heads for tests, other people's too: the real firmware in virtual time, a scripted controller, a line with faults.

`pytest` finds the fixtures of `plugin.py` by itself once annulus is installed. Without pytest:

    with SimulatedHead() as head, Client(head.url) as client: ...      # annulus_pipe.testing.heads
"""
