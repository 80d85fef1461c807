"""Places of a folder of files, and the hash of those files."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

from navrl.untrusted import DamagedFileError, read_json
from navrl.worlds.places import barn, scene
from navrl.worlds.places.igibson import load_igibson
from navrl.worlds.places.place import Place
from navrl.worlds.places.reading import REMEDY
from navrl.worlds.places.tracks import load_tracks

SUFFIXES = (".json", ".csv", "_best.urdf", "floor_trav_no_obj_0.png")


def place_files(folder: str | Path) -> list[Path]:
    """Return the files of places in a folder and the folders below it, sorted by path.

    Raises:
        FileNotFoundError: If the folder does not exist or has no such file.
    """
    root = Path(folder)
    if not root.is_dir():
        raise FileNotFoundError(f"data={folder}: no such folder")
    found = (file for file in root.rglob("*") if file.name.endswith(SUFFIXES) and file.is_file())
    files = sorted(found)
    if not any(file.suffix in (".json", ".urdf") for file in files):
        raise FileNotFoundError(f"data={folder}: has no places, no file ends in .json")
    return files


def folder_hash(folder: str | Path) -> str:
    """Return the SHA-256 of the names and contents of all files of places, hexadecimal digits."""
    digest = hashlib.sha256()
    for file in place_files(folder):
        content = hashlib.sha256(file.read_bytes()).hexdigest()
        digest.update(f"{file.relative_to(folder).as_posix()} {content}\n".encode())
    return digest.hexdigest()


def load_places(folder: str | Path) -> list[Place]:
    """Read all places of a folder, in the order of their files' paths.

    A file ``NAME.json`` is a scene or a file of BARN worlds; ``NAME.csv`` beside it has its
    recorded pedestrians. A folder with ``urdf/NAME_best.urdf`` is an iGibson scene NAME.

    Raises:
        FileNotFoundError: If the folder does not exist or has no places.
        DamagedFileError: If a file is not usable, a CSV has no place, or two places have one name.
    """
    files = place_files(folder)
    places: dict[str, Place] = {}
    for file in files:
        if file.suffix not in (".json", ".urdf"):
            continue
        for place in _load(file):
            if place.name in places:
                raise DamagedFileError(file, f"id={place.name}: must be unique", REMEDY)
            places[place.name] = place
    for file in files:
        if file.suffix == ".csv" and file.with_suffix(".json") not in files:
            raise DamagedFileError(file, f"must lie beside a place {file.stem}.json", REMEDY)
    return list(places.values())


def _load(file: Path) -> list[Place]:
    if file.suffix == ".urdf":
        return [load_igibson(file.parent.parent)]
    kind = read_json(file, REMEDY).get("format")
    if kind == barn.FORMAT:
        return barn.load_barn(file)
    if kind != scene.FORMAT:
        formats = f"{scene.FORMAT!r} or {barn.FORMAT!r}"
        raise DamagedFileError(file, f"format={kind!r}: must be {formats}", REMEDY)
    place, tracks = scene.load_scene(file), file.with_suffix(".csv")
    if tracks.is_file():
        place = dataclasses.replace(place, people=load_tracks(tracks))
    return [place]
