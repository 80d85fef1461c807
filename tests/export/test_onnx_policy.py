"""Exported policies give the runner's commands without torch."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from nightly import mostly

import navrl
from navrl.config import compose
from navrl.deploy import PolicyRunner
from navrl.export import OnnxFileError, OnnxPolicy
from navrl.export.golden import meters
from navrl.export.onnx_policy import golden_step, run_network
from navrl.jobs.exporting import export
from navrl.policies import ZOO, load_bundle, zoo_names

onnx = pytest.importorskip("onnx", reason="needs the extra onnx")
pytest.importorskip("onnxscript", reason="needs the extra onnx")
pytest.importorskip("onnxruntime", reason="needs the extra onnx")

ROOT = Path(__file__).parents[2]
LOADER = ROOT / "navrl" / "export" / "onnx_policy.py"
POLICIES = mostly(zoo_names(), ["paper"])


@pytest.fixture(scope="module")
def exported(once):
    """Return a function from the name of a policy to its file, exported once per session."""

    def file(name):
        def fill(folder):
            export(compose("export", [f"policy={name}", "num_threads=1"]), folder / "policy.onnx")

        return once(f"onnx_{name}", fill) / "policy.onnx"

    return file


@pytest.fixture(scope="module")
def paper(exported):
    return OnnxPolicy(exported("paper"))


def arguments(policy, step):
    return golden_step(policy.golden(), step)


@pytest.mark.parametrize("name", POLICIES)
def test_commands_equal_the_runner(name, exported):
    policy, runner = OnnxPolicy(exported(name)), PolicyRunner.from_bundle(ZOO / name)
    golden = policy.golden()
    drives = golden["drive"]
    assert len(drives) == 100
    for step in range(100):
        if step == 0 or drives[step] != drives[step - 1]:
            policy.reset()
            runner.reset()
        given = golden_step(golden, step)
        velocity = given.setdefault("velocity", np.zeros(2))
        expected = runner.act(given["ranges"], given["pose"], given["path"], velocity)
        np.testing.assert_allclose(policy.act(**given), expected, rtol=0.0, atol=1e-5)
        assert policy.drive_state == str(runner.state)
    assert np.ptp(golden["command"], axis=0).min() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", zoo_names())
def test_batch_of_64_equals_the_runner(name, exported):
    policy = OnnxPolicy(exported(name), check_steps=0)
    golden = policy.golden()
    starts = np.flatnonzero(np.diff(golden["drive"], prepend=-1))
    ends = np.append(starts[1:], len(golden["drive"]))
    row = np.arange(64) % len(starts)
    delay = np.arange(64) // len(starts) % 3  # rows start at different steps
    state = policy.initial_state(64)
    for time in range(max(ends - starts) + delay.max()):
        step = np.clip(starts[row] + time - delay, starts[row], ends[row] - 1)
        state["state_started"] &= time > delay
        sensors = {name: golden[name][step] for name in golden if name != "path"}
        sensors |= {"ranges": meters(golden["ranges_mm"][step]), "path": golden["path"][row]}
        command, _, state = policy.step(sensors, state)
        is_within = (time >= delay) & (starts[row] + time - delay < ends[row])
        expected = golden["command"][step]
        np.testing.assert_allclose(
            command[is_within], expected[is_within], rtol=0.0, atol=1e-5, err_msg=str(time)
        )


def test_process_imports_numpy_and_onnxruntime_only(exported, tmp_path):
    shutil.copy(LOADER, tmp_path)
    code = (
        "import sys, json, numpy as np\n"
        "from onnx_policy import OnnxPolicy\n"
        f"policy = OnnxPolicy({str(exported('paper'))!r})\n"
        "error = float(policy.golden_errors().max())\n"
        "heavy = ('torch', 'navrl', 'gymnasium', 'tensordict', 'numba', 'onnx')\n"
        "print(json.dumps([error, [name for name in heavy if name in sys.modules]]))\n"
    )
    path = os.pathsep.join(filter(None, sys.path[1:]))
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    error, loaded = json.loads(done.stdout)
    assert error <= 1e-5
    assert loaded == []


@pytest.mark.parametrize(
    "fill", [np.nan, np.inf, 0.0, -1.0, -np.inf, 200.0], ids=lambda value: f"all {value}"
)
def test_unusable_scan_gives_a_stop(fill, paper):
    paper.reset()
    given = arguments(paper, 0)
    command = paper.act(np.full(1440, fill), given["pose"], given["path"])
    assert command.tolist() == [0.0, 0.0]
    assert paper.drive_state == "blind"


def test_stop_does_not_change_the_history(paper):
    paper.reset()
    paper.act(**arguments(paper, 0))
    blind = arguments(paper, 1) | {"ranges": np.full(1440, np.nan)}
    paper.act(**blind)
    command = paper.act(**arguments(paper, 1))
    np.testing.assert_allclose(command, paper.golden()["command"][1], rtol=0.0, atol=1e-5)


def test_robot_at_the_goal_or_off_the_path_stops(paper):
    given = arguments(paper, 0)
    for place, state in ((given["path"][-1], "at_goal"), (given["path"][0] + 9.0, "off_path")):
        paper.reset()
        pose = np.array([*place, 0.0])
        assert paper.act(given["ranges"], pose, given["path"]).tolist() == [0.0, 0.0]
        assert paper.drive_state == state


@pytest.mark.parametrize(
    "change, message",
    [
        ({"ranges": np.ones(10)}, "ranges.shape"),
        ({"pose": [np.nan, 0.0, 0.0]}, "pose"),
        ({"pose": [0.0, 0.0, 90.0]}, "yaw=90"),
        ({"path": np.zeros((201, 2))}, "path.shape"),
        ({"path": np.zeros(2)}, "path.shape"),
        ({"path": np.zeros((2, 3))}, r"path.shape=\(2, 3\)"),
    ],
)
def test_wrong_argument_is_named(change, message, paper):
    with pytest.raises(ValueError, match=message):
        paper.act(**arguments(paper, 0) | change)


@pytest.mark.slow
def test_missing_velocity_is_named(exported):
    policy = OnnxPolicy(exported("navrl-best-predictive"), check_steps=0)
    given = arguments(policy, 0)
    del given["velocity"]
    with pytest.raises(ValueError, match="velocity=None"):
        policy.act(**given)


def test_metadata_describes_the_policy(paper):
    found = paper.metadata
    assert found["policy"] == "paper" and found["kind"] == "policy"
    assert (found["num_beams"], found["max_range_m"], found["time_step_s"]) == (1440, 3.5, 0.2)
    assert found["command_limits"] == [[0.0, pytest.approx(-np.pi)], [1.0, pytest.approx(np.pi)]]


def test_loader_rejects_a_changed_weight(exported, tmp_path):
    model = onnx.load(exported("paper"))
    largest = max(model.graph.initializer, key=lambda value: len(value.raw_data))
    values = onnx.numpy_helper.to_array(largest) * 1.1
    largest.CopyFrom(onnx.numpy_helper.from_array(values, largest.name))
    onnx.save(model, tmp_path / "changed.onnx")
    with pytest.raises(OnnxFileError, match="golden drive"):
        OnnxPolicy(tmp_path / "changed.onnx")


@pytest.mark.parametrize("content", [b"", b"not a model"])
def test_loader_rejects_other_files(content, tmp_path):
    file = tmp_path / "wrong.onnx"
    file.write_bytes(content)
    with pytest.raises(OnnxFileError, match=r"wrong\.onnx: must be an ONNX file"):
        OnnxPolicy(file)


def test_network_only_gives_the_actions_of_the_network(tmp_path):
    file = tmp_path / "network.onnx"
    options = ["policy=paper", "network_only=true", "golden_steps=8", "num_threads=1"]
    assert export(compose("export", options), file) <= 1e-5
    actor = load_bundle(ZOO / "paper").actor
    rng = np.random.default_rng(0)
    shapes = {"spatial": (180, 2), "waypoints_scaled": (5, 2), "temporal": (30, 4)}
    for batch in (1, 64):
        rows = {k: rng.uniform(-1, 1, (batch, *s)).astype(np.float32) for k, s in shapes.items()}
        with torch.no_grad():
            expected = actor.module(*(torch.from_numpy(rows[key]) for key in actor.in_keys))
        np.testing.assert_allclose(run_network(file, rows), expected, rtol=0.0, atol=1e-5)
    with pytest.raises(OnnxFileError, match="network"):
        OnnxPolicy(file)


def test_controller_has_no_onnx_form(tmp_path):
    with pytest.raises(ValueError, match="policy=dwa: must be a bundle"):
        export(compose("export", ["policy=dwa"]), tmp_path / "dwa.onnx")


def headers():
    """Return the folder with ``include`` and ``lib`` of ONNX Runtime's C++ package, if any."""
    roots = [os.environ.get("ONNXRUNTIME", ""), "/usr/local", "/usr", "/opt/onnxruntime"]
    for root in filter(None, roots):
        for folder in ("include", "include/onnxruntime", "include/onnxruntime/core/session"):
            if (Path(root) / folder / "onnxruntime_cxx_api.h").is_file():
                return Path(root), Path(root) / folder
    return None


