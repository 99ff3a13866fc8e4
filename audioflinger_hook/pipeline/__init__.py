"""The processing chain: client, mixer, effects and outputs."""
