"""Rules of the config that choose profile and gain by the application that plays."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from audioflinger_hook.config.profiles import PROFILES
from device.drive.settings import GAIN_MAX_DB, GAIN_MIN_DB
from device.errors import UsageError
from device.server.app_rules import Rule
from device.values import Choice, Described, Number, Refusal, Switch, Text


@dataclass(frozen=True)
class Pattern(Text):
    """A pattern that matches an application's name or binary."""

    def refuse(self, value: object) -> Refusal | None:
        """Return why the value is no pattern; None if it is allowed."""
        if not isinstance(value, str):
            return Refusal("is not a pattern", self.allowed)
        try:
            Rule.parse(value)
        except UsageError:
            return Refusal("is not a pattern", self.allowed)
        if "[" in re.sub(r"\[!?+.[^]]*\]", "", value):
            return Refusal("has a [ without a ]", self.allowed)
        return None


@dataclass(frozen=True)
class ApplicationRule(Described):
    """What an application changes while it plays.

    UsageError: one or more values are not allowed; the message names all of them.
    """

    match: Annotated[
        str, Pattern("application to which the rule applies", "NAME, with *, ? and [...]")
    ]
    profile: Annotated[
        str | None, Choice("profile while the application plays", tuple(PROFILES))
    ] = None
    gain_db: Annotated[
        float, Number("added to the level while it plays", GAIN_MIN_DB, GAIN_MAX_DB, "dB")
    ] = 0.0
    feel: Annotated[
        bool | None,
        Switch("whether its sound is felt; default: unless it is a call, an alert or excluded"),
    ] = None

    @property
    def rule(self) -> Rule:
        """The parsed pattern."""
        return Rule.parse(self.match)


def rule_refusals(rules: Sequence[Mapping[str, Any]]) -> dict[tuple[int, str], Refusal]:
    """Return contradictions in and between rules, keyed by (number from 1, key)."""
    found: dict[tuple[int, str], Refusal] = {}
    first: dict[str, int] = {}
    for number, rule in enumerate(rules, 1):
        if rule.get("feel") is False:
            for key in ("profile", "gain_db"):
                if key in rule:
                    allowed = f"feel = true, or no {key}"
                    found[number, key] = Refusal("contradicts feel = false", allowed)
        if name := str(rule.get("match", "")).strip().casefold():
            if name in first:
                wrong = f"has a rule already, application[{first[name]}]"
                found[number, "match"] = Refusal(wrong, "one rule for each application")
            first.setdefault(name, number)
    return found
