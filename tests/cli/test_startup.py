"""Commands that simulate nothing import neither torch nor numba nor matplotlib."""

import subprocess
import sys

import pytest

HEAVY = ("torch", "tensordict", "numba", "matplotlib", "skimage", "scipy")
RUN = """
import importlib, sys
module = importlib.import_module(f"navrl.cli.{sys.argv[1]}")
sys.argv = [f"navrl-{sys.argv[1]}", *sys.argv[2:]]
try:
    module.main()
except SystemExit:
    pass
"""
REPORT = f"print('loaded', [name for name in {HEAVY} if name in sys.modules])"
COMMANDS = [
    *(f"{name} --help" for name in ("train", "evaluate", "play", "plot", "compare", "benchmark")),
    *(f"{name} --help" for name in ("publish", "report", "suites")),
    "suites list",
    "suites check tabel1",
    "train --cfg job",
    "train sed=1",
    "train num_worlds=many",
    "evaluate suite=tabel1",
    "evaluate policy=papre",
    "evaluate recordings=some",
    "evaluate policy=paper lidar.num_beams=720",
    "evaluate -m policy=papre,pape",
    "play num_worlds=many",
    "play policy=papre",
    "benchmark rows=[scna]",
    "compare metric=[spl]",
    "plot sourcx=a",
]


def loaded(code, *words, cwd):
    """Return the line that names the heavy modules a process imported."""
    command = [sys.executable, "-c", f"{code}\n{REPORT}", *words]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize("words", COMMANDS)
def test_light_commands_import_no_heavy_package(words, tmp_path):
    assert loaded(RUN, *words.split(), cwd=tmp_path) == "loaded []"


@pytest.mark.parametrize(
    "code",
    [
        "import navrl",
        "import navrl.factory, navrl.jobs, navrl.evaluation, navrl.viz, navrl.worlds",
        "from navrl.policies import zoo_names; assert 'paper' in zoo_names()",
        "import navrl.jobs.sweeps",
    ],
)
def test_light_imports_load_no_heavy_package(code, tmp_path):
    assert loaded(f"import sys\n{code}", cwd=tmp_path) == "loaded []"


@pytest.mark.parametrize("package", ["factory", "jobs", "evaluation", "viz", "worlds", "policies"])
def test_lazy_exports_resolve_and_are_listed(package):
    module = __import__(f"navrl.{package}", fromlist=["__all__"])
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None
        assert name in dir(module)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = module.no_such_name
