"""Loggers beside ``metrics.csv``: values, resuming, failures and videos."""

import json
import os
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from runs import tiny_trainer
from test_resume import rows
from torchrl.record.loggers import Logger

from navrl.config import compose
from navrl.factory.loggers import make_loggers
from navrl.training import loggers as package
from navrl.training.loggers import CSV, Loggers, TensorBoard, mirror

pytestmark = pytest.mark.filterwarnings("ignore")
SHORT = ["schedule.total_frames=200", "schedule.evaluate_every_updates=8"]


def events(folder):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    return EventAccumulator(str(folder), size_guidance={"images": 0}).Reload()


def gif(file):
    images = [Image.new("RGB", (6, 4), color) for color in ("red", "blue", "green")]
    images[0].save(file, save_all=True, append_images=images[1:])
    return file


class Recorded(Logger):
    """A TorchRL logger of a user, without ``log_gif``."""

    def __init__(self, fails=False):
        self.calls, self.fails = [], fails
        super().__init__("mine", ".")

    def _create_experiment(self):
        return SimpleNamespace()

    def log_scalar(self, name, value, step=None):
        if self.fails:
            raise ConnectionError("no route to host\nmore lines")
        self.calls.append((name, value, step))

    def log_video(self, name, video, step=None, **_):
        self.calls.append((name, tuple(video.shape), step))

    def log_hparams(self, cfg):
        self.calls.append(("hparams", cfg))

    def log_histogram(self, name, data, **_):
        raise NotImplementedError

    def __repr__(self):
        return "Recorded()"

    def open(self, folder, resume_frames):
        return self


def test_default_logger_is_tensorboard():
    cfg = compose("train")
    assert list(cfg.logger) == ["tensorboard"] and cfg.video_every_validations == 0
    (logger,) = make_loggers(cfg).values()
    assert isinstance(logger, TensorBoard)


def test_several_loggers_are_composed_in_order():
    assert list(compose("train", ["logger=[csv,tensorboard,wandb]"]).logger) == [
        *("csv", "tensorboard", "wandb")
    ]
    assert list(compose("train", ["+logger=csv"]).logger) == ["tensorboard", "csv"]
    assert make_loggers(compose("train", ["logger=none"])) == {}


@pytest.mark.parametrize("name", ["wandb", "mlflow", "trackio"])
def test_missing_package_names_the_extra(name, monkeypatch):
    monkeypatch.setattr("navrl.extras.find_spec", lambda module: None)
    cfg = compose("train", [f"logger={name}"])
    with pytest.raises(Exception, match=f"logger={name}: needs {name}.*install -e '.\\[{name}\\]"):
        make_loggers(cfg)


def test_values_reach_tensorboard_and_csv(tmp_path):
    opened = Loggers({"tensorboard": TensorBoard(), "csv": CSV()}, tmp_path, hparams={"a.b": 1})
    opened.log(100, {"train/success_rate": 0.25})
    opened.log_video("evaluation/episode", gif(tmp_path / "x.gif"), 100)
    opened.close()
    (scalar,) = events(tmp_path / "tensorboard").Scalars("train/success_rate")
    assert (scalar.step, scalar.value) == (100, 0.25)
    (image,) = events(tmp_path / "tensorboard").Images("evaluation/episode")
    assert (image.width, image.height, image.step) == (6, 4, 100)
    assert image.encoded_image_string == (tmp_path / "x.gif").read_bytes()
    csv = tmp_path / "csv"
    assert (csv / "scalars/train/success_rate.csv").read_text() == "100,0.25\n"
    assert (csv / "texts/hparams0.txt").read_text() == "a.b: 1"
    assert (csv / "videos/evaluation/episode_100.gif").is_file()


