"""Pictures of episodes, training logs and benchmarks, drawn from files without simulation."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
