"""``fame adm``: the anomaly detection module. Each of its parts is a module here."""

from __future__ import annotations

from fame.cli.adm import collect, labelled_files, learn, operate
from fame.cli.arguments import Commands, group

_EXAMPLES = (
    "fame adm collect --label 1 --runs 30 -o benign.csv",
    "fame adm learn examples/adm_learn.yaml -o best.skops",
    "fame adm envelope benign.csv --tolerance 1 -o outside.csv",
    "fame adm operate --model best.skops --threshold 0.01",
)


def add(commands: Commands) -> None:
    """Declare the command and its parts."""
    parser = group(
        commands, "adm", examples=_EXAMPLES,
        help="learn what a repetitive task looks like, and raise an alarm when a run leaves it",
    )  # fmt: skip
    parts = parser.add_subparsers(metavar="PART", required=True)
    for part in (collect, learn, operate, labelled_files):
        part.add(parts)
