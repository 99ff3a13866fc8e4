"""The configuration files of tools/sound_server.py: what its servers load, and nothing else.

PulseAudio and PipeWire read them from the server's own folder, so that neither the system's set-up
nor a user's has a say in it.
"""

from __future__ import annotations

import shutil
from pathlib import Path

SHARE = Path("/usr/share")
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
    environment = {
        "PIPEWIRE_CONFIG_DIR": str(pipewire),
        "WIREPLUMBER_CONFIG_DIR": str(wireplumber),
    }
    if kind != "pipewire":
        return environment
    for path in (pipewire, wireplumber):
        path.mkdir(exist_ok=True)
    (pipewire / "pipewire.conf").write_text(PIPEWIRE_CONF)
    (pipewire / "pipewire-pulse.conf").write_text(
        PIPEWIRE_PULSE_CONF.replace("@ADDRESS@", f"unix:{socket}")
    )
    for name in ("client.conf", "client-rt.conf"):  # what pw-play and pw-cli read
        if (SHARE / "pipewire" / name).exists():  # 1.4 and later have the first one only
            shutil.copy(SHARE / "pipewire" / name, pipewire)
    if wireplumber_generation() == 4:
        shutil.copytree(SHARE / "wireplumber", wireplumber, dirs_exist_ok=True)
        (wireplumber / "main.lua.d" / "90-enable-all.lua").write_text(WIREPLUMBER_LUA)
        (wireplumber / "bluetooth.lua.d" / "90-enable-all.lua").write_text("")
        return environment | {"WIREPLUMBER_DATA_DIR": str(wireplumber)}
    shutil.copy(SHARE / "wireplumber" / "wireplumber.conf", wireplumber)
    (wireplumber / "wireplumber.conf.d").mkdir(exist_ok=True)
    (wireplumber / "wireplumber.conf.d" / "profile.conf").write_text(WIREPLUMBER_PROFILE)
    return environment


def wireplumber_generation() -> int | None:
    """Return how WirePlumber is configured: 4 as 0.4 is, 5 as 0.5; None if it is not installed."""
    if (SHARE / "wireplumber" / "main.lua.d").is_dir():
        return 4
    if (SHARE / "wireplumber" / "wireplumber.conf").is_file():
        return 5
    return None


def wireplumber_command() -> list[str]:
    """Return how WirePlumber is to be called in a folder that `write_configuration` has filled."""
    profile = ["--profile=main-alone"] if wireplumber_generation() == 5 else []
    return ["wireplumber", *profile]


def keep_default_sink(kind: str, folder: Path) -> None:
    """Let the server in this folder, which does not run, keep its default sink, as desktops do."""
    if kind == "pulse":
        with (folder / "start.pa").open("a") as file:
            file.write("load-module module-default-device-restore\n")
        return
    if wireplumber_generation() == 4:
        path = folder / "wireplumber" / "main.lua.d" / "90-enable-all.lua"
        forgets = 'device_defaults.properties["use-persistent-storage"] = false\n'
    else:
        path = folder / "wireplumber" / "wireplumber.conf.d" / "profile.conf"
        forgets = "    hooks.default-nodes.state = disabled\n"
    text = path.read_text()
    assert forgets in text
    path.write_text(text.replace(forgets, ""))


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
    {{ name = libpipewire-module-profiler }}
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

# WirePlumber 0.4: the policy of a desktop, without devices, a session bus or a memory
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

# the same for WirePlumber 0.5
WIREPLUMBER_PROFILE = """
wireplumber.profiles = {
  main-alone = {
    inherits = [ main, mixin.systemwide-session ]
    hardware.audio = disabled
    hardware.bluetooth = disabled
    hardware.video-capture = disabled
    support.dbus = disabled
    support.system-dbus = disabled
    hooks.device.profile.state = disabled
    hooks.device.routes.state = disabled
    hooks.default-nodes.state = disabled
    hooks.stream.state = disabled
    hooks.node.suspend = disabled
  }
}
"""
