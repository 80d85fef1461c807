"""Base class of stateless observation transforms and shared key and spec helpers."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import dispatch
from torch import Tensor
from torchrl.data import Binary, Composite, TensorSpec, Unbounded
from torchrl.envs import Transform

Keys = Sequence[NestedKey | list[str]] | str


class ObservationMap(Transform):
    """Base class of transforms whose outputs depend only on inputs of the same time step.

    A subclass names its inputs and outputs and defines the mapping of values and specs. This class
    applies it after each reset and step, to data from a replay buffer (at the root and under
    ``"next"``) and, called with keywords, to plain tensors. No state is stored between calls.

    Args:
        in_keys: One key for each of ``INPUTS`` in order, followed by any number of
            ``OPTIONAL_INPUTS``. A nested key is a tuple, or a list in YAML.
        out_keys: One key for each of ``OUTPUTS``, followed by those of ``OPTIONAL_OUTPUTS``.

    Raises:
        ValueError: If the number of keys is wrong, or later if the environment lacks a key.

    Example:
        >>> from navrl.transforms import real_spec
        >>> class NearestRange(ObservationMap):
        ...     INPUTS, OUTPUTS = ("ranges",), ("nearest range",)
        ...
        ...     def map_values(self, ranges):
        ...         return (ranges.amin(-1, keepdim=True),)
        ...
        ...     def map_specs(self, ranges):
        ...         return (real_spec(ranges, *ranges.shape[:-1], 1),)
        >>> NearestRange(in_keys=["ranges"], out_keys=["nearest"])(
        ...     ranges=torch.tensor([[3.0, 1.5]])
        ... )
        tensor([[1.5000]])
    """

    INPUTS: tuple[str, ...]
    OUTPUTS: tuple[str, ...]
    OPTIONAL_INPUTS: tuple[str, ...] = ()
    OPTIONAL_OUTPUTS: tuple[str, ...] = ()

    def __init__(self, in_keys: Keys, out_keys: Keys) -> None:
        super().__init__(in_keys=nested_keys(in_keys), out_keys=nested_keys(out_keys))
        name = type(self).__name__
        _check_count(name, "in_keys", self.in_keys, self.INPUTS, self.OPTIONAL_INPUTS)
        _check_count(name, "out_keys", self.out_keys, self.OUTPUTS, self.OPTIONAL_OUTPUTS)

    # Subclasses name their inputs; type checkers accept that as an override only of Any.
    @abstractmethod
    def map_values(self, *inputs: Any, **named: Any) -> Sequence[Tensor]:
        """Return one new tensor per output key, given one tensor per input key."""

    @abstractmethod
    def map_specs(self, *inputs: Any, **named: Any) -> Sequence[TensorSpec]:
        """Return one spec per output key, given one spec per input key.

        Raises:
            ValueError: If the input specs do not match the transform.
        """

    @dispatch(source="in_keys", dest="out_keys", auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Map data outside an environment; transitions are mapped at the root and under "next"."""
        self._call(tensordict)
        if "next" in tensordict:
            self._call(tensordict["next"])
        return tensordict

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        inputs = [read(self, next_tensordict, key) for key in self.in_keys]
        for key, value in zip(self.out_keys, self.map_values(*inputs), strict=True):
            next_tensordict.set(key, value)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return map_reset_rows(self, tensordict, tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the specs of the outputs to those of the environment."""
        observation_spec = cloned(observation_spec)
        inputs = [read_spec(self, observation_spec, key) for key in self.in_keys]
        for key, spec in zip(self.out_keys, self.map_specs(*inputs), strict=True):
            observation_spec[key] = spec
        return observation_spec


def map_reset_rows(
    transform: Transform, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
) -> TensorDictBase:
    """Apply a transform's ``_call`` to the rows that were reset and to no others.

    TorchRL discards the other rows after a partial reset, but a later transform that computes
    statistics of the whole batch (VecNorm) reads them. In TorchRL's own ``TransformedEnv`` the
    present values are not available; then all rows are mapped as at a reset, which is correct for
    outputs that depend on a single time step.

    Args:
        transform: Transform whose outputs in a row depend on its ``in_keys`` in that row only.
        tensordict: Argument of the reset: ``_reset``, and the present values as passed by
            :class:`navrl.envs.TransformedNavigationEnv`.
        tensordict_reset: ``[*B]``, result of the environment's reset.

    Returns:
        ``tensordict_reset`` with the outputs.
    """
    mask = tensordict.get("_reset", None)
    if mask is None or mask.shape != (*tensordict_reset.batch_size, 1):
        return transform._call(tensordict_reset)
    present = [tensordict.get(key, None) for key in transform.out_keys]
    if any(value is None for value in present):
        return transform._call(tensordict_reset)
    index = mask.squeeze(-1).nonzero(as_tuple=True)  # once: a device has to be waited for
    if len(index[0]) == mask.numel():
        return transform._call(tensordict_reset)
    rows = transform._call(tensordict_reset.select(*transform.in_keys, strict=False)[index])
    for key, value in zip(transform.out_keys, present, strict=True):
        tensordict_reset.set(key, value.index_put(index, rows.get(key)))
    return tensordict_reset


def require_history(
    transform: Transform, tensordict: TensorDictBase, keys: Sequence[NestedKey]
) -> None:
    """Reject stored transitions whose root lacks entries that depend on earlier steps.

    Data without ``"next"`` is treated as initial scans, which have no past.

    Args:
        transform: Transform that carries ``keys`` from step to step.
        tensordict: Stored data.
        keys: Keys missing at its root.

    Raises:
        ValueError: If the data contains transitions; the message names the keys.
    """
    if "next" in tensordict:
        name = type(transform).__name__
        raise ValueError(
            f"{name} needs {list(keys)} at the root of stored transitions, because they depend on "
            f"earlier steps. Run {name} and the transforms before it in the environment and store "
            "their outputs; transforms of a single time step (ICPAlign, TAGD, Normalize) can run "
            "in the replay buffer"
        )


def restore_history(transform: Transform, tensordict: TensorDictBase) -> TensorDictBase:
    """Compute the entries of stored data that depend on earlier steps, and return the data.

    Entries stored at the root are retained; those under ``"next"`` are computed from the root.

    Args:
        transform: Transform that carries its ``out_keys`` from step to step.
        tensordict: Stored data.

    Raises:
        ValueError: If the root of a transition lacks an entry.
    """
    missing = [key for key in transform.out_keys if key not in tensordict.keys(True, True)]
    if missing:
        require_history(transform, tensordict, missing)
        transform._call(tensordict)
    if "next" in tensordict:
        transform._step(tensordict, tensordict["next"])
    return tensordict


def nested_keys(keys: Keys) -> list[NestedKey]:
    """Return keys in the form of TorchRL: lists for nested keys (from YAML) become tuples."""
    keys = [keys] if isinstance(keys, str) else keys
    return [key if isinstance(key, str) else tuple(key) for key in keys]


def read(transform: Transform, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
    """Return an entry of a TensorDict.

    Raises:
        ValueError: If the key is missing; the message lists the available keys.
    """
    value = tensordict.get(key, None)
    if value is None:
        present = ", ".join(sorted(map(str, tensordict.keys(True, True))))
        raise ValueError(f"{type(transform).__name__} needs key {key!r}; available: {present}")
    return value


def cloned(specs: TensorSpec) -> Composite:
    """Return a copy of the specs of an environment, which are always composite."""
    assert isinstance(specs, Composite)
    return specs.clone()


def observed_specs(transform: Transform) -> Composite:
    """Return the observation specs of the environment below a transform."""
    assert transform.parent is not None
    return transform.parent.full_observation_spec


def read_spec(transform: Transform, specs: Composite, key: NestedKey) -> TensorSpec:
    """Return the spec of a key.

    Raises:
        ValueError: If the environment lacks the key; the message lists the available keys.
    """
    present = specs.keys(True, True)
    if key not in present:
        known = ", ".join(sorted(map(str, present)))
        raise ValueError(f"{type(transform).__name__} needs key {key!r}; the env has: {known}")
    return specs[key]


def world_values(*values: Tensor) -> tuple[Tensor, ...]:
    """Return world coordinates in float64 if any of them has it, else in float32.

    Near (5e5, 5.6e6) m, typical of maps in UTM coordinates, float32 has a resolution of half a
    meter; therefore coordinates are converted to float32 only after their subtraction.
    """
    is_double = any(value.dtype == torch.float64 for value in values)
    return tuple(value.double() if is_double else value.float() for value in values)


def real_spec(like: TensorSpec, *shape: int) -> Unbounded:
    """Return a float32 spec, for :meth:`ObservationMap.map_specs`.

    Args:
        like: Spec of an input, whose device it has.
        *shape: All dimensions, with the batch.

    Example:
        >>> real_spec(Unbounded((2, 360)), 2, 1).shape
        torch.Size([2, 1])
    """
    return Unbounded(torch.Size(shape), dtype=torch.float32, device=like.device)


def flag_spec(like: TensorSpec, *shape: int) -> Binary:
    """Return a bool spec, for :meth:`ObservationMap.map_specs`.

    Args:
        like: Spec of an input, whose device it has.
        *shape: All dimensions, with the batch.

    Example:
        >>> flag_spec(Unbounded((2, 360)), 2, 90).dtype
        torch.bool
    """
    return Binary(shape[-1], torch.Size(shape), dtype=torch.bool, device=like.device)


def _check_count(
    transform: str,
    argument: str,
    keys: Sequence[NestedKey],
    names: tuple[str, ...],
    optional: tuple[str, ...],
) -> None:
    if not len(names) <= len(keys) <= len(names) + len(optional):
        more = f", and optionally {', '.join(optional)}" if optional else ""
        raise ValueError(
            f"{transform}: {argument}={keys}: must be {len(names)} "
            f"{'key' if len(names) == 1 else 'keys'} ({', '.join(names)})"
            f"{more}; write a nested key as a list within the list"
        )
