"""`cushion doctor`: shows the faults of this set-up, with advice; can repair some of them."""

import argparse
import getpass
import json
import os
import platform
import time
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

from audioflinger_hook.doctor.checks import find
from audioflinger_hook.doctor.measurement import measure
from audioflinger_hook.doctor.reading import read_facts
from audioflinger_hook.doctor.repair import REPAIRS, repair
from audioflinger_hook.doctor.report import facts_text, findings_text, full_report, rows
from device.atomic_file import write_bytes_atomically
from device.stream import filter_stderr


def run(options: argparse.Namespace) -> int:
    """Print findings and facts. Exit code 0: nothing is wrong; 1: there are findings."""
    if not options.debug:
        filter_stderr()
    facts = read_facts(os.environ, time.monotonic)
    repaired = list[str]()
    if options.fix and (due := [one for one in find(facts) if one.name in REPAIRS]):
        repaired = [repair(one.name, facts, os.environ) for one in due]
        facts = read_facts(os.environ, time.monotonic)
    if options.measure:
        facts = replace(facts, delay=measure(facts))
    findings = find(facts)
    if options.json:
        told = [{"label": label, "text": text} for label, text in rows(facts)]
        shown = {"findings": [asdict(one) for one in findings], "repaired": repaired}
        delay = asdict(facts.delay) if facts.delay else None
        print(json.dumps({**shown, "delay": delay, "facts": told}, indent=2))
    else:
        print(findings_text(findings, repaired), facts_text(facts), sep="\n\n")
    if options.report is not None:  # last, because this may fail
        person = [str(Path("~").expanduser()), platform.node()]
        with suppress(KeyError, OSError):  # in a container the user may have no name
            person.append(getpass.getuser())
        text = full_report(facts, findings, repaired, person)
        write_bytes_atomically(options.report, text.encode("utf-8", "replace"))
    return 1 if findings else 0
