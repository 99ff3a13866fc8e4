"""The processing chain: client, mixer, effects and outputs; each step is one cycle."""
