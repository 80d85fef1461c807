"""The network of the scan flow, and its file."""

import json

import pytest
import torch
from safetensors.torch import load_file, save_file

from navrl.networks import ScanFlow
from navrl.networks.scan_flow import WEIGHTS, load_scan_flow, save_scan_flow


def scans(*batch, num_scans=5, num_bins=180):
    generator = torch.Generator().manual_seed(0)
    ranges = 3.5 * torch.rand(*batch, num_scans + 1, num_bins, generator=generator)
    return ranges, torch.rand(*batch, num_bins, generator=generator) < 0.7


@pytest.fixture
def file(tmp_path):
    torch.manual_seed(0)
    net = ScanFlow(num_scans=2, channels=4, kernel_size=3, dilations=[1, 2])
    save_scan_flow(net, tmp_path / "flow.safetensors", command="train", commit="abc")
    return tmp_path / "flow.safetensors"


def changed(file, weights=(), drop=(), **metadata):
    """Rewrite a file with other weights and metadata."""
    kept = {name: value for name, value in load_file(file).items() if name not in drop}
    own = {"format": "navrl-scan-flow-1", "arguments": arguments()} | metadata
    save_file({**kept, **dict(weights)}, file, own)
    return file


def arguments(**values):
    own = {"num_scans": 2, "channels": 4, "kernel_size": 3, "dilations": [1, 2], "max_range": 3.5}
    own |= {"time_step": 0.2, "num_bins": None}
    return json.dumps({**own, **values})


@pytest.mark.parametrize("batch", [(), (0,), (3,), (2, 3)])
def test_any_batch_shape(batch):
    torch.manual_seed(0)
    net, (ranges, returns) = ScanFlow(), scans(*batch)
    moving, velocity = net(ranges, returns)
    assert moving.shape == (*batch, 180) and velocity.shape == (*batch, 180, 2)
    if batch == (2, 3):
        torch.testing.assert_close(net(ranges[1, 2], returns[1, 2])[1], velocity[1, 2])


def test_outputs_turn_with_the_scan():
    torch.manual_seed(0)
    net, (ranges, returns) = ScanFlow(), scans(2)
    moving, velocity = net(ranges, returns)
    turned = net(ranges.roll(50, -1), returns.roll(50, -1))
    torch.testing.assert_close(turned[0], moving.roll(50, -1))
    torch.testing.assert_close(turned[1], velocity.roll(50, -2))


def test_features_are_scaled_and_clamped():
    net = ScanFlow(num_scans=2, dilations=[1])
    ranges = torch.tensor([0.1, 0.25, 2.0]).unsqueeze(-1).expand(3, 12)
    found = net._features(ranges, torch.ones(12, dtype=torch.bool))[:, 0]
    expected = [1.0, 0.1 / 3.5, 0.25 / 3.5, 2.0 / 3.5, 0.5, 2.0, 2.5]
    torch.testing.assert_close(found, torch.tensor(expected))


@pytest.mark.parametrize(
    "values, message",
    [
        ({"num_scans": 0}, "num_scans=0: must be an integer, at least 1"),
        ({"channels": 2.5}, "channels=2.5: must be an integer"),
        ({"kernel_size": 4}, "kernel_size=4: must be odd"),
        ({"dilations": [1, 0]}, r"dilations\[1\]=0: must be an integer"),
        ({"max_range": -1.0}, "max_range=-1.0: must be positive"),
        ({"channels": 2000}, "channels=2000.*must be at most 10,000,000 parameters"),
    ],
)
def test_bad_arguments_are_named(values, message):
    with pytest.raises(ValueError, match=message):
        ScanFlow(**values)


def test_scans_of_other_shapes_are_an_error():
    ranges, returns = scans(2)
    for wrong in (ranges[:, 1:], ranges[..., 1:], ranges[0]):
        with pytest.raises(ValueError, match=r"\[\*B, 6, N\] and \[\*B, N\] for num_scans=5, got"):
            ScanFlow()(wrong, returns)
    with pytest.raises(ValueError, match="at least 12 bins"):
        ScanFlow()(ranges[..., :11], returns[..., :11])


def test_network_without_residual_layers_is_possible():
    ranges, returns = scans(2)
    assert ScanFlow(dilations=[])(ranges, returns)[0].shape == (2, 180)


def test_file_restores_network_and_notes(tmp_path, file):
    from safetensors import safe_open

    net = load_scan_flow(file)
    assert net.arguments == json.loads(arguments()) and not net.training
    save_scan_flow(net, tmp_path / "again.safetensors", command="train", commit="abc")
    again = load_scan_flow(str(tmp_path / "again.safetensors"))
    ranges, returns = scans(2, num_scans=2)
    assert torch.equal(net(ranges, returns)[1], again(ranges, returns)[1])
    with safe_open(file, framework="pt") as stored:
        assert stored.metadata()["command"] == "train"


def test_packaged_file_has_the_default_arguments():
    net = load_scan_flow()
    assert net.arguments == ScanFlow(num_bins=180).arguments and WEIGHTS.stat().st_size < 300_000


@pytest.mark.parametrize(
    "change, message",
    [
        ({"drop": ["last.bias"]}, r"missing weights \['last.bias'\]"),
        ({"weights": {"more": torch.zeros(1)}}, r"unknown weights \['more'\]"),
        ({"weights": {"last.bias": torch.zeros(4)}}, r"last.bias: must be F32 of shape \[3\]"),
        ({"weights": {"last.bias": torch.zeros(3).double()}}, "last.bias: must be F32.*got F64"),
        ({"weights": {"last.bias": torch.full((3,), torch.nan)}}, "last.bias: value=nan: must be"),
        ({"format": "other"}, "format='other': must be 'navrl-scan-flow-1'"),
        ({"arguments": "{"}, "arguments='{'"),
        ({"arguments": "[1]"}, r"arguments='\[1\]'"),
        ({"arguments": arguments(depth=3)}, "depth"),
        ({"arguments": arguments(channels=10**9)}, "must be at most 10,000,000 parameters"),
        ({"arguments": arguments(num_scans=3)}, r"first.weight: must be F32 of shape \[4, 9, 3\]"),
    ],
)
def test_damaged_file_is_named(change, message, file):
    with pytest.raises(ValueError, match=f"flow.safetensors: .*{message}"):
        load_scan_flow(changed(file, **change))


def test_file_of_another_kind_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none.safetensors: must be a file of save_scan_flow"):
        load_scan_flow(tmp_path / "none.safetensors")
    with pytest.raises(ValueError, match="must be a file of save_scan_flow"):
        load_scan_flow(tmp_path)
    (tmp_path / "text").write_text("no weights")
    with pytest.raises(ValueError, match="text: damaged or no safetensors file"):
        load_scan_flow(tmp_path / "text")
    save_file({"last.bias": torch.zeros(3)}, tmp_path / "plain")
    with pytest.raises(ValueError, match="plain: format=None: must be"):
        load_scan_flow(tmp_path / "plain")


def test_network_that_cannot_be_loaded_is_not_saved(tmp_path):
    net = ScanFlow(num_scans=2, channels=4)
    with pytest.raises(ValueError, match=r"notes=\['format'\]"):
        save_scan_flow(net, tmp_path / "flow", format="mine")
    net.last.bias.data[0] = torch.inf
    with pytest.raises(ValueError, match=r"flow: last\.bias: value=inf: must be finite"):
        save_scan_flow(net, tmp_path / "flow")
    assert not list(tmp_path.iterdir())
