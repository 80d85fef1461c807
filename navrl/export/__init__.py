"""Export of policies to ONNX, and a loader that needs numpy and ONNX Runtime only."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
