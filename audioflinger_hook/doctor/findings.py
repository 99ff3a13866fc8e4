"""Finds everything that is wrong with a set-up, from its facts. No I/O."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from audioflinger_hook.doctor import program_rules, sound_rules
from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.doctor.finding import Finding

Rule = Callable[[Facts], Iterator[Finding]]

RULES: tuple[Rule, ...] = (
    sound_rules.server_answers,
    sound_rules.server_is_pipewire,
    program_rules.config,
    program_rules.folders,
    program_rules.plugin,
    sound_rules.default_sink,
    sound_rules.device,
    sound_rules.levels,
    sound_rules.rates,
    program_rules.priority,
    program_rules.one_daemon,
    program_rules.daemon_state,
    sound_rules.delay,
)


def find(facts: Facts) -> list[Finding]:
    """Return all findings, causes before their effects."""
    return [finding for rule in RULES for finding in rule(facts)]
