"""Network that estimates the velocity of every return of a scan, and its weights file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from navrl.checks import check_counts, check_positive
from navrl.extras import require
from navrl.files import replacing

WEIGHTS = Path(__file__).parent / "weights" / "scan_flow.safetensors"
"""Trained weights in the package."""

_FORMAT = "navrl-scan-flow-1"
_MAX_PARAMETERS = 10_000_000  # a file may come from others: its arguments allocate the network
_MAX_SHOWN = 200  # characters of a file in a message
_MAX_CHANGE_M = 0.6  # of a range against the present one; a larger one is another object
_CHANGE_SCALE_M = 0.3
_MIN_RANGE_M = 0.2  # of the inverse range, which gives the angular size of a body


class ScanFlow(nn.Module):
    """Estimate the motion of every return from aligned past scans.

    Static obstacles have the same range in all aligned scans, moving ones do not. Convolutions over
    the bearings, around the full circle, detect the difference.

    Args:
        num_scans: Number of past scans K.
        channels: Channels of each hidden layer.
        kernel_size: Bins of each convolution, odd.
        dilations: Spacing of the kernel of each residual layer, in bins.
        max_range: Range scaled to 1, m.
        time_step: Time between two scans of the training, s; the velocity is that of scans so far
            apart.
        num_bins: Number of bins N of the training, the only one accepted; ``None`` for any.

    Raises:
        ValueError: If an argument is out of range, or the network has too many parameters.

    Example:
        >>> net = ScanFlow(num_scans=2)
        >>> ranges, returns = torch.full((4, 3, 180), 3.5), torch.zeros(4, 180, dtype=torch.bool)
        >>> moving, velocity = net(ranges, returns)
        >>> moving.shape, velocity.shape
        (torch.Size([4, 180]), torch.Size([4, 180, 2]))

    Reference:
        Not in the paper. Scene flow of point clouds: Liu et al., "FlowNet3D", 2019. This
        implementation reads ranges by bearing; see :class:`navrl.transforms.RangeHistory`.
    """

    def __init__(
        self,
        num_scans: int = 5,
        channels: int = 32,
        kernel_size: int = 7,
        dilations: Sequence[int] = (1, 2, 4, 1),
        max_range: float = 3.5,
        time_step: float = 0.2,
        num_bins: int | None = None,
    ) -> None:
        """Check the arguments and build the layers."""
        super().__init__()
        check_counts(num_scans=num_scans, channels=channels, kernel_size=kernel_size)
        check_counts(num_bins=num_bins)
        check_positive(max_range=max_range, time_step=time_step)
        for index, dilation in enumerate(dilations):
            check_counts(**{f"dilations[{index}]": dilation})
        if not kernel_size % 2:
            raise ValueError(f"kernel_size={kernel_size}: must be odd")
        num_features = 3 + 2 * num_scans
        size = kernel_size * channels * (num_features + channels * len(dilations))
        if size > _MAX_PARAMETERS:
            raise ValueError(
                f"num_scans={num_scans}, channels={channels}, kernel_size={kernel_size}, "
                f"dilations={[*dilations]}: must be at most {_MAX_PARAMETERS:,} parameters, "
                f"are {size:,}"
            )
        self.num_scans, self.max_range = num_scans, max_range
        self.time_step, self.num_bins = time_step, num_bins
        self.arguments: dict[str, Any] = {
            "num_scans": num_scans,
            "channels": channels,
            "kernel_size": kernel_size,
            "dilations": [*dilations],
            "max_range": max_range,
            "time_step": time_step,
            "num_bins": num_bins,
        }
        self.first = _circular(num_features, channels, kernel_size)
        self.residual = nn.ModuleList(
            _circular(channels, channels, kernel_size, dilation) for dilation in dilations
        )
        self.last = nn.Conv1d(channels, 3, 1)
        self.min_bins = kernel_size // 2 * max([1, *dilations])

    def forward(self, ranges: Tensor, returns: Tensor) -> tuple[Tensor, Tensor]:
        """Return whether each return moves, and its velocity.

        Args:
            ranges: ``[*B, K + 1, N]`` m, scan t first, past scans in the robot frame at t, by
                bearing: the second output of :class:`navrl.transforms.RangeHistory`.
            returns: ``[*B, N]`` bool, the bin has a return at t.

        Returns:
            Logit ``[*B, N]`` of the probability to move, and velocity ``[*B, N, 2]`` m/s, radial
            and counter-clockwise tangential at the bearing of the bin.

        Raises:
            ValueError: If the shapes do not fit.
        """
        self.check_shapes(ranges.shape, returns.shape)
        features = self._features(ranges.to(self.first.weight.dtype), returns)
        hidden = torch.relu(self.first(features.reshape(-1, *features.shape[-2:])))
        for layer in self.residual:
            hidden = hidden + torch.relu(layer(hidden))
        found = self.last(hidden).reshape(*features.shape[:-2], 3, features.shape[-1])
        moving, radial, tangential = found.unbind(-2)
        return moving, torch.stack([radial, tangential], dim=-1)

    def check_shapes(self, ranges: Sequence[int], returns: Sequence[int]) -> None:
        """Check the shapes of the inputs.

        Args:
            ranges: Shape of the ranges, ``[*B, K + 1, N]``.
            returns: Shape of the returns, ``[*B, N]``.

        Raises:
            ValueError: If they are other, or a convolution is wider than the scan.
        """
        scans = self.num_scans + 1
        expected = [scans, *returns[-1:]]  # not the batch, whose size is free in an exported graph
        if len(ranges) != len(returns) + 1 or [*ranges[-2:]] != expected:
            raise ValueError(
                f"ranges, returns: must have shapes [*B, {scans}, N] and [*B, N] for "
                f"num_scans={self.num_scans}, got {tuple(ranges)} and {tuple(returns)}"
            )
        if self.num_bins is not None and returns[-1] != self.num_bins:
            raise ValueError(
                f"ranges: must have {self.num_bins} bins, as in the training of the network, got "
                f"{returns[-1]}: the number is lidar.num_beams / transforms.min_pool.group_size"
            )
        if returns[-1] < self.min_bins:
            raise ValueError(
                f"ranges: must have at least {self.min_bins} bins, the reach of a convolution to "
                f"either side, got {returns[-1]}"
            )

    def _features(self, ranges: Tensor, returns: Tensor) -> Tensor:
        """Return the inputs of the first layer, ``[*B, 3 + 2 K, N]``."""
        now, past = ranges[..., :1, :], ranges[..., 1:, :]
        change = (past - now).clamp(-_MAX_CHANGE_M, _MAX_CHANGE_M)
        parts = [
            returns.unsqueeze(-2).to(ranges.dtype),
            now / self.max_range,
            past / self.max_range,
            change / _CHANGE_SCALE_M,
            0.5 / now.clamp(min=_MIN_RANGE_M),
        ]
        return torch.cat(parts, dim=-2)


def save_scan_flow(net: ScanFlow, path: str | Path, **notes: str) -> None:
    """Write a network to one file that :func:`load_scan_flow` reads.

    Args:
        net: Network, on any device.
        path: File to write, safetensors; an existing one is replaced when the new one is complete.
        **notes: Texts saved with it, e.g. the command of the training.

    Raises:
        OSError: If the file cannot be written.
        ValueError: If a value is not finite, or a note has a reserved name.
    """
    require("full", "save_scan_flow", "safetensors")
    from safetensors.torch import save

    own = {"format": _FORMAT, "arguments": json.dumps(net.arguments)}
    if reserved := sorted(own.keys() & notes.keys()):
        raise ValueError(f"notes={reserved}: must have other names")
    state = {name: value.detach().cpu().contiguous() for name, value in net.state_dict().items()}
    _check_finite(state, path)
    with replacing(path) as stream:
        stream.write(save(state, {**own, **notes}))


def load_scan_flow(path: str | Path | None = None) -> ScanFlow:
    """Load a network.

    Args:
        path: File of :func:`save_scan_flow`; ``None`` for the one in the package.

    Returns:
        The network on the CPU, in evaluation mode.

    Raises:
        ValueError: If the file is missing, damaged or of another format, if the weights have other
            shapes than its arguments give, or if a value is not finite; the message names the file.

    Example:
        >>> load_scan_flow().num_scans
        5
    """
    require("full", "load_scan_flow", "safetensors")
    from safetensors import SafetensorError, safe_open

    file = Path(WEIGHTS if path is None else path)
    if not file.is_file():
        raise ValueError(f"{file}: must be a file of save_scan_flow, there is none")
    try:
        with safe_open(file, framework="pt") as stored:
            net = _network(stored.metadata() or {}, file)
            names = stored.keys()
            _check_weights(net, {name: stored.get_slice(name) for name in names}, file)
            state = {name: stored.get_tensor(name) for name in names}
    except (OSError, SafetensorError) as error:
        raise ValueError(f"{file}: damaged or no safetensors file ({error})") from error
    _check_finite(state, file)
    net.load_state_dict(state, assign=True)
    return net.eval()


def _circular(num_in: int, num_out: int, kernel_size: int, dilation: int = 1) -> nn.Conv1d:
    """Return a convolution over all bearings that retains their number."""
    padding = kernel_size // 2 * dilation
    return nn.Conv1d(
        num_in, num_out, kernel_size, padding=padding, dilation=dilation, padding_mode="circular"
    )


def _network(metadata: dict[str, str], file: Path) -> ScanFlow:
    """Return the network of a file's metadata, without memory for its weights."""
    if metadata.get("format") != _FORMAT:
        raise ValueError(f"{file}: format={metadata.get('format')!r}: must be {_FORMAT!r}")
    text = metadata.get("arguments", "")
    try:
        with torch.device("meta"):
            return ScanFlow(**json.loads(text))
    except (ValueError, TypeError, RecursionError) as error:
        raise ValueError(f"{file}: arguments={text[:_MAX_SHOWN]!r}: {error}") from error


def _check_weights(net: ScanFlow, stored: Mapping[str, Any], file: Path) -> None:
    """Check names, shapes and types of a file's weights before they are read."""
    own = net.state_dict()
    if stored.keys() != own.keys():
        missing, unknown = sorted(own.keys() - stored.keys()), sorted(stored.keys() - own.keys())
        raise ValueError(f"{file}: missing weights {missing}, unknown weights {unknown}")
    for name, value in own.items():
        shape, dtype = stored[name].get_shape(), stored[name].get_dtype()
        if shape != [*value.shape] or dtype != "F32":
            raise ValueError(
                f"{file}: {name}: must be F32 of shape {[*value.shape]}, got {dtype} of {shape}"
            )


def _check_finite(state: Mapping[str, Tensor], file: str | Path) -> None:
    for name, value in state.items():
        if not bool(value.isfinite().all()):
            bad = value[~value.isfinite()][0].item()
            raise ValueError(f"{file}: {name}: value={bad}: must be finite")
