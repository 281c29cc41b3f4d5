"""How many examples hypothesis draws: few in the gate, where every push pays for them, more where somebody asks.

ANNULUS_EXAMPLES=500 .venv/bin/pytest tests/unit/rings/test_rings_in_c.py
"""

import os

from hypothesis import HealthCheck, settings

few = settings(
    max_examples=int(os.environ.get("ANNULUS_EXAMPLES", "20")),
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
