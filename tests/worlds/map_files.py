"""Small maps of map_server, as a user would have them."""

import numpy as np
from PIL import Image

YAML = {
    "image": "office.pgm",
    "mode": "trinary",
    "resolution": 0.1,
    "origin": [-1.0, -2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
FREE, UNKNOWN, WALL = 254, 205, 0


def office():
    """Pixels of two rooms of 3 m x 4 m with a door of 1 m, unknown around them."""
    pixels = np.full((60, 80), UNKNOWN, np.uint8)
    pixels[9:51, 9:73] = WALL
    pixels[10:50, 10:40] = pixels[10:50, 42:72] = FREE
    pixels[38:48, 40:42] = FREE  # the door, at the lower end
    pixels[20:30, 71:74] = UNKNOWN  # an open side of the second room
    return pixels


def pgm(pixels, magic="P5", comment=""):
    """Return the bytes of a PGM, binary (P5) or as text (P2)."""
    rows, columns = pixels.shape
    head = f"{magic}\n{comment}{columns} {rows}\n255\n".encode()
    if magic == "P5":
        return head + pixels.tobytes()
    return head + "\n".join(" ".join(map(str, row)) for row in pixels.tolist()).encode()


def write_map(folder, pixels=None, name="office", content=None, **changes):
    """Write a map with its picture; keys with the value ``...`` are left out."""
    values = {**YAML, **changes}
    picture = folder / str(values["image"])
    pixels = office() if pixels is None else pixels
    if content is not None:
        picture.write_bytes(content)
    elif picture.suffix == ".pgm":
        picture.write_bytes(pgm(pixels))
    elif picture.suffix:
        Image.fromarray(pixels).save(picture)
    file = folder / f"{name}.yaml"
    lines = (f"{key}: {value}" for key, value in values.items() if value is not ...)
    file.write_text("\n".join(lines) + "\n")
    return file
