"""The command reference in docs/commands.md, from the parser of `cushion`."""

from __future__ import annotations

import argparse
import textwrap

from audioflinger_hook.cli.parser import COMMANDS, build_parser

USAGE_WIDTH = 96


def commands_reference() -> str:
    """Return a table of the commands, then usage, example and options of each."""
    rows = [f"| [`cushion {name}`](#cushion-{name}) | {COMMANDS[name][1]} |" for name in COMMANDS]
    parts = ["\n".join(["| command | does |", "| --- | --- |", *rows])]
    parts += [_command(name, *COMMANDS[name][1:]) for name in COMMANDS]
    return "\n\n".join(parts) + "\n"


def parser_of(name: str) -> argparse.ArgumentParser:
    """Return the parser of one command, with all its options."""
    found = next(
        action
        for action in build_parser()._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    parser: argparse.ArgumentParser = found.choices[name]
    add_options = getattr(parser, "add_options", None)
    if add_options is not None:
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
    """Return the usage as an indented block, the same on every terminal and Python."""
    positional = [action for action in parser._actions if not action.option_strings]
    names = " ".join(
        f"[{action.metavar}]" if action.nargs in ("?", "*") else str(action.metavar)
        for action in positional
    )
    if parser.usage:
        shown = [line.strip() for line in (parser.usage % {"prog": parser.prog}).splitlines()]
    else:
        required = [
            action for action in parser._actions if action.required and action.option_strings
        ]
        flags = " ".join(f"{action.option_strings[0]} {action.metavar}" for action in required)
        shown = [" ".join(f"{parser.prog} {flags} [options] {names}".split())]
    return [f"    {line}" for text in shown for line in textwrap.wrap(text, USAGE_WIDTH)]


def _row(action: argparse.Action) -> str:
    name = action.option_strings[0] if action.option_strings else str(action.metavar)
    if action.option_strings and action.nargs != 0:
        name = f"{name} {action.metavar}"
    shown = f"`{name}`"
    if "|" in name:  # in code, a forge and the site's generator read a bar in a table differently
        shown = f"<code>{name.replace('|', '&#124;')}</code>"
    meaning = str(action.help).replace("|", "\\|")
    return f"| {shown} | {meaning} |"
