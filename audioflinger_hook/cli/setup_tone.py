"""The tone of `cushion setup`: it fades in softly and gets louder only when asked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum, auto

from audioflinger_hook.cli.terminal import choose
from audioflinger_hook.cli.tone import TonePlayer, open_tone
from device.address import DeviceAddress
from device.drive import ActuatorSettings
from device.server import PulseConnection
from device.stream.pcms import Pcm
from device.units import db_to_amplitude

TONE_HZ = 60.0
FIRST_DB, STEP_DB = -24.0, 6.0
FADE_IN_S = 2.0
LONGEST_S = 30.0  # a tone without an answer fades out: a coil gets warm
UNASKED_S = 4.0

ANSWERS = {
    "yes": "it vibrates, and strongly enough",
    "louder": "6 dB more",
    "no": "it does not vibrate",
    "stop": "stop the tone and end",
}


class Felt(Enum):
    """What was answered."""

    YES = auto()
    NO = auto()
    STOPPED = auto()


def try_output(
    device: DeviceAddress,
    pcm: Pcm,
    connection: PulseConnection,
    actuators: Sequence[ActuatorSettings],
    *,
    ask: bool,
) -> tuple[Felt, float | None]:
    """Play the tone on a device and on no other; return the answer, and the level.

    actuators: whose channels play it; without, those with coils.
    ask: False plays the softest tone for a moment and returns `Felt.YES` without a level.
    KeyboardInterrupt: as for `choose`; the tone is stopped.
    LostError: the device does not play, or was lost. NotFoundError: there is no such device.
    """
    with open_tone(device, pcm, connection, TONE_HZ, actuators) as player:
        player.wait_audible()
        print(f"\n{player.name} vibrates softly at {TONE_HZ:g} Hz. Ctrl+C stops it.", flush=True)
        if not ask:
            player.tone.play(db_to_amplitude(FIRST_DB), UNASKED_S, FADE_IN_S)
            player.wait_ended()
            return Felt.YES, None
        print("The strongest moments will be as strong as the tone.")
        return _ask(player)


def _ask(player: TonePlayer) -> tuple[Felt, float | None]:
    level_db = FIRST_DB
    while True:
        player.tone.play(db_to_amplitude(level_db), LONGEST_S, FADE_IN_S)
        question = f"{level_db:g} dB. Felt it? yes, louder, no, stop:"
        answer = choose(question, ANSWERS, meanwhile=player.check)
        if answer == "stop":
            return Felt.STOPPED, None
        player.check()
        if answer == "yes":
            return Felt.YES, level_db
        if answer == "no":
            return Felt.NO, None
        if math.isclose(level_db, 0.0):
            print("This is full scale: turn the amplifier up, or check the cables.")
        level_db = min(level_db + STEP_DB, 0.0)
