"""Effect chains, one per session. They run in the same order as in Android's AudioFlinger."""

from collections.abc import Callable, Sequence

import numpy as np

from audioflinger_hook.effect.control import config_text, error_text
from audioflinger_hook.effect.interface import (
    OK,
    Command,
    EffectConfig,
    EffectDescriptor,
    EffectEngine,
    EffectFlag,
)
from audioflinger_hook.effect.module import EffectModule, same_layout
from audioflinger_hook.effect.registry import descriptor_problem
from audioflinger_hook.mixer.mix_buffer import DEVICE, OUTPUT_STAGE, EffectsPort, MixBuffer
from device.errors import UsageError

BUDGET_SHARE = 0.5  # largest processing time of one effect, as a share of the buffer's duration
READINGS_EVERY_S = 1.0  # interval at which parameters and state of effects are read for dumps


class EffectChains(EffectsPort):
    """All effects of one mixer, by session (the sound of one player, or a mix of all players).

    Any thread may call `sessions`, `modules`, `effects`, `bypassed` and `dump`. Only the mixer's
    thread may call the other methods. `process` and `end_of_cycle` raise only KeyboardInterrupt.

    clock: function that returns the time in seconds. budget_share: longest allowed processing time
    of one effect, as a share of the buffer's duration. With inf, slow effects are not bypassed,
    so that offline results are reproducible.
    """

    def __init__(self, clock: Callable[[], float], *, budget_share: float = BUDGET_SHARE) -> None:
        self._clock = clock
        self._budget_share = budget_share
        self._chains: dict[int, list[EffectModule]] = {}
        self._sessions: tuple[int, ...] = ()
        self._config: EffectConfig | None = None
        self._cycles = 0
        self._now_s = 0.0
        self._read_s = float("-inf")

    def add(self, engine: EffectEngine, session: int) -> EffectModule:
        """Add a disabled effect to a session's chain. The effect's flags determine its place.
        session: a player's session, 1 or higher, or `OUTPUT_MIX`, `OUTPUT_STAGE` or `DEVICE`.
        UsageError: the descriptor or session is invalid, or the chain cannot contain the effect.
        """
        try:
            descriptor: object = engine.descriptor
        except Exception as error:
            raise UsageError(f"an effect has no descriptor: {error_text(error)}") from error
        problem = descriptor_problem(descriptor)
        if problem or not isinstance(descriptor, EffectDescriptor):
            raise UsageError(problem)
        if problem := misplaced(descriptor.flags, session):
            raise UsageError(f"effect {descriptor.name!r} cannot be added: {problem}")
        chain = self._chains.get(session, [])
        index = insert_index(descriptor, [module.descriptor for module in chain])
        module = EffectModule(engine, session=session, clock=self._clock, budget_s=self._budget_s())
        if self._config is not None:
            module.set_config(self._config)
        self._chains[session] = [*chain[:index], module, *chain[index:]]
        self._order()
        return module

    def remove(self, module: EffectModule) -> None:
        """Release an effect and remove it from its chain; do nothing if no chain contains it."""
        chain = self._chains.get(module.session, [])
        if module not in chain:
            return
        module.release()
        if rest := [other for other in chain if other is not module]:
            self._chains[module.session] = rest
        else:
            del self._chains[module.session]
        self._order()

    def sessions(self) -> tuple[int, ...]:
        """Return sessions with effects, in processing order: those of players, then 0, -1, -2."""
        return self._sessions

    def modules(self, session: int) -> tuple[EffectModule, ...]:
        """Return a session's effects in processing order."""
        return tuple(self._chains.get(session, ()))

    def bypassed(self) -> list[str]:
        """Return one line per bypassed effect: `session, effect: reason`."""
        return [
            f"session {module.session}, {module.descriptor.name}: {module.bypassed}"
            for module in self.effects()
            if module.bypassed
        ]

    def effects(self) -> list[EffectModule]:
        """Return all effects in processing order."""
        return [module for session in self._sessions for module in self.modules(session)]

    def process(
        self, session: int, buffer: MixBuffer, now_s: float, target: MixBuffer | None = None
    ) -> None:
        """Replace `buffer` by the output of a session's chain, or add this output to `target`."""
        self._now_s = now_s
        output = buffer if target is None else target
        if chain := self._chains.get(session):
            for module in chain[:-1]:
                module.process(buffer, buffer)
            chain[-1].process(buffer, output)
        elif output is not buffer and same_layout(buffer, output):
            np.add(output.samples, buffer.samples, out=output.samples)

    def end_of_cycle(self, now_s: float) -> None:
        """Start and stop effects as requested. Once per second, read their state for `dump`."""
        self._now_s = now_s
        self._cycles += 1
        effects = self.effects()
        for module in effects:
            module.update_state()
        if not 0.0 <= now_s - self._read_s < READINGS_EVERY_S:
            self._read_s = now_s
            for module in effects:
                if not module.fault:
                    module.readings = _readings(module)

    def set_format(self, samplerate: int, channels: int, haptic_channels: int, frames: int) -> None:
        """Configure all effects for buffers of at most `frames` frames at `samplerate` Hz."""
        self._config = EffectConfig(samplerate, channels, haptic_channels, frames)
        for module in self.effects():
            module.budget_s = self._budget_s()
            module.set_config(self._config)

    def dump(self) -> list[str]:
        """Return the state of all effects as lines like those of `dumpsys media.audio_flinger`."""
        lines = [f"{len(self._sessions)} Effect Chains"]
        lines.append(f"  cycles: {self._cycles}, last at {self._now_s:.3f} s")
        for session in self._sessions:
            modules = self.modules(session)
            lines.append(f"  {len(modules)} effects for session {session}")
            for place, module in enumerate(modules):
                lines += [f"    {line}" for line in _effect_lines(place, module)]
        return lines

    def _budget_s(self) -> float:
        if self._config is None:
            return float("inf")
        return self._budget_share * self._config.frames / self._config.samplerate

    def _order(self) -> None:
        self._sessions = tuple(sorted(self._chains, reverse=True))


