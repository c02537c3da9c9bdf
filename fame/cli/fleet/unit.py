"""``fame unit``: a systemd unit that runs a robot's engine."""

from __future__ import annotations

import getpass
import os
import re
import sys
from argparse import ArgumentTypeError, Namespace
from pathlib import Path

from fame.cli.arguments import Commands, command
from fame.cli.engine import add_options, check_options, safe_states
from fame.errors import ConfigError

_WATCHDOG = 30
"""Seconds without a sign of life after which systemd starts the engine again."""
_KEPT = ("ROS_", "RMW_", "FAME_LEASE", "CYCLONEDDS_", "ZENOH_", "AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONPATH")
"""Names, or their beginnings, of variables of the environment that an engine needs where systemd starts it."""
_KEEPING = ("state", "log")
"""Options with a folder that the engine makes and writes."""
_UNIT = """[Unit]
Description=FAME engine of {name}
Wants=network-online.target
After=network-online.target
StartLimitIntervalSec=0

[Service]
Type=notify
ExecStart={command}
WorkingDirectory={folder}
{lines}
Restart=on-failure
RestartSec=2
RestartPreventExitStatus=2 203 217
WatchdogSec={watchdog}
KillMode=mixed
TimeoutStopSec=20
{sandbox}
[Install]
WantedBy=multi-user.target
"""
"""Not started again: what FAME refuses, and a program or an account that is not there (systemd.exec(5))."""
_SANDBOX = """\
MemoryMax=50%
TasksMax=512
UMask=0027
NoNewPrivileges=yes
CapabilityBoundingSet=
ProtectSystem=strict
ProtectHome=read-only
ReadWritePaths=/tmp /var/tmp {written}
ProtectProc=invisible
ProtectClock=yes
ProtectHostname=yes
ProtectControlGroups=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
LockPersonality=yes
RemoveIPC=yes
DevicePolicy=closed
DeviceAllow=char-ttyUSB rw
DeviceAllow=char-ttyACM rw
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallFilter=~@privileged
SystemCallErrorNumber=EPERM
"""
"""systemd.exec(5). /tmp and shared memory are those of the machine: ROS 2 and DDS meet there. Serial lines are for the
processor `Machine`."""


def add(commands: Commands) -> None:
    parser = command(
        commands, "unit", run,
        examples=(
            "fame unit REX --type car | sudo tee /etc/systemd/system/fame-REX.service",
            "fame unit REX --type car --user robot --trust team.pub --state /var/lib/fame/REX --middleware zenoh",
        ),
        help="print a systemd unit that runs an engine, with the options of fame engine",
    )  # fmt: skip
    parser.add_argument(
        "--user", type=_account, metavar="NAME", help="the account that runs the engine (default: the current one)"
    )
    add_options(parser, here=False)


def run(arguments: Namespace) -> int:
    """Print the unit. Raises ConfigError for several engines, and for what a unit cannot contain."""
    if len(arguments.names) > 1:
        raise ConfigError("expected one robot: each engine has a unit of its own")
    (name,) = arguments.names
    check_options(arguments)
    if ":" not in (arguments.type or ":"):  # a class of one's own may be on the robot alone
        safe_states(arguments.type)
    if arguments.fresh:
        raise ConfigError("--fresh would start over after each crash: give it once, by fame engine")
    given = [(action, words) for action, words in arguments.leaf.given if action.dest != "user"]
    words = [word for action, values in given for word in (*action.option_strings[-1:], *values)]
    user = arguments.user or getpass.getuser()
    lines = [f"User={_escaped(user)}"]
    if arguments.state is None:
        lines.append("StateDirectory=fame")
        words += ["--state", f"/var/lib/fame/{name}"]
    kept = sorted((key, value) for key, value in os.environ.items() if key.startswith(_KEPT))
    lines += [f"Environment={_quoted(f'{key}={value}')}" for key, value in kept]
    run_by = " ".join(_quoted(word.replace("$", "$$")) for word in (sys.executable, "-m", "fame", "engine", *words))
    kept_in = [Path.cwd() / folder for key in _KEEPING if (folder := getattr(arguments, key)) is not None]
    if kept_in:  # the sandbox opens what is there; "+": outside of it
        folders = " ".join(_quoted(str(folder)).replace("$", "$$") for folder in kept_in)
        lines.append(f"ExecStartPre=+install --directory --mode=0700 --owner={_quoted(user)} {folders}")
    writes = [Path.cwd(), Path.cwd() / (arguments.files or ""), *kept_in]
    written = " ".join(_quoted(str(folder)) for folder in dict.fromkeys(writes))
    place, sandbox = _escaped(str(Path.cwd())), _SANDBOX.format(written=written)
    print(
        _UNIT.format(
            name=name, command=run_by, folder=place, lines="\n".join(lines), watchdog=_WATCHDOG, sandbox=sandbox
        ),
        end="",
    )
    return 0


def _account(text: str) -> str:
    """A name that systemd takes for an account, or a number. Raises ArgumentTypeError."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]*\$?|[0-9]+", text):
        raise ArgumentTypeError(f"expected the name of an account, got {text!r}")
    return text


def _escaped(text: str) -> str:
    """A value in which systemd replaces nothing (systemd.unit(5), specifiers)."""
    if not text.isprintable():
        raise ConfigError(f"expected text of one line, got {text!r}: a unit cannot contain it")
    return text.replace("%", "%%")


def _quoted(word: str) -> str:
    """A word of a command line (systemd.service(5)) or an assignment (systemd.exec(5), Environment=)."""
    text = _escaped(word).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{text}"' if not text or set(text) & set(" \t;'\"\\#") else text