def test_resumed_loggers_drop_values_after_the_checkpoint(tmp_path):
    settings = {"tensorboard": TensorBoard(), "csv": CSV()}
    first = Loggers(settings, tmp_path)
    for frames in (10, 20, 30):
        first.log(frames, {"a": float(frames)})
    first.close()
    with (tmp_path / "csv/scalars/a.csv").open("a") as file:
        file.write("20,1")  # cut off by a kill
    again = Loggers(settings, tmp_path, resume_frames=20)
    again.log(30, {"a": 31.0})
    again.close()
    assert (tmp_path / "csv/scalars/a.csv").read_text() == "10,10.0\n20,20.0\n30,31.0\n"
    shown = [(x.step, x.value) for x in events(tmp_path / "tensorboard").Scalars("a")]
    assert shown == [(10, 10.0), (20, 20.0), (30, 31.0)]


def test_foreign_logger_receives_frames_of_the_video(tmp_path):
    mine = Recorded()
    opened = Loggers({"mine": mine}, tmp_path, hparams={"seed": 3})
    opened.log(5, {"a": 1.0})
    opened.log_video("drive", gif(tmp_path / "x.gif"), 5)
    assert mine.calls == [
        ("hparams", {"seed": 3}),
        ("a", 1.0, 5),
        ("drive", (1, 3, 3, 4, 6), 5),
    ]
    frames = mirror.gif_frames(tmp_path / "x.gif")
    colors = frames[0, :, :, 0, 0].int().numpy()
    assert np.abs(colors - [[255, 0, 0], [0, 0, 255], [0, 128, 0]]).max() <= 1


def test_failing_logger_is_reported_once_and_dropped(tmp_path, caplog):
    good = Recorded()
    opened = Loggers({"bad": Recorded(fails=True), "good": good}, tmp_path)
    opened.log(1, {"a": 1.0})
    opened.log(2, {"a": 2.0})
    assert [call[1] for call in good.calls] == [1.0, 2.0]
    (record,) = caplog.records
    assert record.getMessage().startswith(
        "logger.bad: not used any more (ConnectionError: no route to host); metrics.csv"
    )


def test_logger_that_cannot_open_is_one_error(tmp_path):
    broken = SimpleNamespace(open=lambda folder, resume_frames: 1 / 0)
    with pytest.raises(ValueError, match=r"logger.x: could not be opened \(ZeroDivisionError"):
        Loggers({"x": broken}, tmp_path)


@pytest.mark.slow
def test_training_mirrors_its_log_and_video(tmp_path):
    loggers = ["logger=[csv]", "video_every_validations=2"]
    trainer = tiny_trainer(tmp_path / "seen", [*SHORT, *loggers])
    trainer.run()
    plain = tiny_trainer(tmp_path / "plain", [*SHORT, "logger=none"])
    plain.run()
    assert rows(tmp_path / "seen") == rows(tmp_path / "plain")  # a video changes no number
    log = [row for row in rows(tmp_path / "seen") if row["evaluation/success_rate"]]
    scalars = (tmp_path / "seen/csv/scalars/evaluation/success_rate.csv").read_text().split()
    assert [line.split(",")[0] for line in scalars] == [row["frames"] for row in log]
    videos = sorted((tmp_path / "seen/videos").iterdir())
    assert [f"episode_{int(row['frames']):09d}.gif" for row in log[::2]] == [v.name for v in videos]
    assert "num_worlds: 4" in (tmp_path / "seen/csv/texts/hparams0.txt").read_text()
    assert not (tmp_path / "plain/tensorboard").exists()


def test_video_every_validations_is_checked(tmp_path):
    with pytest.raises(ValueError, match="video_every_validations=-1: must be an integer"):
        tiny_trainer(tmp_path, ["video_every_validations=-1"])


def test_wandb_offline_resumes_the_same_run(tmp_path):
    pytest.importorskip("wandb")
    settings = {"wandb": package.WandB("navrl", options={"settings": {"silent": True}})}
    for resume, frames in ((None, 10), (10, 20)):
        opened = Loggers(settings, tmp_path, resume, {"seed": 1})
        opened.log(frames, {"train/a": 0.5})
        opened.log_video("evaluation/episode", gif(tmp_path / "x.gif"), frames)
        opened.close()
    run = json.loads((tmp_path / "loggers.json").read_text())["wandb"]
    files = sorted((tmp_path / "wandb").glob(f"offline-run-*-{run}/run-{run}.wandb"))
    assert len(files) == 2 and "WANDB_MODE" not in os.environ
    assert len(list((tmp_path / "wandb").glob("offline*/files/media/videos/*/*.gif"))) == 2
    histories = [list(history(file)) for file in files]
    assert {"train/a": "0.5", "train/step": "10"}.items() <= histories[0][0].items()
    assert {"train/a": "0.5", "train/step": "20"}.items() <= histories[1][0].items()


