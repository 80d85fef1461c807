"""Evaluations made by hand, as ``navrl-evaluate`` would have left them."""

import csv
import json

from navrl.evaluation import wilson_interval


def write_evaluation(
    folder, policy, outcomes, *, time_to_goal_s=None, delay=0.0, columns=(), **changes
):
    """Write the two files for episodes with these outcomes; ``changes`` go into the summary.

    Episode i takes 10 + i s and ``delay``; ``time_to_goal_s="{time}"`` writes that column too,
    and as many m of path, also of the episodes that were lost. ``columns`` are more of them, by
    name, a cell an episode.
    """
    folder.mkdir(parents=True)
    rows = [
        {"index": i, "scenario": "corridor", "outcome": outcome, "time_s": f"{10 + i + delay}"}
        for i, outcome in enumerate(outcomes)
    ]
    if time_to_goal_s is not None:
        for row in rows:
            row["path_length_m"] = row["time_s"]
            won = row["outcome"] == "success"
            row["time_to_goal_s"] = time_to_goal_s.format(time=row["time_s"]) if won else ""
    for name, cells in dict(columns).items():
        for row, cell in zip(rows, cells, strict=True):
            row[name] = cell
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    total = len(outcomes)
    rate = {
        name: sum(outcome.startswith(name) for outcome in outcomes) / total
        for name in ("success", "collision", "timeout")
    }
    times = [10.0 + i for i, outcome in enumerate(outcomes) if outcome == "success"]
    summary = {
        "policy": policy,
        "suite": "table1",
        "suite_hash": "abc",
        "simulator": "BatchedSimulator",
        "episodes": total,
        "errors": outcomes.count("error"),
        "navigation_time_s": sum(times) / len(times) if times else None,
        **{f"{name}_rate": value for name, value in rate.items()},
        "success_interval": wilson_interval(outcomes.count("success"), total),
        **changes,
    }
    (folder / "summary.json").write_text(json.dumps(summary))


WON, HIT, LATE = "success", "collision_pedestrian", "timeout"
