"""Compile all CUDA kernels, without a device: ``cuda_compilation.py FILE``.

FILE is what ``cuda_simulation.py`` wrote: the types that each kernel is launched with. Prints the
name of each kernel and the length of its code.
"""

import importlib
import pickle
import pkgutil
import sys
from pathlib import Path
from types import SimpleNamespace

from numba import cuda
from numba.cuda import dispatcher

import navrl.ops.kernels.cuda as package
from navrl.ops.kernels.cuda.launch import CudaKernel

COMPUTE_CAPABILITY = (9, 0)  # an H100's


def kernels():
    """Return all kernels for CUDA by name."""
    modules = (
        f"{package.__name__}.{module.name}" for module in pkgutil.iter_modules(package.__path__)
    )
    members = [
        member for name in modules for member in vars(importlib.import_module(name)).values()
    ]
    return {member.__name__: member for member in members if isinstance(member, CudaKernel)}


if __name__ == "__main__":
    device = SimpleNamespace(compute_capability=COMPUTE_CAPABILITY)
    dispatcher.get_current_device = lambda: device  # numba asks when one kernel calls another
    signatures = pickle.loads(Path(sys.argv[1]).read_bytes())["signatures"]
    for name, kernel in kernels().items():
        for signature in sorted(signatures[name], key=str):
            code, _ = cuda.compile_ptx(kernel.function, signature, cc=COMPUTE_CAPABILITY)
            print(name, len(code), flush=True)
