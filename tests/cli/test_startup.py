"""Commands that simulate nothing import neither torch nor numba nor matplotlib."""

import functools
import json
import subprocess
import sys

import pytest
from nightly import mostly

HEAVY = ("torch", "tensordict", "numba", "matplotlib", "skimage", "scipy")
# Reads pieces of code and runs each in a fork of a process that has imported hydra alone; prints
# which heavy packages each of them imported, or that it ended by an error.
FORKING = f"""
import importlib, json, os, sys, traceback
import hydra
assert not any(name.startswith("navrl") for name in sys.modules)

def run(words):
    module = importlib.import_module(f"navrl.cli.{{words[0]}}")
    sys.argv = [f"navrl-{{words[0]}}", *words[1:]]
    try:
        module.main()
    except SystemExit:
        pass

results = {{}}
for code in json.load(sys.stdin):
    reading, writing = os.pipe()
    if os.fork() == 0:
        os.dup2(2, 1)
        try:
            exec(code)
            loaded = [name for name in {HEAVY} if name in sys.modules]
        except BaseException:
            loaded = traceback.format_exc()
        os.write(writing, json.dumps(loaded).encode())
        os._exit(0)
    os.close(writing)
    results[code] = json.load(os.fdopen(reading))
    os.wait()
print(json.dumps(results))
"""
COMMANDS = [
    *(f"{name} --help" for name in ("train", "evaluate", "play", "plot", "compare", "benchmark")),
    *("export --help", "replay --help", "doctor --help"),
    *(f"{name} --help" for name in ("publish", "report", "suites")),
    "suites list",
    "suites check tabel1",
    "train --cfg job",
    "train sed=1",
    "train num_worlds=many",
    "evaluate suite=tabel1",
    "evaluate policy=papre",
    "evaluate suite=places data=absent",
    "evaluate recordings=some",
    "evaluate policy=paper lidar.num_beams=720",
    "evaluate -m policy=papre,pape",
    "play num_worlds=many",
    "play policy=papre",
    "export policy=papre",
    "replay bag=absent",
    "doctor absent policy=papre",
    "benchmark rows=[scna]",
    "compare metric=[spl]",
    "plot sourcx=a",
]


IMPORTS = [
    "import navrl",
    "import navrl.factory, navrl.jobs, navrl.evaluation, navrl.viz, navrl.worlds",
    "from navrl.policies import zoo_names; assert 'paper' in zoo_names()",
    "import navrl.jobs.sweeps",
]


BY_DAY = [*COMMANDS[:3], *COMMANDS[12::3]]


def fork_all(folder, commands):
    """Run commands and all imports; write to a folder what each of them imported."""
    codes = [*(f"run({words.split()})" for words in commands), *IMPORTS]
    command = [sys.executable, "-c", FORKING]
    done = subprocess.run(
        command, cwd=folder, input=json.dumps(codes), capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    (folder / "loaded.json").write_text(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def loaded(once):
    """Return a function from a command or an import to the heavy packages that it imported."""

    def packages(code, is_by_day=True):
        commands = [words for words in COMMANDS if (words in BY_DAY) == is_by_day]
        folder = once(f"startup_{is_by_day}", functools.partial(fork_all, commands=commands))
        return json.loads((folder / "loaded.json").read_text())[code]

    return packages


@pytest.mark.parametrize("words", mostly(COMMANDS, BY_DAY))
def test_light_commands_import_no_heavy_package(words, loaded):
    assert loaded(f"run({words.split()})", words in BY_DAY) == []


@pytest.mark.parametrize("code", IMPORTS)
def test_light_imports_load_no_heavy_package(code, loaded):
    assert loaded(code) == []


@pytest.mark.parametrize("package", ["factory", "jobs", "evaluation", "viz", "worlds", "policies"])
def test_lazy_exports_resolve_and_are_listed(package):
    module = __import__(f"navrl.{package}", fromlist=["__all__"])
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None
        assert name in dir(module)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = module.no_such_name
