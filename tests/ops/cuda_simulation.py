"""Run the cases by numba's CUDA simulator and save what came of it: ``cuda_simulation.py FILE``.

In a process of its own, with NUMBA_ENABLE_CUDASIM=1 and NUMBA_DISABLE_JIT=1: the simulator runs
kernels as plain Python on CPU tensors, a few threads a block to be fast. Needs no numba-cuda.

FILE holds ``results``, by case, and ``signatures``: of each kernel's name the types of arguments
that it was launched with.
"""

import pickle
import sys
from collections import defaultdict
from pathlib import Path

import numba
from cuda_cases import CASES

from navrl.ops.kernels import compiler
from navrl.ops.kernels.cuda.launch import CudaKernel

compiler.runs_on_cuda = lambda argument: True
signatures, launch = defaultdict(set), CudaKernel.__call__


def launch_small(kernel, *arguments):
    types = (numba.typeof(compiler.as_array(argument)) for argument in arguments)
    signatures[kernel.__name__].add(tuple(types))
    kernel.threads = 4
    launch(kernel, *arguments)


CudaKernel.__call__ = launch_small
results = {
    name: {key: value.numpy() for key, value in case("cpu").items()} for name, case in CASES.items()
}
Path(sys.argv[1]).write_bytes(pickle.dumps({"results": results, "signatures": dict(signatures)}))