def misplaced(flags: EffectFlag, session: object) -> str:
    """Return why a session's chain cannot contain an effect with these flags, or ""."""
    if type(session) is not int or session < DEVICE:
        return f"session {session!r} does not exist; allowed: {DEVICE} to 0, or a player's"
    if (kind := flags & EffectFlag.TYPE_MASK) not in (EffectFlag.INSERT, EffectFlag.POST_PROC):
        return "only inserts and post-processing run here; auxiliary and others do not"
    if session in (OUTPUT_STAGE, DEVICE) and kind != EffectFlag.POST_PROC:
        return f"session {session} takes only post-processing; add it to the output mix, 0"
    return ""


def insert_index(new: EffectDescriptor, chain: Sequence[EffectDescriptor]) -> int:
    """Return the index of a new effect in a chain, by the rules of AudioFlinger's getInsertIndex.

    An INSERT_LAST effect goes before the first INSERT_LAST effect. If there is none, it goes to the
    end. Other effects go after the last INSERT_FIRST effect. If there is none, they go before the
    first insert effect, or to the end of a chain without insert effects.

    UsageError: an EXCLUSIVE effect would share the chain with another insert effect.
    """
    places = [
        (index, other.flags & EffectFlag.INSERT_MASK)
        for index, other in enumerate(chain)
        if other.flags & EffectFlag.TYPE_MASK == EffectFlag.INSERT
    ]
    wanted = new.flags & EffectFlag.INSERT_MASK
    for index, place in places:
        if EffectFlag.INSERT_EXCLUSIVE in (wanted, place):
            raise UsageError(
                f"effect {new.name!r} cannot stand beside {chain[index].name!r}: "
                "one of them is exclusive; remove the other first"
            )
    if wanted == EffectFlag.INSERT_LAST:
        lasts = [index for index, place in places if place == EffectFlag.INSERT_LAST]
        return lasts[0] if lasts else len(chain)
    firsts = [index for index, place in places if place == EffectFlag.INSERT_FIRST]
    return firsts[-1] + 1 if firsts else places[0][0] if places else len(chain)


PLACE_NAMES = {
    EffectFlag.INSERT_ANY: "any",
    EffectFlag.INSERT_FIRST: "first",
    EffectFlag.INSERT_LAST: "last",
    EffectFlag.INSERT_EXCLUSIVE: "exclusive",
}


def _effect_lines(place: int, module: EffectModule) -> list[str]:
    descriptor = module.descriptor
    lines = [
        f"Effect {place}: {descriptor.name}",
        "  Session State    Enabled Bypassed",
        f"  {module.session:<7} {module.state.name:<8} {'y' if module.enabled else 'n':<7} "
        f"{'y' if module.bypassed else 'n'}",
        "  Descriptor:",
        f"  - UUID: {descriptor.uuid}",
        f"  - TYPE: {descriptor.type_uuid}",
        f"  - apiVersion: {descriptor.api_version:08X}",
        f"  - flags: {int(descriptor.flags):08X} ({_flags_text(descriptor.flags)})",
        f"  - implementor: {descriptor.implementor}",
        f"  - load: {descriptor.cpu_load / 10:g} MIPS, {descriptor.memory_kb} KB",
        f"  Configuration: {config_text(module.config) if module.config else 'none yet'}",
        f"  Buffers: {module.buffers}, longest {module.worst_s * 1e3:.2f} ms "
        f"of {module.budget_s * 1e3:g} ms; overruns {module.overruns}, faults {module.faults}, "
        f"refusals {module.refusals}, misfits {module.misfits}",
    ]
    if module.bypassed:
        lines.append(f"  Bypassed: {module.bypassed}")
    elif module.complaint:
        lines.append(f"  Last complaint: {module.complaint}")
    lines += [f"  {line}" for line in module.readings]
    return lines


def _readings(module: EffectModule) -> tuple[str, ...]:
    """Return an effect's parameter values and DUMP reply as lines, in the mixer's thread."""
    lines = []
    for parameter in module.descriptor.parameters:
        status, value = module.command(Command.GET_PARAM, parameter.name)
        if status == OK:
            lines.append(f"- {parameter.name}: {value} {parameter.unit}".rstrip())
    status, text = module.command(Command.DUMP)
    if status == OK and type(text) is str:
        lines += text.splitlines()
    return ("Parameters:", *lines) if lines else ()


def _flags_text(flags: EffectFlag) -> str:
    kind, place = flags & EffectFlag.TYPE_MASK, flags & EffectFlag.INSERT_MASK
    words = [
        f"conn. mode: {'postproc' if kind == EffectFlag.POST_PROC else 'insert'}",
        f"insert pref: {PLACE_NAMES.get(place, 'unknown')}",
    ]
    if flags & EffectFlag.VOLUME_MASK:
        words.append("told of volume")
    if flags & EffectFlag.DEVICE_MASK:
        words.append("told of devices")
    return ", ".join(words)
