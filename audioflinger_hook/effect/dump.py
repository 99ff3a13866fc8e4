"""Effects as text, laid out as `dumpsys media.audio_flinger` does."""

from __future__ import annotations

from collections.abc import Sequence

from audioflinger_hook.effect.control import config_text
from audioflinger_hook.effect.interface import OK, Command, EffectFlag
from audioflinger_hook.effect.module import EffectModule

KIND_NAMES = {
    EffectFlag.INSERT: "insert",
    EffectFlag.AUXILIARY: "auxiliary",
    EffectFlag.REPLACE: "replace",
    EffectFlag.PRE_PROC: "preproc",
    EffectFlag.POST_PROC: "postproc",
}
PLACE_NAMES = {
    EffectFlag.INSERT_ANY: "any",
    EffectFlag.INSERT_FIRST: "first",
    EffectFlag.INSERT_LAST: "last",
    EffectFlag.INSERT_EXCLUSIVE: "exclusive",
}


def chain_lines(session: int, modules: Sequence[EffectModule]) -> list[str]:
    """Return one chain's lines. From any thread: it only reads what is there."""
    lines = [f"{len(modules)} effects for session {session}"]
    for place, module in enumerate(modules):
        lines += [f"  {line}" for line in effect_lines(place, module)]
    return lines


def effect_lines(place: int, module: EffectModule) -> list[str]:
    """Return one effect's lines; place: in its chain, from 0."""
    descriptor = module.descriptor
    lines = [
        f"Effect {place}: {descriptor.name}",
        "  Session State    Enabled Bypassed",
        f"  {module.session:<7} {module.state.name:<8} {yes_no(module.enabled):<7} "
        f"{yes_no(bool(module.bypassed))}",
        "  Descriptor:",
        f"  - UUID: {descriptor.uuid}",
        f"  - TYPE: {descriptor.type_uuid}",
        f"  - apiVersion: {descriptor.api_version:08X}",
        f"  - flags: {int(descriptor.flags):08X} ({flags_text(descriptor.flags)})",
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


def asked_lines(module: EffectModule) -> tuple[str, ...]:
    """Return what the effect itself says: its parameters and its own dump.

    Called by the thread that steps the mixer, as every command.
    """
    lines = []
    for parameter in module.descriptor.parameters:
        status, value = module.command(Command.GET_PARAM, parameter.name)
        if status == OK:
            lines.append(f"- {parameter.name}: {value} {parameter.unit}".rstrip())
    status, text = module.command(Command.DUMP)
    if status == OK and type(text) is str:
        lines += text.splitlines()
    return ("Parameters:", *lines) if lines else ()


def flags_text(flags: EffectFlag) -> str:
    """Return an effect's flags in words."""
    kind = KIND_NAMES.get(flags & EffectFlag.TYPE_MASK, "unknown")
    place = PLACE_NAMES.get(flags & EffectFlag.INSERT_MASK, "unknown")
    words = [f"conn. mode: {kind}", f"insert pref: {place}"]
    if flags & EffectFlag.VOLUME_MASK:
        words.append("told of volume")
    if flags & EffectFlag.DEVICE_MASK:
        words.append("told of devices")
    return ", ".join(words)


def yes_no(truth: bool) -> str:
    """Return y or n."""
    return "y" if truth else "n"
