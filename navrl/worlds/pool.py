"""Pool of training scenarios, generated once and drawn at random."""

from __future__ import annotations

import copy
import hashlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from navrl.files import explain_os_error, replacing
from navrl.untrusted import DamagedFileError, read_arrays
from navrl.worlds.batch import ScenarioBatch
from navrl.worlds.suite import Suite

LOG = logging.getLogger(__name__)
_MAX_CACHE_BYTES = 8 * 2**30  # 100,000 scenarios have about 2 GB


class ScenarioPool:
    """Packed scenarios of a suite, drawn at random with new sensor noise.

    Planning a scenario takes longer than simulating it, so training draws from a fixed pool. Draws
    depend only on the generator, so runs are reproducible.

    Args:
        suite: Source of the scenarios. Its distribution should place as many dynamic pedestrians as
            the highest curriculum level; a draw uses some of them.
        num_workers: Number of generating processes.
        cache: File of the packed scenarios; ``None`` stores them in memory only. A file of another
            suite, or a damaged one, is replaced; a failure to write it causes a warning.
        empty_share: Share of draws without pedestrians. Not in the paper: a robot that always meets
            a pedestrian half-way never reaches its goal and cannot learn from it.
        progress: Whether to show the progress of the generation.

    Raises:
        ValueError: If ``empty_share`` is outside [0, 1].
    """

    def __init__(
        self,
        suite: Suite,
        num_workers: int = 1,
        cache: Path | None = None,
        empty_share: float = 0.0,
        progress: bool = False,
    ) -> None:
        if not 0 <= empty_share <= 1:
            raise ValueError(f"empty_share={empty_share}: must be in [0, 1]")
        self.empty_share = empty_share
        batch = _load(cache, suite) if cache is not None else None
        if batch is None:
            batch = suite.batch(num_workers, progress)
            if cache is not None:
                _save(cache, suite, batch)
        self.batch = batch
        dynamic = self.batch.ped_present & ~self.batch.ped_static
        self._num_dynamic = dynamic.sum(dim=-1)

    def __len__(self) -> int:
        return len(self.batch)

    def to(self, device: torch.device | str) -> ScenarioPool:
        """Return the pool with its scenarios on ``device``; its draws are the same."""
        pool = copy.copy(self)
        pool.batch, pool._num_dynamic = self.batch.to(device), self._num_dynamic.to(device)
        return pool

    def draw(
        self, generator: torch.Generator, count: int, max_dynamic: int | None = None
    ) -> ScenarioBatch:
        """Draw scenarios with replacement.

        Args:
            generator: Source of all randomness, on the CPU for every device of the pool, so that a
                seed gives the same episodes on all devices.
            count: Number of scenarios.
            max_dynamic: Each scenario uses 1 to this many of its dynamic pedestrians, uniformly;
                ``None`` uses all.
        """
        rows = torch.randint(len(self.batch), (count,), generator=generator)
        empty = torch.rand(count, generator=generator) < self.empty_share
        batch = self._vary(rows, generator, max_dynamic)
        return batch.without_pedestrians(empty.to(self.batch.start.device))

    def all(self, generator: torch.Generator, max_dynamic: int | None = None) -> ScenarioBatch:
        """Return every scenario once, in order, varied as in :meth:`draw` but with pedestrians."""
        return self._vary(torch.arange(len(self.batch)), generator, max_dynamic)

    def _vary(
        self, rows: Tensor, generator: torch.Generator, max_dynamic: int | None
    ) -> ScenarioBatch:
        seeds = torch.randint(2**32, rows.shape, generator=generator)
        device = self.batch.start.device
        rows = rows.to(device)
        batch = self.batch[rows].with_noise_seed(seeds.to(device))
        if max_dynamic is None:
            return batch
        if max_dynamic < 1:
            raise ValueError(f"max_dynamic={max_dynamic}: must be >= 1")
        max_count = self._num_dynamic[rows].clamp(max=max_dynamic).clamp_min(1)
        share = torch.rand(rows.shape, generator=generator, dtype=torch.float64).to(device)
        return batch.with_num_dynamic((share * max_count).long() + 1)


def _fingerprint(suite: Suite) -> str:
    """Return a hash of a few of the suite's scenarios and of the generating source code."""
    source = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        source.update(file.read_bytes())
    few = [int(k) for k in np.linspace(0, suite.num_episodes - 1, min(suite.num_episodes, 8))]
    return f"{suite.num_episodes}-{suite.hash(suite.scenarios(few))}-{source.hexdigest()}"


def _load(cache: Path, suite: Suite) -> ScenarioBatch | None:
    """Return the scenarios of a cache file; ``None`` if they must be generated again."""
    try:
        arrays = read_arrays(cache, "the scenarios are generated again", _MAX_CACHE_BYTES)
        if str(arrays.pop("fingerprint", "")) != _fingerprint(suite):
            return None
        kinds = [str(name) for name in arrays.pop("kinds", ())]
        return ScenarioBatch.from_tensors(
            {k: torch.from_numpy(v) for k, v in arrays.items()}, kinds
        )
    except FileNotFoundError:
        return None
    except OSError as error:
        LOG.warning("%s; the scenarios are generated again", explain_os_error(error))
    except DamagedFileError as error:
        LOG.warning("%s", error)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:  # other arrays than a batch's
        LOG.warning("%s: %s; the scenarios are generated again", cache, error)
    return None


def _save(cache: Path, suite: Suite, batch: ScenarioBatch) -> None:
    arrays: dict[str, Any] = {name: value.numpy() for name, value in batch.tensors().items()}
    try:
        with replacing(cache) as file:
            np.savez(file, fingerprint=_fingerprint(suite), kinds=batch.kinds, **arrays)
    except OSError as error:
        LOG.warning("scenarios are not cached: %s", explain_os_error(error))
