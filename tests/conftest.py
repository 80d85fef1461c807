"""Options and defaults of the whole test suite."""

import copy
import functools
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # tests run side by side; threads would fight

from pathlib import Path
from unittest import mock

import hydra
import pytest
import torch
from filelock import FileLock
from hydra.core.global_hydra import GlobalHydra

from navrl.config import CONF_DIR

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def subnormal_numbers():
    """Undo what a command does for its process, which hypothesis refuses to draw floats in."""
    torch.set_flush_denormal(False)


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Return a function that fills a named folder once per session, whichever worker asks first.

    Its arguments are the name and a function that is called with the empty folder.
    """
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent  # of all workers
    (root / "once").mkdir(exist_ok=True)

    def filled(name, fill) -> Path:
        folder, error = root / "once" / name, root / "once" / f"{name}.error"
        with FileLock(f"{folder}.lock"):
            if not folder.exists():
                folder.mkdir()
                error.write_text("see the first test that failed")
                fill(folder)
                error.unlink()
        if error.exists():
            pytest.fail(f"{name}: {error.read_text()}")
        return folder

    return filled


@pytest.fixture(scope="session", autouse=True)
def composed_once():
    """Compose equal choices of navrl's own configurations once; each caller gets a copy."""
    compose = hydra.compose
    own = functools.lru_cache(maxsize=64)(lambda name, choice: compose(name, list(choice)))

    def composed(config_name=None, overrides=(), **options):
        loader = GlobalHydra.instance().config_loader()
        paths = [element.path for element in loader.get_search_path().get_path()]
        files = [path for path in paths if not path.startswith(("pkg://", "structured://"))]
        if options or {path.removeprefix("file://") for path in files} != {str(CONF_DIR)}:
            return compose(config_name, list(overrides), **options)
        return copy.deepcopy(own(config_name, tuple(overrides)))

    with mock.patch.object(hydra, "compose", composed):
        yield


@pytest.fixture(scope="session", autouse=True)
def compiled_kernels(request, once):
    """Compile kernels once for a whole run, shared out between the workers."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "")
    if not worker or len(request.session.items) < 1000:
        return  # a few tests compile what they need

    def play(policy, folder):
        from navrl import jobs
        from navrl.config import compose

        words = ["suite=smoke", "suite.num_episodes=1", "num_worlds=1", "num_threads=1"]
        words += ["environment.time_limit_steps=2", "progress_bar=false", f"policy={policy}"]
        jobs.run_evaluation(compose("evaluate", words), folder)

    policies = ["paper", "oracle"]  # the longest kernels: ICP, and search in space and time
    for policy in policies if worker[-1] in "02468" else reversed(policies):
        once(f"kernels_{policy}", functools.partial(play, policy))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Give each worker consecutive tests, which share fixtures, and idle workers a part of them."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.getvalue("dist") == "load" else None


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


@pytest.fixture(scope="session")
def lively(tmp_path_factory):
    """A file of a scan flow without training, by which about half of the returns move at 1 m/s."""
    import torch

    from navrl.networks.scan_flow import ScanFlow, save_scan_flow

    torch.manual_seed(0)
    net = ScanFlow()
    net.last.bias.data[0] -= 1.0
    file = tmp_path_factory.mktemp("flow") / "lively.safetensors"
    save_scan_flow(net, file)
    return file
