"""The configuration files of tools/sound_server.py: what its servers load, and nothing else.

PulseAudio and PipeWire read them from the server's own folder, so that neither the system's set-up
nor a user's has a say in it.
"""

from __future__ import annotations

import shutil
from pathlib import Path

RATE_HZ = 48_000
_QUANTUM_FRAMES = 256


def pulseaudio_options(folder: Path) -> list[str]:
    """Return how PulseAudio is to be called in a folder that `write_configuration` has filled."""
    return [
        "-n",  # not the system's start-up script
        f"--file={folder / 'start.pa'}",
        "--daemonize=no",
        "--use-pid-file=no",
        "--exit-idle-time=-1",
        "--realtime=no",
        "--high-priority=no",
        "--log-target=stderr",
        "--log-level=warning",
    ]


def write_configuration(kind: str, folder: Path, socket: Path) -> dict[str, str]:
    """Write the files of a server of a kind, `pulse` or `pipewire`, into its folder.

    socket: where it is to answer clients of PulseAudio. Returns the environment that makes its
    programs read these files.
    """
    (folder / "start.pa").write_text(
        f".fail\nload-module module-native-protocol-unix socket={socket} auth-anonymous=1\n"
    )
    pipewire, wireplumber = folder / "pipewire", folder / "wireplumber"
    if kind == "pipewire":
        pipewire.mkdir(exist_ok=True)
        (pipewire / "pipewire.conf").write_text(PIPEWIRE_CONF)
        (pipewire / "pipewire-pulse.conf").write_text(
            PIPEWIRE_PULSE_CONF.replace("@ADDRESS@", f"unix:{socket}")
        )
        for name in ("client.conf", "client-rt.conf"):  # what pw-play and pw-cli read
            shutil.copy(f"/usr/share/pipewire/{name}", pipewire)
        if not wireplumber.exists():
            shutil.copytree("/usr/share/wireplumber", wireplumber)
        (wireplumber / "main.lua.d" / "90-enable-all.lua").write_text(WIREPLUMBER_LUA)
        (wireplumber / "bluetooth.lua.d" / "90-enable-all.lua").write_text("")
    return {
        "PIPEWIRE_CONFIG_DIR": str(pipewire),
        "WIREPLUMBER_CONFIG_DIR": str(wireplumber),
        "WIREPLUMBER_DATA_DIR": str(wireplumber),
    }


# as on a desktop: without it, other work on the machine costs streams a cycle now and then
_REALTIME = (
    "{ name = libpipewire-module-rt args = { nice.level = -11 } flags = [ ifexists nofail ] }"
)

PIPEWIRE_CONF = f"""
context.properties = {{
    core.daemon = true
    core.name = pipewire-0
    mem.allow-mlock = false
    default.clock.rate = {RATE_HZ}
    default.clock.quantum = {_QUANTUM_FRAMES}
    default.clock.min-quantum = 64
    default.clock.max-quantum = 1024
}}
context.spa-libs = {{
    audio.convert.* = audioconvert/libspa-audioconvert
    support.* = support/libspa-support
}}
context.modules = [
    {_REALTIME}
    {{ name = libpipewire-module-protocol-native }}
    {{ name = libpipewire-module-metadata }}
    {{ name = libpipewire-module-spa-node-factory }}
    {{ name = libpipewire-module-client-node }}
    {{ name = libpipewire-module-client-device }}
    {{ name = libpipewire-module-access }}
    {{ name = libpipewire-module-adapter }}
    {{ name = libpipewire-module-link-factory }}
    {{ name = libpipewire-module-session-manager }}
]
context.objects = [
    # drives the graph while there is no sink
    {{ factory = spa-node-factory
      args = {{ factory.name = support.node.driver node.name = Dummy-Driver
               node.group = pipewire.dummy priority.driver = 20000 }} }}
]
"""

# without vm.overrides: a virtual machine is to behave as a desktop does
PIPEWIRE_PULSE_CONF = f"""
context.spa-libs = {{
    audio.convert.* = audioconvert/libspa-audioconvert
    support.* = support/libspa-support
}}
context.modules = [
    {_REALTIME}
    {{ name = libpipewire-module-protocol-native }}
    {{ name = libpipewire-module-client-node }}
    {{ name = libpipewire-module-adapter }}
    {{ name = libpipewire-module-metadata }}
    {{ name = libpipewire-module-protocol-pulse }}
]
pulse.properties = {{
    server.address = [ "@ADDRESS@" ]
    pulse.min.req = 64/48000
    pulse.min.frag = 64/48000
    pulse.min.quantum = 64/48000
}}
"""

# the policy of a desktop, without devices, without a session bus, without a memory
WIREPLUMBER_LUA = """
default_access.properties["enable-flatpak-portal"] = false
device_defaults.properties["use-persistent-storage"] = false
stream_defaults.properties["restore-props"] = false
stream_defaults.properties["restore-target"] = false
load_module("metadata")
default_access.enable()
device_defaults.enable()
stream_defaults.enable()
load_script("intended-roles.lua")
"""
