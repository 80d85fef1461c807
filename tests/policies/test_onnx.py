"""Networks from ONNX files play as controllers."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from navrl.policies import OnnxPolicy
from navrl.policies.controller import missing_packages
from navrl.sim import DifferentialDrive
from navrl.untrusted import DamagedFileError

ROBOT = DifferentialDrive(max_speed=1.0, max_turn_rate=2.0)
WEIGHTS = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.5]], np.float32)


def save(file, batch="N", name="pose", kind=None, outputs=1, size=3):
    """Save a linear network of the pose."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    helper, kinds = onnx.helper, onnx.TensorProto
    weights = onnx.numpy_helper.from_array(WEIGHTS[:size], "weights")
    written = [helper.make_tensor_value_info("action", kinds.FLOAT, [batch, 2])]
    nodes = [helper.make_node("MatMul", [name, "weights"], ["action"])]
    if outputs == 2:
        nodes.append(helper.make_node("Identity", ["action"], ["value"]))
        written.append(helper.make_tensor_value_info("value", kinds.FLOAT, [batch, 2]))
    read = helper.make_tensor_value_info(name, kind or kinds.FLOAT, [batch, size])
    if kind is not None:
        nodes = [helper.make_node("Shape", [name], ["action"])]
        written = [helper.make_tensor_value_info("action", kinds.INT64, [2])]
    graph = helper.make_graph(nodes, "policy", [read], written, [weights])
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), file)
    return file


def observation():
    pose = torch.tensor([[0.5, 0.25, 0.0], [0.5, 1.0, 2.0]], dtype=torch.float64)
    return TensorDict({"pose": pose}, [2])


@pytest.mark.parametrize("batch", ["N", 1])
def test_output_is_the_normalized_action(tmp_path, batch):
    policy = OnnxPolicy(save(tmp_path / "a.onnx", batch), ROBOT)
    assert policy.in_keys == ["pose"] and not policy.privileged
    assert policy(observation())["action"].tolist() == [[0.5, 0.25], [0.5, 1.0]]  # clipped


def test_physical_commands_are_scaled(tmp_path):
    policy = OnnxPolicy(save(tmp_path / "a.onnx"), ROBOT, action="physical")
    assert policy(observation())["action"].tolist() == [[0.0, 0.125], [0.0, 1.0]]


def test_inputs_are_named_by_keys(tmp_path):
    file = save(tmp_path / "a.onnx", name="obs")
    policy = OnnxPolicy(file, ROBOT, inputs={"obs": "pose"})
    assert policy.in_keys == ["pose"]
    assert policy(observation())["action"].shape == (2, 2)
    with pytest.raises(
        ValueError, match=r"input obs: .*here pose\); \+change.controller.inputs.obs"
    ):
        OnnxPolicy(file, ROBOT)(observation())
    with pytest.raises(ValueError, match=r"inputs=\['typo'\]: .* has obs"):
        OnnxPolicy(file, ROBOT, inputs={"typo": "pose"})


def test_observation_of_another_shape_is_rejected(tmp_path):
    policy = OnnxPolicy(save(tmp_path / "a.onnx", size=2), ROBOT)
    with pytest.raises(ValueError, match=r"must have the shape \[2\] per world, pose has \[3\]"):
        policy(observation())


def test_several_outputs_are_rejected(tmp_path):
    with pytest.raises(ValueError, match="outputs action, value: must be one, the action"):
        OnnxPolicy(save(tmp_path / "a.onnx", outputs=2), ROBOT)


def test_input_of_another_type_is_rejected(tmp_path):
    onnx = pytest.importorskip("onnx")
    file = save(tmp_path / "a.onnx", kind=onnx.TensorProto.STRING)
    with pytest.raises(ValueError, match=r"pose: tensor\(string\): must be one of tensor\(float\)"):
        OnnxPolicy(file, ROBOT)


@pytest.mark.parametrize("content", [b"", b"PK not a network", b"\x08\x08" * 100])
def test_damaged_files_are_named(tmp_path, content):
    pytest.importorskip("onnxruntime")
    (tmp_path / "a.onnx").write_bytes(content)
    with pytest.raises(DamagedFileError, match=r"a.onnx: not a usable ONNX network .*; export"):
        OnnxPolicy(tmp_path / "a.onnx", ROBOT)


def test_weights_in_other_files_are_not_read(tmp_path, monkeypatch):
    onnx = pytest.importorskip("onnx")
    file = save(tmp_path / "a.onnx")
    model = onnx.load(file)
    onnx.save(model, file, save_as_external_data=True, location="secret", size_threshold=0)
    assert (tmp_path / "secret").is_file()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DamagedFileError, match="with its weights inside the file"):
        OnnxPolicy(file, ROBOT)


def test_wrong_arguments_are_named(tmp_path):
    with pytest.raises(ValueError, match="action='degrees': must be one of normalized, physical"):
        OnnxPolicy(tmp_path / "a.onnx", ROBOT, action="degrees")


def test_missing_onnxruntime_names_the_extra(tmp_path):
    if not missing_packages(OnnxPolicy):
        pytest.skip("onnxruntime is installed")
    with pytest.raises(ImportError, match=r"\[onnx\]"):
        OnnxPolicy(tmp_path / "a.onnx", ROBOT)
