"""`cushion run` plays to USB sound cards of a real kernel, in a virtual machine.

Judged by frames and bits. The machine's own time counts instructions, so that nothing in it is late
because this one is busy.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from numpy.typing import NDArray

from audioflinger_hook.capture import Capture
from tests.usbvm.machine import BUFFER_FRAMES, Machine, why_not

pytestmark = [pytest.mark.usbvm, pytest.mark.skipif(bool(why_not()), reason=why_not() or "-")]

RATE_HZ = 48_000
LIMIT_S = 1_500.0
PLAYS_AGAIN_S = 3.0
CUT_FRAMES = BUFFER_FRAMES + 3 * 256  # dropped at a stream's end: QEMU's buffer, the kernel's
OFF_FRAMES_MAX = 48.0  # one millisecond: the loop's own wandering beside blocks of 256 frames
WANDERS_PPM = 60.0  # of the mean ratio, while the loop settles on a drift of 150 or 200

Samples = NDArray[np.int64]


def done(folder: Path, scene: str, cards: tuple[str, ...] = ()) -> dict[str, Any]:
    """What came of a scene in a machine with these cards."""
    machine = Machine(folder, cards)
    code = machine.run([sys.executable, "-m", "tests.usbvm.guest", scene, str(folder)], LIMIT_S)
    assert code == 0, (folder / "output").read_text()
    result: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return result


def undisturbed(folder: Path, scene: str) -> tuple[dict[str, Any], Path]:
    """What came of a scene, and its folder; again if the machine was too slow for the card."""
    for attempt in range(3):
        within = folder / str(attempt)
        within.mkdir()
        result = done(within, scene)
        if result["statuses"][-1]["xruns"]["output"] == 0:
            break
    return result, within


def sent(folder: Path, bits: int) -> list[Samples]:
    """The pieces that went to the card, as the integers that they were sent as."""
    pieces: list[list[NDArray[np.float32]]] = []
    for buffer in Capture(folder / "record").buffers("device"):
        if buffer.discontinuity or not pieces:
            pieces.append([])
        pieces[-1].append(buffer.frames)
    scale = 2.0 ** (bits - 1)
    wholes = (np.concatenate(each).astype(np.float64) for each in pieces)
    return [np.rint(whole * scale).astype(np.int64) for whole in wholes]


def heard(path: Path) -> Samples:
    """What one of QEMU's cards was sent."""
    if not path.exists():
        return np.zeros((0, 2), np.int64)
    samples, samplerate = soundfile.read(path, dtype="int16", always_2d=True)
    assert samplerate == RATE_HZ
    return np.asarray(samples, np.int64)


def sounding(samples: Samples) -> Samples:
    """From the first frame that is not silent to the last."""
    loud = np.flatnonzero(samples.any(axis=1))
    return samples[loud[0] : loud[-1] + 1] if loud.size else samples[:0]


def assert_all_heard(played: Samples, wanted: Samples, cut: int) -> None:
    """What was played is what was wanted, bit for bit, but for `cut` frames at its end."""
    played, wanted = sounding(played), sounding(wanted)
    assert len(played) > RATE_HZ
    assert len(wanted) - cut <= len(played) <= len(wanted)
    assert np.array_equal(played, wanted[: len(played)])


