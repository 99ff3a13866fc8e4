"""The engine inside PipeWire: the plugin runs in the graph, and the daemon only watches it."""
