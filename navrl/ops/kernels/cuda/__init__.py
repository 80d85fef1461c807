"""CUDA counterparts of :mod:`navrl.ops.kernels` for one device, with the same module names.

The geometry is shared: the same scalar functions are compiled for the device. These modules only
distribute the work, with one thread or one block of threads per world.
"""
