"""The live page: it shows and changes the state of a running daemon, from a separate process.

| module | contents |
| --- | --- |
| `daemon_link` | connection to the daemon's socket, with reconnection |
| `access` | access control by host, origin, key and one-time code |
| `frames` | messages with levels and frequencies, many times a second |
| `clients` | queues of messages to the browsers |
| `server` | server for HTTP and websockets |
| `figures` | the daemon's status as rows of the page and as metrics for Prometheus |
| `static` | files for the browser |
"""
