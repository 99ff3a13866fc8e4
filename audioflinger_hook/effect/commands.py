"""Checks of a command's code and data before an engine receives the command."""

from audioflinger_hook.effect.interface import (
    EINVAL,
    ENOSYS,
    OK,
    Access,
    Command,
    EffectConfig,
    EffectDescriptor,
    EffectFlag,
    Parameter,
)
from device.layouts import CHANNELS_MAX

KNOWN = frozenset(int(code) for code in Command) - {int(Command.FIRST_PROPRIETARY)}

WITHOUT_DATA = (
    *(Command.INIT, Command.RESET, Command.ENABLE, Command.DISABLE, Command.SET_PARAM_COMMIT),
    *(Command.GET_CONFIG, Command.GET_CONFIG_REVERSE, Command.DUMP),
)
WITH_A_WORD = (  # one unsigned integer of 32 bits
    *(Command.SET_DEVICE, Command.SET_AUDIO_MODE, Command.SET_INPUT_DEVICE),
    *(Command.SET_AUDIO_SOURCE, Command.GET_FEATURE_CONFIG),
)
NEEDED_FLAGS = {
    Command.SET_VOLUME: EffectFlag.VOLUME_MASK,
    Command.SET_DEVICE: EffectFlag.DEVICE_MASK,
}

WORD_MAX = 2**32 - 1


class CommandCheck:
    """Checks whether commands are valid for the descriptor of an effect."""

    def __init__(self, descriptor: EffectDescriptor) -> None:
        self._flags = descriptor.flags
        self._parameters = {parameter.name: parameter for parameter in descriptor.parameters}
        self._takes = {vendor.code: vendor.takes for vendor in descriptor.vendor_commands}

    def status(self, code: object, data: object) -> int:
        """Return OK, EINVAL (not valid) or ENOSYS (needs a flag that the effect does not have)."""
        if type(code) is not int and type(code) is not Command:
            return EINVAL
        if code in self._takes:
            return OK if type(data) is self._takes[code] else EINVAL
        if code not in KNOWN or not self._fits(Command(code), data):
            return EINVAL
        needed = NEEDED_FLAGS.get(Command(code))
        return OK if needed is None or self._flags & needed else ENOSYS

    def parameter(self, name: object) -> Parameter | None:
        """Return the parameter of this name, or None."""
        return self._parameters.get(name) if type(name) is str else None

    def _fits(self, code: Command, data: object) -> bool:
        if code in WITHOUT_DATA:
            return data is None
        if code in WITH_A_WORD:
            return is_word(data)
        if code in (Command.SET_CONFIG, Command.SET_CONFIG_REVERSE):
            return is_config(data)
        if code == Command.GET_PARAM:
            return self.parameter(data) is not None
        # The data of all other commands is a tuple.
        if type(data) is not tuple:
            return False
        if code == Command.SET_VOLUME:
            return 1 <= len(data) <= CHANNELS_MAX and all(
                type(gain) in (float, int) and 0 <= gain <= 1 for gain in data
            )
        if len(data) != 2:
            return False
        first, second = data
        if code == Command.OFFLOAD:
            return type(first) is bool and is_word(second)
        if code == Command.GET_FEATURE_SUPPORTED_CONFIGS:
            return is_word(first) and is_word(second)
        if code == Command.SET_FEATURE_CONFIG:
            return is_word(first)
        parameter = self.parameter(first)
        return parameter is not None and not parameter.read_only and parameter.accepts(second)


def is_word(number: object) -> bool:
    """Return whether an object is an unsigned integer of 32 bits."""
    return type(number) is int and 0 <= number <= WORD_MAX


def is_config(config: object) -> bool:
    """Return whether an object is an EffectConfig whose fields all have valid values."""
    if type(config) is not EffectConfig or type(config.access) is not Access:
        return False
    ranges = (
        (config.samplerate, 1, WORD_MAX),
        (config.channels, 1, CHANNELS_MAX),
        (config.haptic_channels, 0, CHANNELS_MAX),
        (config.frames, 1, 2**20),  # 22 s at 48 kHz
    )
    return all(type(number) is int and low <= number <= high for number, low, high in ranges)