@pytest.mark.skipif(
    shutil.which("g++") is None or headers() is None, reason="needs g++ and ONNX Runtime for C++"
)
def test_documented_program_drives_from_cpp(exported, tmp_path):
    root, include = headers()
    page = (ROOT / "docs" / "export.md").read_text()
    source = re.search(r'```cpp title="drive.cpp"\n(.*?)```', page, re.S)[1]
    (tmp_path / "drive.cpp").write_text(source)
    program = [str(tmp_path / "drive.cpp"), "-o", str(tmp_path / "drive"), f"-I{include}"]
    program += [f"-L{root / 'lib'}", "-lonnxruntime", f"-Wl,-rpath,{root / 'lib'}"]
    subprocess.run(["g++", "-std=c++17", "-O1", *program], check=True)
    policy = OnnxPolicy(exported("paper"), check_steps=0)
    golden, file = policy.golden(), tmp_path / "drive.bin"
    count = int((golden["drive"] == 0).sum())
    with file.open("wb") as stream:
        for step in range(count):
            given = golden_step(golden, step)
            stream.write(given["ranges"].tobytes() + given["pose"].tobytes())
            stream.write(given["path"].tobytes())
    command = [str(tmp_path / "drive"), str(exported("paper")), str(file)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    commands = [list(map(float, line.split())) for line in printed.splitlines()]
    np.testing.assert_allclose(commands, golden["command"][:count], rtol=0.0, atol=1e-5)


def test_documented_python_program_drives(exported, tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "export.md").read_text()
    source = re.search(r'```python title="drive.py"\n(.*?)```', page, re.S)[1]
    (tmp_path / "drive.py").write_text(source)
    (tmp_path / "paper.onnx").write_bytes(exported("paper").read_bytes())
    module = Path(navrl.__file__).parent / "export" / "onnx_policy.py"
    (tmp_path / "onnx_policy.py").write_text(module.read_text())
    done = subprocess.run(
        [sys.executable, "drive.py"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[1:] == ["1440", "0.2"]
