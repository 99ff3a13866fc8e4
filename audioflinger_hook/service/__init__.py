"""What a running daemon needs besides sound: its states, its status, its place in the system.

One module, one idea; nothing here touches sound, a sound server or a device:

    state, backoff                        what the daemon is doing; when it tries again
    levels, buffer_times                  measuring, on the audio thread
    status, document, status_view         what it tells: the document, its JSON, its text
    folder, lock, socket, ask             one daemon a user, and questions to it
    notify, watchdog                      what systemd is told
    unit, udev, install                   what systemd and udev are given
"""
