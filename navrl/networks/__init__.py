"""Neural networks: attention, convolution and vector streams, encoder, actor and critic."""

from navrl.networks.actor_critic import ActorNetwork, CriticNetwork, make_actor, make_critic
from navrl.networks.attention import LocationAttention
from navrl.networks.convolution import ConvAttentionStream, ConvStream
from navrl.networks.encoder import AttentionStream, StreamEncoder
from navrl.networks.mlp import mlp
from navrl.networks.scan_flow import ScanFlow
from navrl.networks.vector_stream import VectorStream

__all__ = [
    "ActorNetwork",
    "AttentionStream",
    "ConvAttentionStream",
    "ConvStream",
    "CriticNetwork",
    "LocationAttention",
    "ScanFlow",
    "StreamEncoder",
    "VectorStream",
    "make_actor",
    "make_critic",
    "mlp",
]
