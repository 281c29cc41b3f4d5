"""Promises about Ctrl-C: heard at any moment, obeyed where it is safe."""

import os
import signal

import pytest

from annulus_pipe.daemon.interrupt import Interrupt


def press(number: int = signal.SIGINT) -> None:
    os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_it_is_noted_and_nothing_is_broken_off(number: int) -> None:
    before = signal.getsignal(number)
    with Interrupt() as interrupt:
        press(number)
        press(number)
        assert interrupt.requested
    assert signal.getsignal(number) is before


def test_work_that_may_be_broken_off_is() -> None:
    with Interrupt() as interrupt:
        with pytest.raises(KeyboardInterrupt), interrupt.allowed():
            press()
            pytest.fail("went on")
        press()  # while cleaning up: heard, and nothing else
        assert interrupt.requested


def test_work_that_may_be_broken_off_is_not_begun_after_ctrl_c() -> None:
    with Interrupt() as interrupt:
        press()
        with pytest.raises(KeyboardInterrupt), interrupt.allowed():
            pytest.fail("began")


def test_code_that_llvm_calls_back_is_let_finish_first() -> None:
    """An exception there is swallowed by ctypes, and LLVM goes on with half an object: Ctrl-C while machine code was
    loaded ended in a segmentation fault."""
    done = []

    def _raw_object_cache_getbuffer() -> None:
        signal.raise_signal(signal.SIGINT)
        done.append(True)

    with Interrupt() as interrupt:
        with pytest.raises(KeyboardInterrupt), interrupt.allowed():
            _raw_object_cache_getbuffer()
            signal.sigtimedwait([], 60.0)
        assert done == [True]