def assert_followed(result: dict[str, Any], ppm: float) -> None:
    """The delay stays on its target, in frames, because what is read goes as the card's clock.

    A target that falls, as lateness is forgotten, is followed by reading that much faster.
    """
    running = [one for one in result["statuses"] if one["state"] == "running"]
    lines = [{"time_s": one["time_s"], **one["delay_line"]} for one in running]
    lines = lines[len(lines) // 2 :]  # once it has settled
    off = [1e-3 * RATE_HZ * (line["delay_ms"] - line["target_ms"]) for line in lines]
    first, last = lines[0], lines[-1]
    fell_ms = first["target_ms"] - last["target_ms"]
    fell_ppm = 1e3 * fell_ms / (last["time_s"] - first["time_s"])
    read_ppm = float(np.mean([line["ratio_ppm"] for line in lines])) - fell_ppm
    print(f"off by {min(off):+.1f} to {max(off):+.1f} frames, reads {read_ppm:+.0f} ppm faster")
    assert max(map(abs, off)) <= OFF_FRAMES_MAX
    assert abs(read_ppm + ppm) <= WANDERS_PPM
    for what in ("resyncs", "underflows", "overflows"):
        assert first[what] == last[what]


@pytest.mark.soak
@pytest.mark.parametrize(("scene", "ppm"), [("fast", 200.0), ("slow", -200.0)])
def test_a_card_whose_clock_drifts_is_followed(tmp_path, scene, ppm):
    result, folder = undisturbed(tmp_path, scene)
    taken = np.fromfile(folder / "taken.raw", "<i2").reshape(-1, 2).astype(np.int64)
    assert_all_heard(taken, np.concatenate(sent(folder, 16)), RATE_HZ)
    assert_followed(result, ppm)


def test_a_dac_of_class_2_gets_what_its_feedback_asks_for_bit_for_bit(tmp_path):
    result, folder = undisturbed(tmp_path, "feedback")
    (offered,) = result["formats"]  # its rates are told by its clock alone
    assert (offered["samplerates"], offered["feedback"]) == ([44_100, 48_000], True)
    taken = np.fromfile(folder / "taken.raw", "<i4").reshape(-1, 2).astype(np.int64)
    # all 32 bits are sent, of which such a device heeds 24
    assert_all_heard(taken, np.concatenate(sent(folder, 32)), RATE_HZ)
    assert_followed(result, 150.0)
    rate = [told["device_rate"] for told in result["statuses"] if told["state"] == "running"][-1]
    assert rate["nominal_hz"] == RATE_HZ
    # its word has 16 bits behind the point, of frames in 125 us
    assert rate["ppm"] == pytest.approx(150.0, abs=1e6 * 8_000 / 65_536 / RATE_HZ)
    assert rate["measured_hz"] == pytest.approx(RATE_HZ * (1.0 + 1e-6 * rate["ppm"]))


def test_a_muted_dac_whose_volume_cannot_be_set_stays_muted_and_is_not_played_to(tmp_path):
    result = done(tmp_path, "unsettable")
    assert set(result) == {"none", "kept"}
    for refused, left in result.values():
        code, told, muted, played = refused
        assert (code, muted, played) == (3, 1, False)
        assert "device_volume_db = -30 cannot be set" in told
        assert "--device-volume-db off" in told
        code, told, muted, played = left
        assert (code, muted, played) == (0, 1, True), told
    assert "has a mute and no volume" in result["none"][0][1]
    # One kernel drops what the device refuses, another returns the refusal.
    told = result["kept"][0][1]
    assert "was set to -30 dB and is -1 dB" in told or "refuses the value" in told


def test_the_chosen_one_of_two_cards_gets_every_bit_and_the_other_nothing(tmp_path):
    result = done(tmp_path, "bits", ("one", "two"))
    assert result["names"][0] != result["names"][1]
    (piece,) = sent(tmp_path, 16)
    cards = [heard(tmp_path / f"{name}.wav") for name in ("one", "two")]
    loud = [bool(samples.any()) for samples in cards]
    assert sorted(loud) == [False, True]
    assert_all_heard(cards[loud.index(True)], piece, CUT_FRAMES)
    (mixed,) = result["mixed"]
    assert mixed["range_db"] == pytest.approx(mixed["alsa_range_db"], abs=0.01)
    assert mixed["highest_db"] > 0.0  # louder than may be set
    assert -1.0 < mixed["set_db"] <= 0.0
    assert (mixed["steps"], mixed["muted"]) == (mixed["alsa_steps"], [[True], [False]])


def test_a_card_that_is_pulled_out_while_it_plays_is_waited_for_in_any_port(tmp_path):
    result = done(tmp_path, "pulled", ("dac",))
    states = [state for _, state in result["states"]]
    assert "waiting-for-device" in states
    assert states[-1] == "running"
    assert result["again_s"] < PLAYS_AGAIN_S
    assert result["ports"][0] != result["ports"][1]
    assert result["real_time_threads"] == [1, 1]
    assert not [line for line in result["last"]["warnings"] if "without a break" in line]
    pieces = sent(tmp_path, 16)
    assert len(pieces) >= 2
    before, after = heard(tmp_path / "dac.wav"), heard(tmp_path / "dac-again.wav")
    first = sounding(before)
    assert len(first) > RATE_HZ
    assert np.array_equal(first, sounding(pieces[0])[: len(first)])
    assert_all_heard(after, pieces[-1], CUT_FRAMES)


def test_a_pad_vibrates_on_its_coils_alone_and_odd_formats_are_played_or_refused(tmp_path):
    result = done(tmp_path, "shapes")
    assert result["pad"][0] == 0, result
    speaker, coils = np.hsplit(np.fromfile(tmp_path / "pad.raw", "<i2").reshape(-1, 4), 2)
    assert not speaker.any()
    assert np.ptp(coils[:, 0].astype(int)) > 100
    assert np.array_equal(coils[:, 0], coils[:, 1])
    code, told, _ = result["coarse"]
    assert code == 3
    assert "U8 with 2 channels" in told
    code, told, samplerate = result["slow"]
    assert (code, samplerate) == (0, 32_000), told
    assert np.ptp(np.fromfile(tmp_path / "slow.raw", "<i2").astype(int)) > 100


def test_a_second_configuration_and_class_3_are_listed_and_played_to(tmp_path):
    result = done(tmp_path, "configurations")
    listed, described, code, told, played = result["second"]
    assert (code, played) == (0, True), told
    assert listed["audio_class"] == 1
    assert [each["samplerates"] for each in listed["formats"]] == [[44_100, 48_000]]
    assert "configuration 2 is the active one" in described
    listed, described, code, told, played = result["class 3"]
    assert (code, played) == (0, True), told
    assert listed["audio_class"] == 3
    (offered,) = listed["formats"]
    assert (offered["channels"], offered["bits"], offered["samplerates"]) == (2, 16, [48_000])
    assert "USB Audio 3.0" in described
