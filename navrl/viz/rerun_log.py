"""Export of an episode for the 3D viewer of rerun.io."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from matplotlib.colors import to_rgba_array

from navrl.evaluation.recording import Recording
from navrl.extras import install_hint
from navrl.files import replacing_path
from navrl.viz.drive import forward_and_turn
from navrl.viz.scene import ATTENTIONS, SPATIAL, TEMPORAL, attention_scale
from navrl.viz.style import BLACK, BLUE, CYCLE, GRAY, GREEN, ORANGE, PURPLE, VERMILLION

STEP, TIME = "step", "time"  # timelines
# m, as in navrl.sim.bullet_scene, which is not imported here, and with the default lidar:
# recordings have no heights.
WALL_HEIGHT, PEDESTRIAN_HEIGHT, ROBOT_HEIGHT, SCAN_HEIGHT = 1.2, 1.0, 0.42, 0.5
_FLOOR_M = 0.01  # height of lines on the floor, and half the height of the goal's disc
_POINT_M, _LINE_M = 0.03, 0.015  # radii
_WALL_GRAY, _BACKGROUND = "#A8B0BD", "#F7F7F7"
_MIN_INTENSITY = 0.25  # start of color maps, so that zero attention is visible on the background


def save_rrd(recording: Recording, file: str | Path, name: str | None = None) -> Path:
    """Write an episode for the viewer of rerun.

    Both timelines, ``step`` and ``time``, have T + 1 rows; decisions and rewards of step t are in
    row t, so the last row has none. All of ``world`` is in the world frame, m, z up: walls, path
    and goal; pedestrians, the robot and its trajectory; the pooled scan (or the raw one) and the
    motion c_{t-1} to c_t of each descriptor. Points are colored by their sector's spatial
    attention, motions by their temporal attention, on the scales of
    :func:`navrl.viz.scene.attention_scale`; black and green without attention. ``commands`` are v
    in m/s and w in rad/s, ``rewards`` the weighted terms.

    Args:
        recording: The episode.
        file: ``.rrd``; missing folders are created.
        name: Name of the episode in the viewer; the file's name if ``None``.

    Returns:
        The file.

    Raises:
        ImportError: If rerun is not installed.
        ValueError: If the suffix is not ``.rrd``.
    """
    file = Path(file)
    if file.suffix != ".rrd":
        raise ValueError(f"file={file}: must end in .rrd")
    rr = _rerun()
    with (
        replacing_path(file) as fresh,
        _strict(rr),
        rr.RecordingStream("navrl", recording_id=uuid.uuid4()) as stream,
    ):
        stream.save(fresh, default_blueprint=_blueprint())
        stream.send_recording_name(file.stem if name is None else name)
        stream.send_property("episode", rr.AnyValues(outcome=recording.outcome))
        _Log(rr, stream, recording).write()
    return file


def _rerun() -> ModuleType:
    try:
        import rerun
    except ImportError as error:
        raise ImportError(f"a .rrd file needs rerun; {install_hint('rerun')}") from error
    return rerun


@contextmanager
def _strict(rr: ModuleType) -> Iterator[None]:
    """Turn rerun's warnings into exceptions."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)


def _blueprint() -> Any:
    """Return the initial layout of the viewer: scene, commands and rewards."""
    import rerun.blueprint as rrb

    scene = rrb.Spatial3DView(origin="world", name="scene", background=_rgba(_BACKGROUND)[0])
    plots = (rrb.TimeSeriesView(origin=name, name=name) for name in ("commands", "rewards"))
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Vertical(*plots), column_shares=[2, 1]),
        rrb.TimePanel(timeline=TIME),
        collapse_panels=True,
    )


