"""The native engine: runs a plugin in PipeWire's graph, and supervises the plugin's process."""
