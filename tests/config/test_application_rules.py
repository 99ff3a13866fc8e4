"""[[application]] rules and the switch for calls and alerts, as the config file has them."""

from pathlib import Path

import pytest

from audioflinger_hook.config.file import check_text


def checked(text):
    return check_text(text, Path(), "cinema")


def test_rules_keep_their_order_and_values():
    config, mistakes = checked(
        '[live]\nfeel_calls_and_alerts = true\n[[application]]\nmatch = "super*"\n'
        'profile = "game"\ngain_db = -6\n[[application]]\nmatch = "mpv"\nfeel = false\n'
    )
    assert not mistakes
    assert config.live.feel_calls_and_alerts
    first, second = config.live.application_rules
    assert (first.match, first.profile, first.gain_db, first.feel) == ("super*", "game", -6.0, None)
    assert (second.match, second.profile, second.gain_db, second.feel) == ("mpv", None, 0.0, False)
    assert not checked("")[0].live.feel_calls_and_alerts


@pytest.mark.parametrize(
    ("text", "key", "line", "words"),
    [
        ('match = "a["', "match", 2, "has a [ without a ]"),
        ('match = "[a]["', "match", 2, "has a [ without a ]"),
        ('match = "[!]"', "match", 2, "has a [ without a ]"),
        ('match = " "', "match", 2, "is not a pattern"),
        ("match = 3", "match", 2, "is not a pattern"),
        ("gain_db = -3", "match", 1, "is missing"),
        ('match = "a"\nprofile = "nix"', "profile", 3, "is not known"),
        ('match = "a"\ngain_db = 3', "gain_db", 3, "is out of range"),
        ('match = "a"\nfeel = false\ngain_db = -3', "gain_db", 4, "contradicts feel = false"),
        ('match = "a"\nfeel = false\nprofile = "game"', "profile", 4, "contradicts feel = false"),
        ('match = "a"\nlevel = 3', "level", 3, "is an unknown key"),
        (
            'match = "a"\nprofile = "speech"\n[transform]\nband_high_hz = 250',
            *("profile", 3, "does not fit band_high_hz in [transform], which is under twice"),
        ),
    ],
)
def test_a_rule_that_cannot_act_is_named_with_its_line(text, key, line, words):
    config, (mistake, *more) = checked(f"[[application]]\n{text}\n")
    assert config is None
    assert not more
    assert (mistake.key, mistake.line) == (f"application[1].{key}", line)
    assert words in str(mistake)


def test_two_rules_for_one_application_and_one_table_instead_of_an_array_are_refused():
    _, mistakes = checked('[[application]]\nmatch = "mpv"\n[[application]]\nmatch = "MPV"\n')
    assert [(one.key, one.line) for one in mistakes] == [("application[2].match", 4)]
    assert "has a rule already, application[1]" in str(mistakes[0])
    _, mistakes = checked('[application]\nmatch = "mpv"\n')
    assert "is not an array of tables" in str(mistakes[0])
