"""Batched maths: plain tensors in, plain tensors out; no TensorDict, no configuration."""
