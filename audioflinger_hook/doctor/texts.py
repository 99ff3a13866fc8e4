"""The texts of all findings, causes before their effects.

Each finding has its name and what is wrong, then what to do and perhaps a command. Two texts whose
names begin with the same word belong to one finding. Names in braces are facts, or values that
`checks` gives.
"""

import re

_TABLE = """\
server-hangs: The sound server accepts connections, but does not answer.
    Restart the sound server.
    $ systemctl --user restart pipewire pipewire-pulse wireplumber
no-pulse: PipeWire {graph.version} runs, but pipewire-pulse does not answer: {server_error}.
    Start pipewire-pulse.
    $ systemctl --user start pipewire-pulse
no-server: There is no sound server: {server_error}.
    Start the sound server.{as_user}
    $ systemctl --user start pipewire pipewire-pulse wireplumber
no-session-manager: PipeWire has no session manager, so nothing links programs to outputs.
    Start WirePlumber.
    $ systemctl --user start wireplumber
pulseaudio: The sound server is PulseAudio {server.version}, so only the Python engine can play: \
vibration comes 65 to 130 ms after its sound.
    Install pipewire, pipewire-pulse and wireplumber in place of PulseAudio, or delay the sound \
too, in drop-in mode.
    $ cushion run --drop-in --offset-ms=-69
config unreadable: The config file cannot be read: {config_error}.
    Correct the file.
    $ cushion check
config mistake: The config file has a mistake: {mistake}.
    Correct the line.
    $ cushion check
config warning: The config file leads to a warning: {warning}.
    See all mistakes and warnings.
    $ cushion check
folder: The {folder.what} folder cannot be used: {folder.problem}.
    Make the folder usable for this user; `cushion doctor --fix` makes a missing folder.
disk-full: The disk of the {folder.what} folder is full: {free_kb} kB are free at {folder.path}.
    Delete some files; at least {least_kb} kB are needed.
    $ df -h {folder.path!q}
no-plugin: The plugin is missing: the file haptic_cushion.so was not built.
    Install a C compiler, such as gcc, and build the plugin.
    $ make run
no-native: The native engine cannot run: {native_problem}.
    Until then, the slower Python engine plays.
plugin-copy: The installed copy of the plugin is {installed}.
    Install it again.
    $ cushion plugin install
no-alsa-plugin: The Python engine cannot play: {alsa_problem}.
    Without it, nothing is felt on PulseAudio.
wrong-default-sink: The default output {felt.name!r} is the output of the vibration, so all \
programs play their sound on the actuators.
    Make your speakers the default output.
    $ pactl set-default-sink {speakers!q}
no-default-sink: The sound server has no default output, so there is no sound to capture.
    Connect your speakers, or choose the default output.
    $ pactl set-default-sink {speakers!q}
no-device: The device of the vibration is missing: {device_error}.
    Connect the device, or choose another one.
    $ cushion devices
no-device-chosen: No device is chosen for the vibration: the config file names none.
    Choose the device.
    $ cushion setup
device-muted: The output of the vibration {felt.name!r} is muted, at volume {felt.volume_percent} %.
    Turn the amplifier down, then unmute the output.
    $ pactl set-sink-mute {felt.name!q} 0
device-low: The output of the vibration {felt.name!r} is at volume {felt.volume_percent} %.
    Turn the amplifier down, then set the volume to 100 %.
    $ pactl set-sink-volume {felt.name!q} 100%
sound-muted: The output of the sound {heard.name!r} is muted, so nothing is felt.
    Unmute the output, and set a low volume instead.
    $ pactl set-sink-mute {heard.name!q} 0
rate-clash forced: The output {sink.name!r} runs at {sink.samplerate} Hz, but PipeWire's graph is \
forced to {graph.clock_hz} Hz.
    End the forced rate.
    $ pw-metadata -n settings 0 clock.force-rate 0
rate-clash alone: The output {sink.name!r} runs at {sink.samplerate} Hz, but PipeWire's graph runs \
at {graph.clock_hz} Hz.
    Let the graph run at the rate of the output.
    $ pw-metadata -n settings 0 clock.force-rate {sink.samplerate}
rate-clash both: The output {sink.name!r} runs at {sink.samplerate} Hz, but PipeWire's graph runs \
at {graph.clock_hz} Hz.
    Give both outputs this rate in their configuration.
no-realtime: Audio threads get no real-time priority: RLIMIT_RTPRIO is {rtprio_limit}, and rtkit \
is missing ({asked}).
    Install rtkit, or allow real-time priority with this command and log in again.
    $ echo "$USER - rtprio 20" | sudo tee /etc/security/limits.d/cushion.conf
second-daemon: {count} programs play vibration to this server: {players}.
    End all but one of them.
    $ {command}
daemon-hangs: A daemon ({who}) holds the lock, but gives no status: {silent}.
    End this daemon, then start it again.
    $ {kill}
daemon-silent: The daemon gives no status: {daemon_error}.
    Start it again.
stale-lock: The last daemon (process {holder.pid}, started {holder.started}) was killed or \
crashed: its lock file remains.
    Remove the file with `cushion doctor --fix`, and start the daemon again.
    $ journalctl --user -u cushion
service-failed: The service has failed{other}.
    Read its messages. If a daemon runs in a terminal, end it and start the service.
    $ journalctl --user -u cushion
no-daemon: No daemon is running.
    Start it, or install the service with `cushion install-service`.
    $ cushion run
daemon-version: The daemon has version {status.version}, and this command {program}.
    Start the daemon again.
    $ systemctl --user restart cushion
daemon-waits: The daemon is {status.state.value}{waits}.
    Remove the cause; the daemon then continues.
muted: The vibration is muted.
    Switch the vibration on in the live page.
    $ cushion monitor --open
python-engine: The Python engine plays, so vibration comes 65 to 130 ms after its sound: \
{status.engine_reason}.
    Remove the reason if possible.
monitor-tap: The sound is read one cycle late, from the output's monitor: \
{status.graph.tap_reason}.
    Set a shorter cycle.
    $ pw-metadata -n settings 0 clock.force-quantum 256
daemon-warns: The daemon warns: {warning}.
    Follow this warning.
not-felt: A measurement played bursts, but their delay is unknown: {delay.reason}.
    See which level is missing.
    $ cushion status --watch
"""

_FORM = re.compile(r"^([^:\n]+): (.+)\n    (.+)(?:\n    \$ (.+))?$", re.MULTILINE)

# {name: what is wrong, what to do, command}
TEXTS = {name: texts for name, *texts in _FORM.findall(_TABLE)}
