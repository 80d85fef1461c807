"""Names of bundles and their folders; importing this loads no torch."""

from __future__ import annotations

from pathlib import Path

ZOO = Path(__file__).parent / "zoo"
"""Bundles that ship with the package, one folder each."""


def zoo_names() -> list[str]:
    """Return the names of the bundles in the zoo."""
    return sorted(folder.name for folder in ZOO.glob("*") if (folder / "config.yaml").is_file())


def bundle_folder(policy: str) -> Path | None:
    """Return the folder of the bundle that ``policy`` names, or ``None`` if it names none.

    A bundle's own folder, a training run's folder and a name in the zoo are bundles.
    """
    for folder in (Path(policy), Path(policy) / "policy", ZOO / policy):
        if (folder / "config.yaml").is_file() and (folder / "weights.safetensors").is_file():
            return folder
    return None
