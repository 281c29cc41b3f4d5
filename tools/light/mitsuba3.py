"""Mitsuba 3, set up: one thread, colours as red, green and blue, no compiler of its own."""

import os

import drjit
import mitsuba as mi

mi.set_variant("scalar_rgb")  # the llvm variants want another LLVM than Debian's
drjit.set_thread_count(int(os.environ.get("OMP_NUM_THREADS", "1")) - 1)  # beside the one that calls
mi.set_log_level(mi.LogLevel.Error)  # a rod at an angle is "sheared" in its last digit

__all__ = ["mi"]
