"""Run the cases by numba's CUDA simulator and save the results: ``cuda_simulation.py FILE``.

In a process of its own, with NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1: the simulator runs
kernels as plain Python on CPU tensors, a few threads a block to be fast.
"""

import sys

import torch
from cuda_cases import CASES

from navrl.ops.kernels import compiler
from navrl.ops.kernels.cuda.launch import CudaKernel

compiler.runs_on_cuda = lambda argument: True
launched, launch = set(), CudaKernel.__call__


def launch_small(kernel, *arguments):
    launched.add(kernel.__name__)
    kernel.threads = 4
    launch(kernel, *arguments)


CudaKernel.__call__ = launch_small
torch.save(
    {"results": {n: case("cpu") for n, case in CASES.items()}, "launched": launched}, sys.argv[1]
)
