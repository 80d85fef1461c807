"""Batched geometry and scan processing on plain tensors; no TensorDict, no configuration."""
