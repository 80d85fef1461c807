"""Stills, strips and GIFs of an episode."""

import json

import numpy as np
import pytest
from PIL import Image

from navrl.viz import save_gif, save_png, save_strip, save_tagd
from navrl.viz.animation import episode_name, render_frames
from navrl.viz.gif import write_gif


def test_gif_shows_every_step_at_its_time(tmp_path, recording):
    image = Image.open(save_gif(recording, tmp_path / "deep" / "episode.gif"))
    durations = []
    for frame in range(image.n_frames):
        image.seek(frame)
        durations.append(image.info["duration"])
    assert image.n_frames == recording.num_steps + 1
    assert image.width == 480
    assert durations[:-1] == [200] * recording.num_steps
    assert durations[-1] > 1000
    assert image.info["loop"] == 0


def test_gif_stays_small(tmp_path, recording):
    size = save_gif(recording, tmp_path / "episode.gif", fps=10).stat().st_size
    assert size < 3e6 * (recording.num_steps + 1) / 151


def test_gif_frames_differ_and_have_flat_colors(tmp_path):
    frames = np.full((3, 8, 8, 3), 255, dtype=np.uint8)
    for i, color in enumerate([(0, 114, 178), (213, 94, 0), (0, 158, 115)]):
        frames[i, :4] = color
    image = Image.open(write_gif(list(frames), tmp_path / "flat.gif", 0.1))
    for i, frame in enumerate(frames):
        image.seek(i)
        assert np.array_equal(np.asarray(image.convert("RGB")), frame)


@pytest.mark.parametrize("step", [None, -1])
def test_png(tmp_path, recording, step):
    step = recording.num_steps if step == -1 else step
    picture = np.asarray(
        Image.open(save_png(recording, tmp_path / "moment.png", step)).convert("L")
    )
    assert (picture[[0, -1]] == 255).all()  # nothing runs over the border
    assert (picture[:, [0, -1]] == 255).all()
    assert (picture < 128).mean() > 0.005


def test_equal_pictures_have_equal_bytes(tmp_path, recording):
    first = save_png(recording, tmp_path / "first.svg", 0)
    second = save_png(recording, tmp_path / "second.svg", 0)
    assert first.read_bytes() == second.read_bytes()


def test_strip(tmp_path, recording):
    text = save_strip(recording, tmp_path / "strip.svg", count=4).read_text()
    end = recording.num_steps * recording.time_step_s
    assert "t = 0.0 s" in text
    assert f"t = {end:.1f} s" in text
    assert "x in m" in text


def test_bad_arguments_are_named(tmp_path, recording):
    with pytest.raises(ValueError, match="fps=0"):
        save_gif(recording, tmp_path / "episode.gif", fps=0)
    with pytest.raises(ValueError, match=r"\.gif"):
        save_gif(recording, tmp_path / "episode.mp4")
    with pytest.raises(ValueError, match=r"\.png"):
        save_png(recording, tmp_path / "episode.bmp")
    with pytest.raises(ValueError, match="step=999"):
        save_png(recording, tmp_path / "episode.png", step=999)
    with pytest.raises(ValueError, match="count=1"):
        save_strip(recording, tmp_path / "strip.png", count=1)


def test_pictures_name_policy_suite_and_episode(recording, tmp_path):
    scenario = json.loads(recording.scenario)
    name = f"mine: {scenario['suite']} #{scenario['index']}, {scenario['kind']}"
    assert name in save_png(recording, tmp_path / "moment.svg", 0, "mine").read_text()
    assert name in save_tagd(recording, tmp_path / "tagd.svg", policy="mine").read_text()
    assert episode_name(recording) == name.removeprefix("mine: ")
    named, unnamed = (next(render_frames(recording, policy)) for policy in ("mine", None))
    assert named.shape == unnamed.shape
    rows = (named != unnamed).any(axis=(1, 2)).nonzero()[0]
    assert rows.min() > 0 and rows.max() < 25  # the headline is all that differs
