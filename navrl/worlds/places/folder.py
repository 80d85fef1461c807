"""Places of a folder of files, and the hash of those files."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

from navrl.untrusted import DamagedFileError, read_json
from navrl.worlds.places import barn, map_file, scene
from navrl.worlds.places.igibson import load_igibson
from navrl.worlds.places.place import Place
from navrl.worlds.places.reading import REMEDY
from navrl.worlds.places.tracks import load_tracks

SUFFIXES = (".json", ".csv", "_best.urdf", "floor_trav_no_obj_0.png", *map_file.SUFFIXES)
_PLACES = (".json", ".urdf", *map_file.SUFFIXES)  # suffixes of the files of which each is a place


def place_files(folder: str | Path) -> list[Path]:
    """Return the files of places in a folder and the folders below it, sorted by path.

    Raises:
        FileNotFoundError: If the folder does not exist or has no such file.
        DamagedFileError: If a YAML file is not a map, or its picture does not exist.
    """
    root = Path(folder)
    if not root.is_dir():
        reason = "must be a folder, is a file" if root.exists() else "no such folder"
        raise FileNotFoundError(f"data={folder}: {reason}")
    found = (file for file in root.rglob("*") if file.name.endswith(SUFFIXES) and file.is_file())
    files = set(found)
    if not any(file.suffix in _PLACES for file in files):
        raise FileNotFoundError(f"data={folder}: has no places, no file ends in .json or .yaml")
    files |= {map_file.map_image(file) for file in files if file.suffix in map_file.SUFFIXES}
    return sorted(files)


def folder_hash(folder: str | Path) -> str:
    """Return the SHA-256 of the names and contents of all files of places, hexadecimal digits."""
    digest = hashlib.sha256()
    for file in place_files(folder):
        content = hashlib.sha256(file.read_bytes()).hexdigest()
        digest.update(f"{file.relative_to(folder).as_posix()} {content}\n".encode())
    return digest.hexdigest()


def load_places(folder: str | Path) -> list[Place]:
    """Read all places of a folder, in the order of their files' paths.

    A place is a building or hall with its walls and furniture. A file ``NAME.json`` is a scene, or
    has worlds of the benchmark BARN (:func:`load_barn`); ``NAME.yaml`` is a map. ``NAME.csv`` has
    the recorded pedestrians of the scene or map of that name. A folder with
    ``urdf/NAME_best.urdf`` is an iGibson scene NAME.

    Raises:
        FileNotFoundError: If the folder does not exist or has no places.
        DamagedFileError: If a file is not usable, a CSV has no scene or map, or two places
            have one name.
    """
    files = place_files(folder)
    places: dict[str, Place] = {}
    for file in files:
        if file.suffix not in _PLACES:
            continue
        for place in _load(file):
            if place.name in places:
                raise DamagedFileError(file, f"id={place.name}: must be unique", REMEDY)
            places[place.name] = place
    for file in files:
        if file.suffix == ".csv" and not any(file.with_suffix(end) in files for end in _PLACES):
            reason = f"must lie beside a place {file.stem}.json or {file.stem}.yaml"
            raise DamagedFileError(file, reason, REMEDY)
    return list(places.values())


def _load(file: Path) -> list[Place]:
    if file.suffix == ".urdf":
        return [load_igibson(file.parent.parent)]
    if file.suffix in map_file.SUFFIXES:
        return [_with_people(map_file.load_map(file), file)]
    kind = read_json(file, REMEDY).get("format")
    if kind == barn.FORMAT:
        return barn.load_barn(file)
    if kind != scene.FORMAT:
        formats = f"{scene.FORMAT!r} or {barn.FORMAT!r}"
        raise DamagedFileError(file, f"format={kind!r}: must be {formats}", REMEDY)
    return [_with_people(scene.load_scene(file), file)]


def _with_people(place: Place, file: Path) -> Place:
    """Return a place with the recorded pedestrians beside its file, if there are any."""
    tracks = file.with_suffix(".csv")
    if not tracks.is_file():
        return place
    return dataclasses.replace(place, people=load_tracks(tracks))
