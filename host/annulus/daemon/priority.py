"""Real-time priority for a thread that must be in time, where the system allows it.

SCHED_FIFO comes before everything that is not real-time, and before nothing of the kernel that frames and bytes need.
Who is started by such a thread is not real-time: recorder and workers must not hold up the loop that feeds them. The
system's own limit (950 ms in each second) keeps a loop gone wild from taking the machine with it.
"""

import os

LEVEL = 10  # of 1..99; a kernel's interrupt threads run at 50


def raise_priority(wanted: bool | None = None) -> str:
    """SCHED_FIFO for the calling thread. `wanted` as head.toml says: False does nothing, None is content when refused.

    Returns a remark for people: what was refused, and what would allow it; empty when there is nothing to say.
    """
    if wanted is False:
        return ""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(LEVEL))
    except OSError as error:
        if wanted is None:
            return ""
        return (
            f"no real-time priority ({error.strerror}): frames may be late when the machine is busy. "
            "Allow it with LimitRTPRIO=20 in the unit, or rtprio in /etc/security/limits.conf."
        )
    return ""