def history(file):
    """Yield the rows of an offline run of W&B, a file in the format of LevelDB's log."""
    from wandb.proto import wandb_internal_pb2

    content, place, data = file.read_bytes(), 7, b""  # after the header
    while place < len(content):
        if place % 32768 > 32768 - 7:  # no record begins in the last bytes of a block
            place += 32768 - place % 32768
        size, kind = int.from_bytes(content[place + 4 : place + 6], "little"), content[place + 6]
        data = (b"" if kind in (1, 2) else data) + content[place + 7 : place + 7 + size]
        place += 7 + size
        if kind in (1, 4):  # whole, or the last part
            record = wandb_internal_pb2.Record()
            record.ParseFromString(data)
            if items := record.history.item:
                yield {x.key or "/".join(x.nested_key): x.value_json for x in items}


def test_wandb_mode_is_checked(monkeypatch):
    monkeypatch.setattr("navrl.extras.find_spec", lambda module: True)
    with pytest.raises(ValueError, match="mode=off: must be offline or online"):
        package.WandB("navrl", mode="off")


def test_mlflow_resumes_the_same_run(tmp_path):
    mlflow = pytest.importorskip("mlflow")
    settings = {"mlflow": package.MLflow("navrl")}
    run = tmp_path / "runs" / "seed_0"
    run.mkdir(parents=True)
    for resume, frames in ((None, 10), (10, 20)):
        opened = Loggers(settings, run, resume, {"seed": 1, "scenario.worlds": ["corridor"]})
        opened.log(frames, {"train/a": frames / 10})
        opened.log_video("evaluation/episode", gif(run / "x.gif"), frames)
        opened.close()
    client = mlflow.MlflowClient(f"sqlite:///{tmp_path / 'runs' / 'mlflow.db'}")
    (found,) = client.search_runs([client.get_experiment_by_name("navrl").experiment_id])
    assert found.info.run_id == json.loads((run / "loggers.json").read_text())["mlflow"]
    assert found.info.run_name == "seed_0" and found.info.status == "FINISHED"
    assert found.data.params["seed"] == "1"
    points = client.get_metric_history(found.info.run_id, "train/a")
    assert [(point.step, point.value) for point in points] == [(10, 1.0), (20, 2.0)]
    (video,) = client.list_artifacts(found.info.run_id, "videos/evaluation/episode")
    assert video.path.endswith("x.gif")


def test_trackio_resumes_the_same_run(tmp_path, monkeypatch):
    pytest.importorskip("trackio")
    from trackio import utils
    from trackio.sqlite_storage import SQLiteStorage

    monkeypatch.setattr(utils, "TRACKIO_DIR", tmp_path / "trackio")
    for module in [m for name, m in sys.modules.items() if name.startswith("trackio")]:
        if hasattr(module, "TRACKIO_DIR"):
            monkeypatch.setattr(module, "TRACKIO_DIR", tmp_path / "trackio")
    settings = {"trackio": package.Trackio("navrl")}
    for resume, frames in ((None, 10), (10, 20)):
        opened = Loggers(settings, tmp_path, resume, {"seed": 1})
        opened.log(frames, {"train/a": 0.5, "train/b": 1.0})
        opened.log_video("evaluation/episode", gif(tmp_path / "x.gif"), frames)
        opened.close()
    (run,) = SQLiteStorage.get_runs("navrl")
    assert run.startswith(tmp_path.name)
    logged = [row for row in SQLiteStorage.get_logs("navrl", run) if "train/a" in row]
    assert [(row["step"], row["train/a"], row["train/b"]) for row in logged] == [
        (10, 0.5, 1.0),
        (20, 0.5, 1.0),
    ]
