"""Generates the manual page and the shell completions of `cushion` from its parser.

`python -m tools.manual` compares the files in share/ with new ones; `--write` writes the files.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook import __version__
from audioflinger_hook.cli.parser import DESCRIPTION, EXIT_CODES, NEXT, build_parser
from audioflinger_hook.config.profiles import PROFILES

SHARE = Path(__file__).resolve().parents[1] / "share"


@dataclass(frozen=True)
class Option:
    """One option or positional argument of a command.

    flags: empty for a positional argument. words: allowed values, if the parser lists them.
    """

    flags: tuple[str, ...]
    metavar: str
    help: str
    words: tuple[str, ...]


@dataclass(frozen=True)
class Command:
    """One command with its options."""

    name: str
    help: str
    example: str
    options: tuple[Option, ...]

    @property
    def flags(self) -> tuple[str, ...]:
        """All flags of the command's options."""
        return tuple(flag for option in self.options for flag in option.flags)


def commands() -> tuple[Command, ...]:
    """Return all commands of the parser."""
    parser = build_parser()
    (found,) = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    helps = {action.dest: action.help or "" for action in found._choices_actions}
    made = []
    for name, command in found.choices.items():
        if command.add_options:
            command.add_options(command)
        options = tuple(map(_option, command._actions))
        example = (command.epilog or "").removeprefix("example: ")
        made.append(Command(name, helps[name], example, options))
    return tuple(made)


def _option(action: argparse.Action) -> Option:
    takes_none = action.nargs == 0
    metavar = "" if takes_none else str(action.metavar or action.dest.upper())
    words = tuple(map(str, action.choices or ()))
    if not words and "|" in metavar and metavar == metavar.lower():
        words = tuple(metavar.split("|"))
    if "--profile" in action.option_strings:
        more = ("speech-free",) if "speech-free" in (action.help or "") else ()
        words = (*PROFILES, *more)
    help_text = (action.help or "").replace("%%", "%")
    return Option(tuple(action.option_strings), metavar, help_text, words)


# ------------------------------------------------------------------------------- the manual page


def manual(known: tuple[Command, ...]) -> str:
    """Return the page for man(1)."""
    lines = [
        f'.TH CUSHION 1 "" "Haptic Cushion {__version__}" "User Commands"',
        ".SH NAME",
        "cushion \\- " + _roff(DESCRIPTION[0].lower() + DESCRIPTION[1:].rstrip(".")),
        ".SH SYNOPSIS",
        ".B cushion",
        ".I COMMAND",
        ".RI [ options ]",
        ".SH DESCRIPTION",
        _roff(DESCRIPTION),
        ".PP",
        _roff(NEXT[0].upper() + NEXT[1:] + "."),
        ".SH COMMANDS",
    ]
    for command in known:
        lines += [f".SS cushion {_roff(command.name)}", f"{_roff(_sentence(command.help))}"]
        for option in command.options:
            flags = ", ".join(f"\\fB{_roff(flag)}\\fR" for flag in option.flags)
            value = f"\\fI{_roff(option.metavar)}\\fR" if option.metavar else ""
            lines += [".TP", f"{flags} {value}".strip(), _roff(option.help)]
        lines += [".PP", "Example:", f".B {_roff(command.example)}"]
    _, _, codes = EXIT_CODES.partition(": ")
    lines.append(".SH EXIT STATUS")
    for one in codes.split("; "):
        code, _, meaning = one.partition(" ")
        if code.isdigit():
            lines += [".TP", f".B {code}", _roff(meaning)]
        else:
            lines[-1] += f"; {_roff(one)}"
    lines += [
        ".SH FILES",
        ".TP",
        ".I ~/.config/cushion/config.toml",
        "The settings; see",
        ".BR \\(dqcushion\\ check\\(dq .",
        ".SH ENVIRONMENT",
        ".TP",
        ".B PULSE_SERVER",
        "The sound server.",
        ".TP",
        ".B XDG_RUNTIME_DIR",
        "Where the lock and the socket of the daemon are.",
        ".TP",
        ".B XDG_CONFIG_HOME, XDG_STATE_HOME",
        "Where the settings and the state are.",
    ]
    return "\n".join(lines) + "\n"


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _roff(text: str) -> str:
    escaped = text.replace("\\", "\\e").replace("-", "\\-").replace("`", "\\(ga")
    return f"\\&{escaped}" if escaped.startswith((".", "'")) else escaped


