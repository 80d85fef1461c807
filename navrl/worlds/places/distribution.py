"""Episodes in the places of a folder."""

from __future__ import annotations

from typing import Any

from navrl.worlds.clearance_map import ClearanceMap
from navrl.worlds.places.episodes import PlaceEpisodes
from navrl.worlds.places.folder import folder_hash, load_places
from navrl.worlds.places.place import Place


class PlaceDistribution(PlaceEpisodes[int]):
    """Episodes in the places of a folder, one place after another.

    Args:
        folder: Folder with the files of :func:`navrl.worlds.load_places`.
        sha256: Expected hash of the files; ``None`` for any.
        episodes: Arguments of :class:`navrl.worlds.PlaceEpisodes`.

    Raises:
        FileNotFoundError: If the folder does not exist.
        DamagedFileError: If a file is not usable.
        ValueError: If a value is out of range, or ``sha256`` differs.
    """

    def __init__(self, folder: str, sha256: str | None = None, **episodes: Any) -> None:
        """Read the files and check the values."""
        super().__init__(**episodes)
        self.sha256 = folder_hash(folder)
        """Hash of the files."""
        if sha256 is not None and sha256 != self.sha256:
            raise ValueError(f"sha256={sha256}: the files of {folder} have {self.sha256}")
        self.places = load_places(folder)

    def key_of(self, suite: str, seed: int, index: int) -> int:
        """Return the number of the place: ``index`` modulo the number of places."""
        return index % len(self.places)

    def make_place(self, key: int) -> Place:
        """Return a place by its number."""
        return self.places[key]

    def map_of(self, number: int) -> ClearanceMap:
        """Return the map of a place by its number."""
        return self.floor(number).grid
