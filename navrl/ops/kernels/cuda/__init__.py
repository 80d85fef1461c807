"""The kernels of :mod:`navrl.ops.kernels` for one CUDA device, module by module, name by name.

The geometry is not written again: the same scalar functions are compiled for the device. What is
here is the other way to share out the work, a thread or a block of threads for each world.
"""
