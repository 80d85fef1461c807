"""Small files of places, as a user would write them."""

import json

HALL = {
    "format": "navrl-scene-1",
    "id": "hall",
    "wall_height": 2.5,
    "walls": [[0, 0, 8, 0.1], [0, 5.9, 8, 6], [0, 0, 0.1, 6], [7.9, 0, 8, 6]],
    "wall_segments": [[4, 0, 4, 3]],
    "furniture": [
        {"c": "Table", "box": [2, 4, 0.6, 0.4, 0.3], "z": [0.7, 0.74]},
        {"c": "Table", "box": [1.6, 3.8, 0.03, 0.03, 0.3], "z": [0.0, 0.7]},
    ],
    "free": {
        "outer": [[0.4, 0.4], [7.6, 0.4], [7.6, 5.6], [0.4, 5.6]],
        "holes": [[[3.5, 0.4], [4.5, 0.4], [4.5, 3.5], [3.5, 3.5]]],
    },
}
BARN = {
    "format": "barn-grid-1",
    "shape": [30, 64],
    "pitch": 0.15,
    "radius": 0.075,
    "height": 1.0,
    "start": [-2.25, 3.0, 1.5708],
    "goal": [-2.25, 8.0],
}
TRACKS = "# two people\nt,id,x,y\n" + "".join(
    f"{0.5 * k},{person},{1 + 0.4 * k},{1.0 + person}\n" for k in range(12) for person in (3, 1)
)


def barn_world(cells):
    """Return the digits of a world with these cells occupied."""
    value = sum(1 << (30 * 64 - 1 - (64 * i + j)) for i, j in cells)
    return f"{value:0{30 * 64 // 4}x}"


def write(folder, name, content):
    file = folder / name
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    return file


def place_folder(folder):
    """Write the hall with its people and two BARN worlds; return the folder."""
    write(folder, "hall.json", HALL)
    write(folder, "hall.csv", TRACKS)
    posts = [(10, 30), (18, 34)]
    write(folder, "barn.json", {**BARN, "occ": [barn_world(posts), barn_world(posts[:1])]})
    return folder
