"""The processing chain: client, mixer, effects and outputs, one cycle a step."""
