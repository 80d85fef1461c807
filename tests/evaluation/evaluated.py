"""Evaluations made by hand, as ``navrl-evaluate`` would have left them."""

import csv
import json

from navrl.evaluation import wilson_interval


def write_evaluation(folder, policy, outcomes, delay_s=None, **changes):
    """Write the two files for episodes with these outcomes; ``changes`` go into the summary."""
    folder.mkdir(parents=True)
    times = [10.0 + i + (delay_s[i] if delay_s else 0.0) for i in range(len(outcomes))]
    rows = [
        {"index": i, "scenario": "corridor", "outcome": outcome, "time_s": f"{time:.6f}"}
        for i, (outcome, time) in enumerate(zip(outcomes, times, strict=True))
    ]
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    total = len(outcomes)
    rate = {
        name: sum(outcome.startswith(name) for outcome in outcomes) / total
        for name in ("success", "collision", "timeout")
    }
    times = [time for time, outcome in zip(times, outcomes, strict=True) if outcome == "success"]
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
