"""The daemon: live sound through the effect into a device, until it is told to stop.

| module | contents |
| --- | --- |
| `run_config` | the configuration of a run, and the difference between two of them |
| `supervisor` | the main thread: opens streams, watches them and reopens them |
| `server_link` | the connection to the sound server, made again after each loss |
| `endpoints` | the input and output for a `RunConfig` |
| `inputs` | a sink's monitor, applications, or a file in real time |
| `outputs` | a sink, a card, or a file in real time |
| `capture_queue` | a queue of buffers for the engine |
| `engine` | what the audio threads run: buffers through mixer, effect and drive |
| `reconnecting_stream` | a stream that is reopened after a failure |
| `timing` | waits between attempts, rest while nothing plays, stalls and suspends |
| `pacing` | the thread that plays and writes files in real time |
| `drop_in_control` | the virtual sink of drop-in mode |
| `recording` | a run as a capture, with its settings |
| `live_capture` | `cushion capture` of live sound |
| `status_report` | the status, collected from all parts |
| `wake` | events for the main thread |
"""
