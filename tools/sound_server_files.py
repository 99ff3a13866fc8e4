"""Writes complete configuration files for the servers of tools/sound_server.py.

PulseAudio and PipeWire read the files from the server's own folder, so configurations of the system
and of users have no effect.
"""

from __future__ import annotations

import shutil
from pathlib import Path

SHARE = Path("/usr/share")
RATE_HZ = 48_000
_QUANTUM_FRAMES = 256


def pulseaudio_options(folder: Path) -> list[str]:
    """Return the options with which PulseAudio reads the files of `write_configuration`."""
    return [
        "-n",  # ignore the system's start-up script
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
    """Write the configuration of a server, `pulse` or `pipewire`, into its folder.

    Return environment variables that make the server's programs read these files.

    socket: path of the socket for PulseAudio clients.
    """
    (folder / "start.pa").write_text(
        f".fail\nload-module module-native-protocol-unix socket={socket} auth-anonymous=1\n"
    )
    pipewire, wireplumber = folder / "pipewire", folder / "wireplumber"
    environment = {"PIPEWIRE_CONFIG_DIR": str(pipewire), "WIREPLUMBER_CONFIG_DIR": str(wireplumber)}
    if kind != "pipewire":
        return environment
    for path in (pipewire, wireplumber):
        path.mkdir(exist_ok=True)
    (pipewire / "pipewire.conf").write_text(PIPEWIRE_CONF)
    (pipewire / "pipewire-pulse.conf").write_text(
        PIPEWIRE_PULSE_CONF.replace("@ADDRESS@", f"unix:{socket}")
    )
    for name in ("client.conf", "client-rt.conf"):  # read by pw-play and pw-cli
        if (SHARE / "pipewire" / name).exists():  # version 1.4 and later have only the first file
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
    """Return 4 for WirePlumber 0.4's format of configuration, 5 for 0.5's; None if missing."""
    if (SHARE / "wireplumber" / "main.lua.d").is_dir():
        return 4
    if (SHARE / "wireplumber" / "wireplumber.conf").is_file():
        return 5
    return None


def wireplumber_command() -> list[str]:
    """Return the command with which WirePlumber reads the files of `write_configuration`."""
    profile = ["--profile=main-alone"] if wireplumber_generation() == 5 else []
    return ["wireplumber", *profile]


def keep_default_sink(kind: str, folder: Path) -> None:
    """Make a stopped server in this folder restore its default sink at each later start."""
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


# Real-time priority for server threads, as on a desktop. Without it, load on the machine makes
# streams lose cycles.
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

# This omits vm.overrides, so that a virtual machine behaves like a desktop.
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

# WirePlumber 0.4 gets the policy of a desktop, without devices, session bus and stored state.
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

# WirePlumber 0.5 gets the same policy.
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
