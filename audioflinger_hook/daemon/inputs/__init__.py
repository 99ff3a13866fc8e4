"""Where sound comes from: the monitor of a sink, single applications, or a file in real time."""
