"""A run becomes a bundle whose card says where it comes from and what it is worth."""

import csv
import json
import shutil

import pytest
import torch

from navrl.cli.publish import main
from navrl.jobs.inputs import bundle_files, policy_hash
from navrl.jobs.publishing import CURVE
from navrl.policies import ZOO, load_bundle

COLUMNS = ("frames", "updates", "evaluation/success_rate", "evaluation/timeout_rate")


@pytest.fixture
def run(tmp_path):
    """A run's folder as navrl-train leaves it, around a policy of the zoo."""
    folder = tmp_path / "run"
    shutil.copytree(ZOO / "paper", folder / "policy")
    (folder / ".hydra").mkdir()
    overrides = "- experiment=paper\n- seed=3\n- hydra.run.dir=somewhere\n- resume=elsewhere\n"
    (folder / ".hydra" / "overrides.yaml").write_text(overrides)
    (folder / "commands.txt").write_text(
        "navrl-train seed=3  # 2026-01-02 03:04 UTC, navrl 0.1.0 at commit abc, riscv, 2 cores\n"
    )
    with (folder / "metrics.csv").open("w") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for update in range(0, 4600, 200):
            success = update / 5000 if update % 400 == 0 else ""
            writer.writerow([32 * update, update, success, 0.0])
    return folder


@pytest.fixture
def evaluation(tmp_path):
    folder = tmp_path / "evaluation"
    folder.mkdir()
    rates = {"success": 0.9, "collision": 0.1, "timeout": 0.0}
    summary = {"policy": "mine", "suite": "table1", "suite_hash": "0123456789abcdef"}
    summary |= {"simulator": "BulletSimulator", "episodes": 50, "navigation_time_s": 8.25}
    for name, rate in rates.items():
        summary |= {f"{name}_rate": rate, f"{name}_interval": [rate / 2, rate / 2 + 0.5]}
    (folder / "summary.json").write_text(json.dumps(summary))
    (folder / "episodes.csv").write_text("index,outcome\n")
    return folder


def test_card_and_curve(run, evaluation, tmp_path, capsys):
    out = tmp_path / "mine"
    about = "A policy of ours."
    main([str(run), str(out), "--evaluations", str(evaluation), "--about", about])
    assert f"navrl-evaluate policy={out}" in capsys.readouterr().out
    card = (out / "card.md").read_text()
    assert card.startswith("# mine\n\nA policy of ours. 147,948 parameters an actor.")
    assert "navrl-train experiment=paper seed=3\n" in card
    assert "2026-01-02 03:04 UTC, navrl 0.1.0 at commit abc, riscv, 2 cores" in card
    row = (
        "| table1 | 0123456789ab | BulletSimulator | 50 | 90.0 % [45.0, 95.0] | 10.0 % [5.0, 55.0]"
    )
    assert row in card
    assert "| 140,800 | 4,400 | - | 88.0 % | - | - | 0.0 % |" in card  # the last, never left out
    assert card.count(" | - | - | 0.0 % |") <= 10
    with (out / CURVE).open() as file:
        rows = list(csv.DictReader(file))
    assert [row["updates"] for row in rows] == [str(n) for n in range(0, 4600, 400)]


def test_card_lists_commands_versions_and_seed(run, evaluation, tmp_path):
    (run / "config.yaml").write_text("seed: 3\nnum_threads: 1\ndevice: cpu\n")
    (run / "commands.txt").write_text(
        "navrl-train seed=3  # 2026-01-02 03:04 UTC, navrl 0.1.0 at commit abc, riscv, 2 cores\n"
        "navrl-train resume=x  # 2026-01-03 03:04 UTC, navrl 0.1.0 at commit def-dirty, riscv\n"
    )
    (evaluation / ".hydra").mkdir()
    words = ["policy=outputs/x", "suite=table1", "simulator=bullet", "num_processes=4"]
    (evaluation / ".hydra" / "overrides.yaml").write_text("".join(f"- {w}\n" for w in words))
    out = tmp_path / "mine"
    main([str(run), str(out), "--evaluations", str(evaluation)])
    card = (out / "card.md").read_text()
    section = card[card.index("To repeat:") :]
    assert "code, packages and machine: 2026-01-03 03:04 UTC, navrl 0.1.0 at commit def" in section
    assert "changes that are not part of that commit" in section
    assert "resumed 1 times" in section and "seed 3, device cpu, threads 1" in section
    assert "navrl-evaluate policy=mine suite=table1 simulator=bullet\n" in section
    assert (out / "run.yaml").read_text() == (run / "config.yaml").read_text()


