"""``fame completion``: a script with which a shell completes commands, options and their choices."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator

from fame.cli.arguments import Commands, Parser, command

_BASH = r"""_fame_words() {
  case "$1" in
CASES
  esac
}
_fame() {
  local at=fame word words= now=${COMP_WORDS[COMP_CWORD]}
  for word in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do
    at=${at% -*}
    if [ -n "$(_fame_words "$at $word")" ]; then at="$at $word"; fi
  done
  for word in $(_fame_words "$at"); do
    case "$now/$word" in -*|*/[!-]*) words="$words $word" ;; esac
  done
  COMPREPLY=($(compgen -W "$words" -- "$now"))
}
complete -o default -F _fame fame
"""
_FISH = r"""function __fame_words
  switch "$argv[1]"
CASES
  end
end
function __fame_complete
  set -l at fame
  set -l now (commandline -ct)
  set -l before (commandline -opc)
  set -e before[1]
  for word in $before
    set at (string replace -r ' -.*$' '' -- "$at")
    set -l found (__fame_words "$at $word")
    set -q found[1]; and set at "$at $word"
  end
  for word in (__fame_words "$at" | string split -n ' ')
    if string match -q -- '-*' "$now"; or not string match -q -- '-*' "$word"
      echo $word
    end
  end
end
complete -c fame -a '(__fame_complete)'
"""
_SHELLS = {
    "bash": (_BASH, "    '{}') echo '{}' ;;"),
    "zsh": (f"autoload -U +X bashcompinit && bashcompinit\n{_BASH}", "    '{}') echo '{}' ;;"),
    "fish": (_FISH, "    case '{}'\n      echo '{}'"),
}
"""The script of each shell, and one case of it: words before the cursor, and what may come next."""


def add(commands: Commands) -> None:
    parser = command(
        commands, "completion", run, help="print a script that completes the command line in bash, zsh or fish",
        examples=("fame completion bash > ~/.local/share/bash-completion/completions/fame",
                  "fame completion zsh > ~/.fame.zsh; echo 'source ~/.fame.zsh' >> ~/.zshrc",
                  "fame completion fish > ~/.config/fish/completions/fame.fish"),
    )  # fmt: skip
    parser.add_argument("shell", choices=tuple(_SHELLS))


def run(arguments: Namespace) -> int:
    from fame.cli import parser

    script, case = _SHELLS[arguments.shell]
    print(script.replace("CASES", "\n".join(case.format(*row) for row in _table(parser(), "fame"))), end="")
    return 0


def _table(parser: Parser, before: str) -> Iterator[tuple[str, str]]:
    """What may come after the words of a command line; a space where a value of any kind comes."""
    words: list[str] = []
    for action in parser.arguments:
        if isinstance(action.choices, dict):
            for name, part in action.choices.items():
                yield from _table(part, f"{before} {name}")
        if action.option_strings and action.nargs != 0:
            for option in action.option_strings:
                yield f"{before} {option}", " ".join(map(str, action.choices or " "))
        words += action.option_strings or map(str, action.choices or ())
    yield before, " ".join(words)
