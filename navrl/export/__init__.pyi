from .graph import DriveGraph
from .onnx_policy import OnnxFileError, OnnxPolicy
from .writing import ExportError, export_network, export_policy

__all__ = [
    "DriveGraph",
    "ExportError",
    "OnnxFileError",
    "OnnxPolicy",
    "export_network",
    "export_policy",
]
