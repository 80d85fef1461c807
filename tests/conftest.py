"""Options and defaults of the whole test suite."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # tests run side by side; threads would fight

import pytest
import torch

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def subnormal_numbers():
    """Undo what a command does for its process, which hypothesis refuses to draw floats in."""
    torch.set_flush_denormal(False)


def pytest_addoption(parser):
    parser.addoption("--run-slow", action="store_true", help="run the tests marked slow too")


def pytest_collection_modifyitems(config, items):
    skips = {"slow": None if config.getoption("--run-slow") else "needs --run-slow"}
    if not torch.cuda.is_available():
        skips["gpu"] = "needs a CUDA device"
    for item in items:
        for marker, reason in skips.items():
            if reason and marker in item.keywords:
                item.add_marker(pytest.mark.skip(reason=reason))
