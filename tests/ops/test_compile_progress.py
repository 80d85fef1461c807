"""Messages on the first compilation of the kernels."""

import re

import pytest

from navrl.ops.kernels import compiler
from navrl.ops.kernels.compile_progress import EXPECTED_S, CompileProgress


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def seconds(message):
    own, whole, kernels = re.search(r"about (\d+) s; at most (\d+) s for (\d+) ", message).groups()
    return int(own), int(whole), int(kernels)


def test_first_message_estimates_all_kernels(tmp_path, clock):
    message = CompileProgress(clock).begin("align_kernel", tmp_path)
    assert message.startswith("compiling align_kernel once") and str(tmp_path) in message
    assert seconds(message) == (10, round(sum(EXPECTED_S.values())), len(EXPECTED_S))


def test_estimate_follows_the_speed_so_far(tmp_path, clock):
    progress = CompileProgress(clock)
    progress.begin("align_kernel", tmp_path)
    clock.now += 3 * EXPECTED_S["align_kernel"]  # a busy machine
    progress.end()
    (tmp_path / "icp.align_kernel-1.nbc").touch()
    own, whole, kernels = seconds(progress.begin("step_worlds_kernel", tmp_path))
    rest = sum(EXPECTED_S.values()) - EXPECTED_S["align_kernel"]
    assert (own, whole) == (round(3 * EXPECTED_S["step_worlds_kernel"]), round(3 * rest))
    assert kernels == len(EXPECTED_S) - 1


def test_unknown_kernel_has_no_estimate(tmp_path, clock):
    progress = CompileProgress(clock)
    message = progress.begin("double", tmp_path)
    assert message == f"compiling double once; cached in {tmp_path}"
    clock.now += 50.0
    progress.end()
    assert seconds(progress.begin("align_kernel", tmp_path))[0] == 10


def test_every_kernel_has_an_estimate():
    folder = compiler.Path(compiler.__file__).parent
    decorated = r"^@kernel\ndef (\w+)"
    names = {n for f in folder.glob("*.py") for n in re.findall(decorated, f.read_text(), re.M)}
    assert names == EXPECTED_S.keys()
