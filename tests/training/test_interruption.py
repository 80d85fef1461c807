"""Signals are noted, raised only where that is safe, and handed back afterwards."""

import os
import signal
import subprocess
import sys

import pytest

from navrl.training.interruption import StopRequested, StopSignals, shielded_children

NUMBERS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


@pytest.mark.parametrize("number", NUMBERS)
def test_signal_is_recorded_and_checked(number):
    before = signal.getsignal(number)
    with StopSignals() as signals:
        signals.check()
        os.kill(os.getpid(), number)
        assert signals.arrives() and signals.received is number
        with pytest.raises(StopRequested):
            signals.check()
        with pytest.raises(StopRequested), signals.immediate():
            raise AssertionError("must not begin")
        with signals.immediate(enabled=False):
            pass
    assert signal.getsignal(number) is before


def test_signal_interrupts_an_immediate_block():
    with StopSignals() as signals:
        with pytest.raises(StopRequested), signals.immediate():
            signal.raise_signal(signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGHUP)  # while the checkpoint is written
        assert signals.received is signal.SIGTERM


def test_second_interrupt_ends_at_once():
    with StopSignals():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_ignored_signal_stays_ignored():
    """As ``nohup`` starts a command."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopSignals() as signals:
            os.kill(os.getpid(), signal.SIGHUP)
            assert signals.received is None
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("handler", [signal.SIG_DFL, lambda number, frame: None])
def test_handlers_replaced_by_a_library_are_set_again(handler):
    with StopSignals() as signals:
        signal.signal(signal.SIGTERM, handler)
        signals.install()
        os.kill(os.getpid(), signal.SIGTERM)
        assert signals.received is signal.SIGTERM


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_children_do_not_get_the_terminals_signals(number):
    code = f"import os; os.kill(os.getpid(), {int(number)}); print('alive')"
    with shielded_children():
        child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert child.communicate()[0] == "alive\n"
    assert number not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
