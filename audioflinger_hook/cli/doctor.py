"""`cushion doctor`: says what is wrong with this set-up and what to do; can repair some of it."""

import argparse
import getpass
import json
import os
import platform
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from audioflinger_hook.cli.check import find_mistakes
from audioflinger_hook.doctor.checks import Finding, find
from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.doctor.gather import gather
from audioflinger_hook.doctor.measurement import measure
from audioflinger_hook.doctor.repair import repair
from audioflinger_hook.doctor.report import Person, facts_text, findings_text, full_report
from audioflinger_hook.service.json_codec import to_json
from device.atomic_file import write_bytes_atomically
from device.stream import filter_stderr

EXIT_FINDINGS = 1


@dataclass(frozen=True)
class Document:
    """The document of `--json`."""

    findings: list[Finding]
    repaired: list[str]
    facts: Facts


def run(options: argparse.Namespace) -> int:
    """Print findings and facts. Exit code 0: nothing is wrong; 1: there are findings."""
    if not options.debug:
        filter_stderr()
    facts, repaired = _facts(), list[str]()
    findings = find(facts)
    if options.fix and (due := [one for one in findings if one.repair]):
        repaired = [repair(one, facts, os.environ) for one in due]
        facts = _facts()
    if options.measure:
        facts = replace(facts, delay=measure(facts))
    findings = find(facts)
    if options.report is not None:
        text = full_report(facts, findings, repaired, _person())
        write_bytes_atomically(options.report, text.encode("utf-8", "replace"))
    if options.json:
        print(json.dumps(json.loads(to_json(Document(findings, repaired, facts))), indent=2))
    else:
        print(findings_text(findings, repaired), facts_text(facts), sep="\n\n")
    return EXIT_FINDINGS if findings else 0


def _facts() -> Facts:
    return gather(os.environ, time.monotonic, find_mistakes)


def _person() -> Person:
    user = ""
    with suppress(KeyError, OSError):  # in a container the user may have no name
        user = getpass.getuser()
    return Person(user, str(Path("~").expanduser()), platform.node())
