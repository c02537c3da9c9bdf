"""``fame keys``: keys that sign deployments, and identities that prove the names of robots."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from fame.cli.arguments import Commands, command
from fame.errors import ConfigError


def add(commands: Commands) -> None:
    """Declare the command."""
    parser = command(
        commands, "keys", run,
        examples=(
            "fame keys new team",
            "fame keys robot REX --key team.key",
            "fame keys diagram mission.bpmn --key team.key",
        ),
        help="make keys: of a team (new), which signs deployments; of a robot, which proves its name; sign a diagram",
    )  # fmt: skip
    parser.add_argument("action", choices=("new", "robot", "diagram"))
    parser.add_argument(
        "name", type=Path, metavar="NAME",
        help="path of the keys to make, without endings; for robot its name comes last; for diagram a model",
    )  # fmt: skip
    parser.add_argument("--key", type=Path, metavar="FILE.key", help="the key of the team; for robot and diagram")


def run(arguments: Namespace) -> int:
    """Make them and name them."""
    if arguments.action == "new":
        _new(arguments.name)
    elif arguments.key is None:
        raise ConfigError(f"fame keys {arguments.action} needs --key FILE.key, the key of the team")
    elif arguments.action == "robot":
        _robot(arguments.name, arguments.key)
    else:
        _diagram(arguments.name, arguments.key)
    return 0


def _new(name: Path) -> None:
    from fame.deploy.signing import new_keys

    secret, public = new_keys(name)
    print(f"{secret}   keep it secret: fame deploy MODEL.bpmn --key {secret}")
    print(f"{public}   give it to the robots: fame engine ROBOT --trust {public}")


def _robot(name: Path, key: Path) -> None:
    from fame.deploy.signing import new_identity, read_private

    path = name.with_name(name.name + ".key")
    new_identity(name.name, read_private(key), path)
    print(f"{path}   give it to robot {name.name} alone: fame engine {name.name} --trust FILE.pub --identity {path}")


def _diagram(model: Path, key: Path) -> None:
    import json
    import time

    from fame.bpmn.reader import read
    from fame.deploy.authentication import Diagram
    from fame.deploy.signing import read_private

    text = read(model).source.decode()
    said = Diagram.of(text, purpose="deploy", now=time.time(), key=read_private(key)).to_json()
    print(json.dumps({"data": said}))  # as `ros2 topic pub` takes it
