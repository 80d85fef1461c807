"""Context of worker processes that import the package once for all of them."""

from __future__ import annotations

from multiprocessing import get_all_start_methods, get_context
from multiprocessing.context import BaseContext

_preloaded = ["__main__"]


def import_in_server(module: str) -> None:
    """Let workers of :func:`worker_context` begin with a module imported.

    Args:
        module: Dotted name. Importing it must start no thread.
    """
    if module not in _preloaded:
        _preloaded.append(module)


def worker_context() -> BaseContext:
    """Return a multiprocessing context that is safe beside threads of torch and of the kernels.

    Workers are not forked from this process but from a server, which imports the registered modules
    once; where there is no such server, each worker is a new process that imports them itself. The
    server is started by the first worker of this process.
    """
    if "forkserver" not in get_all_start_methods():
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload(_preloaded)
    return context