def test_published_weights_equal_the_runs(run, tmp_path):
    out = tmp_path / "mine"
    main([str(run), str(out)])
    before, after = load_bundle(run / "policy"), load_bundle(out)
    assert before.config == after.config
    assert before.metrics == after.metrics
    for name, value in before.actor.state_dict().items():
        assert torch.equal(value, after.actor.state_dict()[name])
    assert (out / "weights.safetensors").stat().st_mode & 0o444 == 0o444
    assert "Scores" not in (out / "card.md").read_text()


def test_policy_of_the_last_validation_is_published(run, tmp_path):
    shutil.copytree(ZOO / "no_tagd", run / "policy_last")
    out = tmp_path / "mine"
    main([str(run), str(out), "--last"])
    assert load_bundle(out).config == load_bundle(run / "policy_last").config
    assert "environment steps to this checkpoint, the last." in (out / "card.md").read_text()


@pytest.mark.parametrize("option", ["--last", "--half"])
def test_options_of_runs_are_rejected_for_bundles(option, tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["paper", str(tmp_path / "out"), "--steps", "shield", option])
    assert f"{option}: must not be used with --steps" in capsys.readouterr().err


def test_half_precision_weights_are_rounded_once(run, tmp_path):
    out = tmp_path / "mine"
    main([str(run), str(out), "--half"])
    before, after = (load_bundle(folder).actor.state_dict() for folder in (run / "policy", out))
    assert (out / "weights.safetensors").stat().st_size < 0.52 * 4 * 147_948
    for name, value in before.items():
        assert after[name].dtype == torch.float32
        assert torch.equal(value.half().float(), after[name])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda run: shutil.rmtree(run / "policy"), "config.yaml: no such file"),
        (lambda run: (run / "metrics.csv").unlink(), "metrics.csv"),
        (lambda run: (run / "policy" / "metrics.json").write_text("{}"), "metrics.json"),
        (
            lambda run: (run / "policy" / "metrics.json").write_text('{"seconds": "long"}'),
            "metrics.json",
        ),
        (
            lambda run: (run / "metrics.csv").write_text(
                "frames,evaluation/success_rate\n1,many\n"
            ),
            "metrics.csv",
        ),
        (lambda run: (run / ".hydra" / "overrides.yaml").write_text("- ["), "overrides.yaml"),
    ],
)
def test_missing_files_are_named(run, tmp_path, capsys, spoil, message):
    spoil(run)
    with pytest.raises(SystemExit) as stop:
        main([str(run), str(tmp_path / "mine")])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "mine").exists()


def test_a_folder_without_evaluation_is_named(run, tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(run), str(tmp_path / "mine"), "--evaluations", str(run)])
    assert "no evaluation there" in capsys.readouterr().err


def test_scores_of_another_policy_are_rejected(run, evaluation, tmp_path, capsys):
    """By the hash of weights and configuration; older evaluations have none."""
    own = policy_hash(bundle_files(run / "policy"))
    summary = json.loads((evaluation / "summary.json").read_text())
    for added, status in (({"policy_hash": own}, 0), ({"policy_hash": "other"}, 2)):
        (evaluation / "summary.json").write_text(json.dumps(summary | added))
        arguments = [str(run), str(tmp_path / f"out_{status}"), "--evaluations", str(evaluation)]
        if status == 0:
            main(arguments)
            continue
        with pytest.raises(SystemExit) as end:
            main(arguments)
        line = capsys.readouterr().err
        assert end.value.code == status and "of another policy, mine; must be of" in line
        assert not (tmp_path / "out_2").exists()
