"""What the tests of the learners share."""

from functools import partial

import torch
from tensordict import TensorDict

from navrl.networks import AttentionStream, StreamEncoder

SHAPES = {"spatial": (180, 2), "waypoints_scaled": (5, 2)}
SMALL = {"embedding": (16,), "score": (1,), "feature": (8,)}
ENCODER = partial(
    StreamEncoder, streams={"spatial": partial(AttentionStream, in_key="spatial", **SMALL)}
)


def batch(size: int = 8) -> TensorDict:
    def observed():
        return {key: torch.randn(size, *shape) for key, shape in SHAPES.items()}

    flags = torch.zeros(size, 1, dtype=torch.bool)
    following = {"reward": torch.randn(size, 1), "done": flags, "terminated": flags.clone()}
    return TensorDict(
        {
            **observed(),
            "action": torch.rand(size, 2) * 2 - 1,
            "next": TensorDict({**observed(), **following}, [size]),
        },
        [size],
    )
