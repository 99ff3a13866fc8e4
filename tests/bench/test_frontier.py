"""The frontier: settings really change the live form, leave nothing changed, and are judged so."""

from dataclasses import replace

import pytest

from audioflinger_hook.transform.design import synthesis
from audioflinger_hook.transform.design.synthesis import LiveGrid
from tools.bench.sections import frontier
from tools.bench.sections.frontier import COST, LAG, LEAK
from tools.bench.sections.frontier_settings import DEFAULT, SETTINGS, Setup, constants_changed, hop
from tools.bench.sounds.signals import SAMPLERATE, tone
from tools.bench.workbench import LIVE, SUBJECTS

CONSTANTS = ("HOPS_A_WINDOW", "LOW_RATE_HZ", "LOW_PASS")


def numbers():
    return [getattr(synthesis, name) for name in CONSTANTS]


def test_the_default_is_the_live_form_to_the_byte():
    sound = tone(440.0, 0.3, 0.3)
    (live,) = (subject for subject in SUBJECTS if subject.name == LIVE)
    ours = Setup(SETTINGS[0]).vibration(sound)
    assert SETTINGS[0].name == DEFAULT
    assert ours.tobytes() == live.vibration(sound, SAMPLERATE).tobytes()


@pytest.mark.parametrize("setting", SETTINGS[1:], ids=lambda setting: setting.name)
def test_every_setting_changes_the_form_and_leaves_the_transform_as_it_was(setting):
    before = numbers()
    form, plain = Setup(setting).made, Setup(SETTINGS[0]).made
    assert numbers() == before
    assert form != plain
    # Also where a transform cannot be made.
    with pytest.raises(ZeroDivisionError), constants_changed({"LOW_PASS": None}):
        _ = 1 / 0
    assert numbers() == before


def test_with_a_shorter_hop_a_chirp_is_followed_nearer_and_without_onsets_less_lag():
    slow, fast = (Setup(hop(hops)) for hops in (1.0, 8.0))
    grids = [setup.made.grid for setup in (slow, fast)]
    assert isinstance(grids[0], LiveGrid)
    assert grids[0].hop_frames > 7 * grids[1].hop_frames
    without = [Setup(replace(hop(hops), name="without", onsets=False)) for hops in (1.0, 8.0)]
    assert frontier._lag_p95_ms(without[1], 2) < frontier._lag_p95_ms(without[0], 2) - 10.0
    # Onsets wait for no hop.
    assert frontier._lag_p95_ms(slow, 2) < frontier._lag_p95_ms(without[1], 2) - 10.0
    assert frontier._chirp_error_hz(fast) < 0.5 * frontier._chirp_error_hz(slow)


def test_partials_that_there_is_no_room_for_are_missed_and_none_is_spurious():
    (few,) = (setting for setting in SETTINGS if setting.name == "4 partials")
    missed, spurious = frontier._notes(Setup(few))
    assert missed == pytest.approx(100.0 * (1.0 - 4 / frontier.HARMONICS))
    assert spurious == 0.0
    assert frontier._notes(Setup(SETTINGS[0])) == (0.0, 0.0)


def test_a_setting_dominates_only_if_it_is_better_in_something_and_worse_in_nothing():
    default = dict.fromkeys(frontier.UNITS, 1.0)
    cheaper = default | {COST: 0.5}
    others = {"traded": cheaper | {LAG: 3.0}, "blurred": default | {COST: 0.95, LEAK: 1.2}}
    verdict = frontier._verdict({DEFAULT: default} | others)
    assert "The defaults lie on the frontier: no other setting" in verdict
    assert "- traded: better in cost 0.500 ms; worse in lag, p95 3 ms" in verdict
    assert "- blurred: better in nothing; worse in nothing" in verdict
    verdict = frontier._verdict({DEFAULT: default, "cheaper": cheaper} | others)
    assert "worse in no column: cheaper." in verdict