# ------------------------------------------------------------------------------- the completions


def bash(known: tuple[Command, ...]) -> str:
    """Return the completion for bash."""
    names = " ".join(command.name for command in known)
    lines = [
        "# bash completion for cushion",
        "_cushion() {",
        '    local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} words=""',
        "    COMPREPLY=()",
        '    if [ "$COMP_CWORD" -eq 1 ]; then',
        f'        COMPREPLY=($(compgen -W "{names} --debug --help --version" -- "$word"))',
        "        return",
        "    fi",
        '    case "${COMP_WORDS[1]} $before" in',
    ]
    for command in known:
        for option in command.options:
            if option.flags and option.words:
                lines += [
                    f'        "{command.name} {option.flags[-1]}") '
                    f'words="{" ".join(option.words)}" ;;'
                ]
    lines += ["    esac", '    if [ -z "$words" ]; then', '        case "${COMP_WORDS[1]}" in']
    for command in known:
        arguments = [word for o in command.options if not o.flags for word in o.words]
        words = " ".join([*arguments, *command.flags])
        lines.append(f'            {command.name}) words="{words}" ;;')
    lines += [
        "        esac",
        "    fi",
        '    COMPREPLY=($(compgen -W "$words" -- "$word"))',
        "}",
        "complete -o default -o bashdefault -F _cushion cushion",
    ]
    return "\n".join(lines) + "\n"


def zsh(known: tuple[Command, ...]) -> str:
    """Return the completion for zsh."""
    lines = ["#compdef cushion", "_cushion() {", "    local -a commands", "    commands=("]
    lines += [f"        '{command.name}:{_plain(command.help)}'" for command in known]
    lines += [
        "    )",
        "    if (( CURRENT == 2 )); then",
        "        _describe command commands",
        "        return",
        "    fi",
        "    local command=$words[2]",
        "    shift words; (( CURRENT-- ))",
        "    case $command in",
    ]
    for command in known:
        lines.append(f"        {command.name})")
        lines.append("            _arguments \\")
        for option in command.options:
            for flag in option.flags:
                value = f":{option.metavar.replace(':', '-')}:{_values(option)}"
                value = value if option.metavar else ""
                lines.append(f"                '{flag}[{_plain(option.help)}]{value}' \\")
        words = next((o for o in command.options if not o.flags and o.words), None)
        first = f"'1:{words.metavar}:({' '.join(words.words)})' " if words else ""
        lines.append(f"                {first}'*:file:_files'")
        lines.append("            ;;")
    return "\n".join([*lines, "    esac", "}", '_cushion "$@"', ""])


def _values(option: Option) -> str:
    return f"({' '.join(option.words)})" if option.words else "_files"


def fish(known: tuple[Command, ...]) -> str:
    """Return the completion for fish."""
    lines = ["# fish completion for cushion"]
    for command in known:
        lines.append(
            f"complete -c cushion -n __fish_use_subcommand -f -a {command.name} "
            f"-d '{_plain(command.help)}'"
        )
        seen = f"complete -c cushion -n '__fish_seen_subcommand_from {command.name}'"
        for option in command.options:
            for flag in option.flags:
                kind = f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}"
                value = " -r" if option.metavar else ""
                value += f" -f -a '{' '.join(option.words)}'" if option.words else ""
                lines.append(f"{seen} {kind}{value} -d '{_plain(option.help)}'")
            if not option.flags and option.words:
                lines.append(f"{seen} -f -a '{' '.join(option.words)}'")
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    return text.translate({ord(sign): None for sign in "'[]\\`$\""}).replace(":", " -")


def files() -> dict[Path, str]:
    """Return the new texts of the generated files by path, relative to `SHARE`."""
    known = commands()
    return {
        Path("man/man1/cushion.1"): manual(known),
        Path("bash-completion/completions/cushion"): bash(known),
        Path("zsh/site-functions/_cushion"): zsh(known),
        Path("fish/vendor_completions.d/cushion.fish"): fish(known),
    }


def main() -> int:
    """Compare or write the files. Return 1 if a compared file differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write the files")
    options = parser.parse_args()
    different = 0
    for name, text in files().items():
        path = SHARE / name
        if options.write:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        elif not path.exists() or path.read_text() != text:
            print(f"{path} is out of date; run: python -m tools.manual --write", file=sys.stderr)
            different = 1
    return different


if __name__ == "__main__":
    sys.exit(main())
