"""Generates the command reference in docs/commands.md from the parser of `cushion`."""

import argparse
import textwrap

from audioflinger_hook.cli.parser import COMMANDS, build_parser

USAGE_WIDTH = 96


def commands_reference() -> str:
    """Return a table of the commands, then usage, example and options of each command."""
    rows = [f"| [`cushion {name}`](#cushion-{name}) | {COMMANDS[name][1]} |" for name in COMMANDS]
    parts = ["\n".join(["| command | does |", "| --- | --- |", *rows])]
    parts += [_command(name, *COMMANDS[name][1:]) for name in COMMANDS]
    return "\n\n".join(parts) + "\n"


def parser_of(name: str) -> argparse.ArgumentParser:
    """Return the parser of one command with all options."""
    actions = build_parser()._actions
    found = next(one for one in actions if isinstance(one, argparse._SubParsersAction))
    parser: argparse.ArgumentParser = found.choices[name]
    if add_options := getattr(parser, "add_options", None):
        parser.add_options = None  # type: ignore[attr-defined]
        add_options(parser)
    return parser


def _command(name: str, does: str, example: str) -> str:
    parser = parser_of(name)
    rows = [_row(action) for action in parser._actions if action.dest not in ("help", "debug")]
    lines = [f"## cushion {name}", "", f"{does[0].upper()}{does[1:]}.", "", *_usage(parser), ""]
    lines += [f"Example: `{' '.join(f'cushion {name} {example}'.split())}`"]
    if rows:
        lines += ["", "| argument | meaning |", "| --- | --- |", *rows]
    return "\n".join(lines)


def _usage(parser: argparse.ArgumentParser) -> list[str]:
    """Return the usage as indented lines, the same for all terminals and versions of Python."""
    positional = [action for action in parser._actions if not action.option_strings]
    names = " ".join(
        f"[{action.metavar}]" if action.nargs in ("?", "*") else str(action.metavar)
        for action in positional
    )
    if parser.usage:
        shown = [line.strip() for line in (parser.usage % {"prog": parser.prog}).splitlines()]
    else:
        required = (one for one in parser._actions if one.required and one.option_strings)
        flags = " ".join(f"{action.option_strings[0]} {action.metavar}" for action in required)
        shown = [" ".join(f"{parser.prog} {flags} [options] {names}".split())]
    return [f"    {line}" for text in shown for line in textwrap.wrap(text, USAGE_WIDTH)]


def _row(action: argparse.Action) -> str:
    name = action.option_strings[0] if action.option_strings else str(action.metavar)
    if action.option_strings and action.nargs != 0:
        name = f"{name} {action.metavar}"
    shown = f"`{name}`"
    if "|" in name:  # Markdown renderers disagree on a bar within code in a table
        shown = f"<code>{name.replace('|', '&#124;')}</code>"
    meaning = str(action.help).replace("|", "\\|")
    return f"| {shown} | {meaning} |"
