"""Compiled CPU kernels, internal to :mod:`navrl.ops` and the batched simulator.

Each module contains small scalar functions and the loops over worlds built from them. The torch
implementations in :mod:`navrl.ops` are the reference that tests compare them with.
"""
