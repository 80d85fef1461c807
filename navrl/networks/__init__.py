"""Networks: attention blocks, streams, actor and critic."""

from navrl.networks.actor_critic import ActorNetwork, CriticNetwork, make_actor, make_critic
from navrl.networks.attention import LocationAttention
from navrl.networks.encoder import AttentionStream, StreamEncoder
from navrl.networks.mlp import mlp

__all__ = [
    "ActorNetwork",
    "AttentionStream",
    "CriticNetwork",
    "LocationAttention",
    "StreamEncoder",
    "make_actor",
    "make_critic",
    "mlp",
]