class _Log:
    """Writer of one episode to a stream, each quantity as columns over time."""

    def __init__(self, rr: ModuleType, stream: Any, recording: Recording) -> None:
        self._rr, self._stream, self._recording = rr, stream, recording

    def write(self) -> None:
        self._map()
        self._pedestrians()
        self._robot()
        self._scan()
        self._descriptors()
        self._curves()

    def _map(self) -> None:
        rr, recording = self._rr, self._recording
        self._still("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        walls = _upright(recording.walls, WALL_HEIGHT)
        look = {"colors": _rgba(_WALL_GRAY), "fill_mode": "TransparentFillMajorWireframe"}
        self._still("world/walls", rr.Boxes3D(**walls, **look))  # transparent
        path = _lifted(recording.path, _FLOOR_M)
        self._still("world/path", rr.LineStrips3D([path], radii=_LINE_M, colors=_rgba(GRAY)))
        goal = rr.Cylinders3D(
            centers=_lifted(recording.goal[None], _FLOOR_M),
            lengths=2 * _FLOOR_M,
            radii=recording.goal_radius,
            colors=_rgba(GREEN),
            fill_mode="solid",
        )
        self._still("world/goal", goal)

    def _pedestrians(self) -> None:
        boxes = self._recording.pedestrian_boxes
        present = np.isfinite(boxes[..., 0])
        look = {"colors": _rgba(ORANGE), "fill_mode": "solid"}
        self._still("world/pedestrians", self._rr.Boxes3D.from_fields(**look))
        columns = self._rr.Boxes3D.columns(**_upright(boxes[present], PEDESTRIAN_HEIGHT))
        self._moving("world/pedestrians", columns, present.sum(axis=1))

    def _robot(self) -> None:
        rr, pose, radius = self._rr, self._recording.pose, self._recording.robot_radius
        body = rr.Cylinders3D(
            centers=[[0.0, 0.0, 0.5 * ROBOT_HEIGHT]],
            lengths=ROBOT_HEIGHT,
            radii=radius,
            colors=_rgba(PURPLE),
            fill_mode="solid",
        )
        top, ahead = [[0.0, 0.0, ROBOT_HEIGHT]], [[2.0 * radius, 0.0, 0.0]]
        heading = rr.Arrows3D(origins=top, vectors=ahead, radii=_POINT_M, colors=_rgba(BLACK))
        self._still("world/robot/body", body)
        self._still("world/robot/heading", heading)
        place = rr.Transform3D.columns(
            translation=_lifted(pose[:, :2], 0.0), quaternion=_turned(pose[:, 2])
        )
        self._moving("world/robot", place)
        came = _lifted(pose[:, :2], _FLOOR_M)
        look = rr.LineStrips3D.from_fields(radii=_LINE_M, colors=_rgba(PURPLE))
        self._still("world/way", look)
        strips = [came[: step + 1] for step in range(len(came))]
        self._moving("world/way", rr.LineStrips3D.columns(strips=strips))

    def _scan(self) -> None:
        recording = self._recording
        local, returned = recording.scan_points()
        world = _lifted(_to_world(recording.pose, local), SCAN_HEIGHT)
        # Sectors divide the elements evenly and in order, as in navrl.networks.encoder.
        weights, count = recording.spatial_attention, local.shape[1]
        if weights is not None:
            weights = weights[:, np.arange(count) * weights.shape[1] // count]
        colors = _colors(recording, SPATIAL, weights, returned.shape, BLACK)
        self._still("world/scan", self._rr.Points3D.from_fields(radii=_POINT_M))
        columns = self._rr.Points3D.columns(positions=world[returned], colors=colors[returned])
        self._moving("world/scan", columns, returned.sum(axis=1))

    def _descriptors(self) -> None:
        recording = self._recording
        if recording.tagd is None:
            return
        real = np.ones(recording.tagd.shape[:2], dtype=bool)
        if recording.tagd_valid is not None:  # without two valid centroids there is no motion
            real = recording.tagd_valid.all(axis=-1)
        before, now = (
            _lifted(_to_world(recording.pose, half), SCAN_HEIGHT)
            for half in (recording.tagd[..., :2], recording.tagd[..., 2:])
        )
        colors = _colors(recording, TEMPORAL, recording.temporal_attention, real.shape, GREEN)
        self._still("world/tagd", self._rr.Arrows3D.from_fields(radii=_LINE_M))
        columns = self._rr.Arrows3D.columns(
            origins=before[real], vectors=(now - before)[real], colors=colors[real]
        )
        self._moving("world/tagd", columns, real.sum(axis=1))

    def _curves(self) -> None:
        v, w = forward_and_turn(self._recording).T
        self._curve("commands/v", "v in m/s", v, BLUE)
        self._curve("commands/w", "w in rad/s", w, VERMILLION)
        for i, (name, term) in enumerate(self._recording.reward_terms.items()):
            path = f"rewards/{self._rr.escape_entity_path_part(name)}"
            self._curve(path, name, term, CYCLE[i % len(CYCLE)])

    def _curve(self, path: str, name: str, values: np.ndarray, color: str) -> None:
        self._still(path, self._rr.SeriesLines(names=name, colors=_rgba(color)))
        self._moving(path, self._rr.Scalars.columns(scalars=values))

    def _still(self, path: str, entity: Any) -> None:
        self._stream.log(path, entity, static=True)

    def _moving(self, path: str, columns: Any, counts: Iterable[int] | None = None) -> None:
        """Send one row per step, with ``counts`` elements in each, one if ``None``."""
        if counts is not None:
            columns = columns.partition(counts)
        steps = np.arange(len(next(iter(columns)).as_arrow_array()))
        nanoseconds = np.rint(steps * self._recording.time_step_s * 1e9)
        time = nanoseconds.astype("timedelta64[ns]")
        rr = self._rr
        indexes = [rr.TimeColumn(STEP, sequence=steps), rr.TimeColumn(TIME, duration=time)]
        self._stream.send_columns(path, indexes, columns)


# --- geometry and colors ------------------------------------------------------------------------


def _upright(boxes: np.ndarray, height: float) -> dict[str, np.ndarray]:
    """Convert boxes ``[n, 5]`` (cx, cy, hx, hy, yaw) on the floor to rerun's arguments."""
    return {
        "centers": _lifted(boxes[:, :2], 0.5 * height),
        "half_sizes": _lifted(boxes[:, 2:4], 0.5 * height),
        "quaternions": _turned(boxes[:, 4]),
    }


def _lifted(points: np.ndarray, z: float) -> np.ndarray:
    """Append z to points ``[..., 2]``."""
    return np.concatenate([points, np.full((*points.shape[:-1], 1), z)], axis=-1)


def _turned(yaw: np.ndarray) -> np.ndarray:
    """Return quaternions ``[n, 4]`` (x, y, z, w) about z."""
    zero = np.zeros_like(yaw)
    return np.stack([zero, zero, np.sin(0.5 * yaw), np.cos(0.5 * yaw)], axis=-1)


def _to_world(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transform points ``[T + 1, n, 2]`` from robot frames ``[T + 1, 3]`` to the world frame."""
    cos, sin = np.cos(pose[:, 2, None]), np.sin(pose[:, 2, None])
    x, y = points[..., 0], points[..., 1]
    return pose[:, None, :2] + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _colors(
    recording: Recording,
    name: str,
    weights: np.ndarray | None,
    shape: tuple[int, ...],
    plain: str,
) -> np.ndarray:
    """Return colors ``[T + 1, n, 4]`` uint8 of ``weights [T, n]``, the last row ``plain``."""
    colors = np.broadcast_to(_rgba(plain), (*shape, 4)).copy()
    if weights is not None:
        share = np.clip(attention_scale(recording, name)(weights), 0.0, 1.0)
        colors[:-1] = ATTENTIONS[name](_MIN_INTENSITY + (1.0 - _MIN_INTENSITY) * share, bytes=True)
    return colors


def _rgba(color: str) -> np.ndarray:
    """Return a color as ``[1, 4]`` uint8."""
    return np.rint(255 * to_rgba_array(color)).astype(np.uint8)
