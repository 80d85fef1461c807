"""Writing of ONNX files from policies."""

from __future__ import annotations

import contextlib
import json
import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from navrl.export.exact_scalars import ExactScalars
from navrl.export.golden import pack
from navrl.export.graph import DriveGraph
from navrl.export.guard import STATES
from navrl.export.onnx_policy import FORMAT, NEXT, STATE
from navrl.extras import require
from navrl.files import replacing

if TYPE_CHECKING:
    import onnx_ir

_OPSET = 20
_EXAMPLES = 3  # rows of the example batch; the size is a variable of the file


class ExportError(ValueError):
    """Part of a policy that cannot be expressed in ONNX."""


def export_policy(
    graph: DriveGraph,
    file: str | Path,
    golden: Mapping[str, np.ndarray],
    metadata: Mapping[str, Any],
) -> None:
    """Write a file that maps a scan to a command.

    Args:
        graph: One step of the policy.
        file: Destination, ``*.onnx``.
        golden: Recorded drives with the expected commands, of
            :func:`navrl.export.golden.record`.
        metadata: Further entries, plain data by name.

    Raises:
        ExportError: If torch or ONNX lacks an operation of the pipeline; the message names it.
        ModuleNotFoundError: If the extra ``onnx`` is not installed.
        OSError: If the file cannot be written.
    """
    state = [f"{STATE}{key}" for key in graph.state]
    names = [*graph.sensors, *state]
    outputs = ["command", "drive_state", *(f"{NEXT}{key}" for key in graph.state)]
    examples = [*graph.sensors.values(), *graph.state.values()]
    kinds = {"kind": "policy", "drive_states": [str(each) for each in STATES]}
    _write(graph, names, examples, outputs, file, {**metadata, **kinds}, golden)


def export_network(
    actor: TensorDictModule,
    shapes: Mapping[str, Sequence[int]],
    file: str | Path,
    golden: Mapping[str, np.ndarray],
    metadata: Mapping[str, Any],
) -> None:
    """Write a file of the network alone: its scaled inputs to the action in [-1, 1].

    Args:
        actor: Network with the single output ``action``.
        shapes: Shape of each input without the batch, by key.
        file: Destination, ``*.onnx``.
        golden: Inputs ``[T, ...]`` by key and the expected ``action`` ``[T, A]``.
        metadata: Further entries, plain data by name.

    Raises:
        ExportError: If torch or ONNX lacks an operation of the network; the message names it.
        ModuleNotFoundError: If the extra ``onnx`` is not installed.
        OSError: If the file cannot be written.
    """
    names = [str(key) for key in actor.in_keys]
    examples = [torch.zeros(1, *shapes[name]) for name in names]
    entries = {**metadata, "kind": "network"}
    _write(cast(nn.Module, actor.module), names, examples, ["action"], file, entries, golden)


def _write(
    module: nn.Module,
    names: Sequence[str],
    examples: Sequence[Tensor],
    outputs: Sequence[str],
    file: str | Path,
    metadata: Mapping[str, Any],
    golden: Mapping[str, np.ndarray],
) -> None:
    """Export a module and write it with its metadata and golden drive."""
    require("onnx", "navrl-export", "onnx", "onnxscript", "onnxruntime")
    model = _converted(module.eval(), names, examples, outputs)
    entries = {name: json.dumps(value) for name, value in metadata.items()}
    model.metadata_props.update({"format": FORMAT, **entries, "golden": pack(golden)})
    import onnx_ir

    with replacing(Path(file)) as stream:
        stream.write(onnx_ir.to_proto(model).SerializeToString())


def _converted(
    module: nn.Module, names: Sequence[str], examples: Sequence[Tensor], outputs: Sequence[str]
) -> onnx_ir.Model:
    """Return the ONNX model of a module, without the traces of its source."""
    from navrl.export.operators import translations
    from navrl.export.passes import simplify

    batch = torch.export.Dim("batch", min=1)
    inputs = tuple(torch.cat([value] * _EXAMPLES) for value in examples)
    shapes = [{0: batch} for _ in inputs]
    try:
        with torch.no_grad(), _quiet():
            with ExactScalars():
                traced = torch.export.export(
                    _Positional(module), inputs, dynamic_shapes=(tuple(shapes),), strict=False
                )
            program = torch.onnx.export(
                traced,
                dynamo=True,
                opset_version=_OPSET,
                input_names=list(names),
                output_names=list(outputs),
                custom_translation_table=translations(),
                verbose=False,
            )
    except RuntimeError as error:  # base class of the errors of both exporters
        raise ExportError(_reason(error)) from error
    assert program is not None
    simplify(program.model)
    return program.model


class _Positional(nn.Module):
    """A module whose inputs are one list, so that their number is free."""

    def __init__(self, module: nn.Module) -> None:
        super().__init__()
        self.module = module

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        outputs = self.module(*inputs)
        return outputs if isinstance(outputs, tuple) else (outputs,)


def _reason(error: BaseException) -> str:
    """Return the innermost cause of a failed export in one line."""
    while error.__cause__ is not None:
        error = error.__cause__
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return f"the policy has no ONNX form: {lines[0]}"


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the progress and warnings of torch's exporter."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnx_ir", "onnxscript")]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
