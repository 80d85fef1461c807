"""Policies of other processes: protocol, timeouts and invalid answers."""

import json
import socket
import sys
import textwrap
import threading
import time

import pytest
import torch
from tensordict import TensorDict

from navrl.policies import RemotePolicy, RemotePolicyError
from navrl.sim import DifferentialDrive

ROBOT = DifferentialDrive(max_speed=1.0, max_turn_rate=2.0)
PROGRAM = """
    import json, sys, time
    for line in sys.stdin:
        message = json.loads(line)
        print(json.dumps(message), file=open({log!r}, "a"))
        if message["type"] == "hello":
            print(json.dumps({hello}), flush=True)
        elif message["type"] == "step":
            {answer}
"""
COMMANDS = "[[0.5, 1.0] for _ in message['observations']['pose']]"
ANSWER = f"print(json.dumps({{'action': {COMMANDS}}}), flush=True)"


@pytest.fixture
def start(tmp_path):
    """Start a policy of a program; return it and a function that reads what it was sent."""
    started = []

    def make(answer=ANSWER, hello='{"observes": ["pose"]}', **options):
        file, log = tmp_path / "policy.py", tmp_path / "sent"
        file.write_text(textwrap.dedent(PROGRAM).format(log=str(log), hello=hello, answer=answer))
        policy = RemotePolicy([sys.executable, str(file)], ROBOT, **options)
        started.append(policy)
        return policy, lambda: [json.loads(line) for line in log.read_text().splitlines()]

    yield make
    for policy in started:
        policy.close()


def observation(count=2):
    pose = torch.arange(3.0 * count).reshape(count, 3)
    return TensorDict({"pose": pose, "ranges": torch.ones(count, 4)}, [count])


def test_commands_become_normalized_actions(start):
    policy, sent = start()
    assert policy.prepare([object()] * 2) is None
    assert policy(observation())["action"].tolist() == [[0.0, 0.5]] * 2
    assert policy.in_keys == ["pose"] and not policy.privileged
    hello, reset, step = sent()
    assert hello == {
        **{"type": "hello", "protocol": "navrl-remote-1", "time_step_s": 0.2},
        **{"low": [0.0, -2.0], "high": [1.0, 2.0]},
    }
    assert reset == {"type": "reset", "worlds": 2}
    assert step["observations"] == {"pose": [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]}


def test_normalized_actions_are_clipped(start):
    hello = '{"observes": ["pose"], "action": "normalized"}'
    policy, _ = start('print(json.dumps({"action": [[0.25, 1.5]]}), flush=True)', hello)
    assert policy(observation(1))["action"].tolist() == [[0.25, 1.0]]


@pytest.mark.parametrize(
    "answer, message",
    [
        ("print('soon', flush=True)", "answer=b'soon': must be a JSON object in one line"),
        ("print('{}', flush=True)", r"action=None: must be finite numbers of shape \[2, 2\]"),
        ("print('{\"action\": [[1, 2], [1]]}', flush=True)", "must be finite numbers of shape"),
        ("print('{\"action\": [[1, 2]]}', flush=True)", "must be finite numbers of shape"),
        ("print('{\"action\": [[1, 2], [1, NaN]]}', flush=True)", "must be finite numbers"),
        ('print(\'{"error": "no map"}\', flush=True)', "policy.py: no map$"),
        ("sys.exit(3)", "the process ended with exit status 3; its messages are above"),
        ("time.sleep(9)", "no answer for timeout_s=0.3 s"),
    ],
)
def test_invalid_answers_end_the_connection(start, answer, message):
    policy, _ = start(answer, timeout_s=0.3)
    with pytest.raises(RemotePolicyError, match=message):
        policy(observation())
    begun = time.monotonic()
    with pytest.raises(RemotePolicyError, match=message):  # at once, and the same
        policy(observation())
    assert time.monotonic() - begun < 0.2


@pytest.mark.parametrize(
    "hello, message",
    [
        ("[1]", "must be a JSON object"),
        ("{}", "observes=None: must be a list of keys"),
        ('{"observes": ["pose"], "action": "degrees"}', "action='degrees': must be one of"),
    ],
)
def test_invalid_first_answers_are_named(start, hello, message):
    with pytest.raises(RemotePolicyError, match=message):
        start(hello=hello)


def test_key_that_is_not_observed_is_named(start):
    policy, _ = start(hello='{"observes": ["map"]}')
    with pytest.raises(RemotePolicyError, match="observes=map: is not observed; here are pose"):
        policy(observation())


def test_missing_command_is_named():
    with pytest.raises(RemotePolicyError, match="no_such_command: No such file"):
        RemotePolicy(["./no_such_command"], ROBOT)


def test_server_plays_over_tcp():
    listener = socket.create_server(("127.0.0.1", 0))

    def serve():
        connection, _ = listener.accept()
        with connection, connection.makefile("rw") as lines:
            for line in lines:
                kind = json.loads(line)["type"]
                answers = {"hello": {"observes": ["ranges"]}, "step": {"action": [[1.0, 0.0]]}}
                if kind in answers:
                    print(json.dumps(answers[kind]), file=lines, flush=True)

    thread = threading.Thread(target=serve)
    thread.start()
    port = listener.getsockname()[1]
    policy = RemotePolicy(f"tcp://127.0.0.1:{port}", ROBOT)
    assert policy(observation(1))["action"].tolist() == [[1.0, 0.0]]
    policy.close()
    thread.join(timeout=5)
    listener.close()
    assert not thread.is_alive()
    with pytest.raises(RemotePolicyError, match="Connection refused"):
        RemotePolicy(f"tcp://127.0.0.1:{port}", ROBOT)


@pytest.mark.parametrize("address", ["tcp://localhost", "tcp://:80", "http://localhost:80"])
def test_malformed_addresses_are_named(address):
    with pytest.raises(ValueError, match="must be tcp://HOST:PORT"):
        RemotePolicy(address, ROBOT)
