"""The live page: shows and changes a running daemon, from a separate process.

| module | contents |
| --- | --- |
| `daemon_link` | the connection to the daemon's socket, made again after each loss |
| `access` | who may see the page: host, origin, token, cookie |
| `frames` | what changes many times a second |
| `clients` | what each browser gets, the newest first |
| `server` | HTTP and websockets |
| `metrics` | figures for Prometheus |
| `static` | what the browser loads |
"""
